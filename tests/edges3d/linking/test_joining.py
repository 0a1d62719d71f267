"""Pieces of known curves become whole edges again, whatever their order, direction and unit."""

import numpy as np
import pytest

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.edges3d.linking.joining import link_edges
from colmap_edges.options import LinkingOptions


def edges_of(*pieces):
    """Pieces of 3D points as edges; point i is observed in views 0..i % 3 at pixel (i, view)."""
    points = np.concatenate([np.zeros((0, 3)), *pieces])
    lengths = np.arange(len(points)) % 3 + 1
    views = np.concatenate([np.arange(n) for n in lengths]) if len(points) else np.zeros(0)
    owners = np.repeat(np.arange(len(points)), lengths)
    return Edges3D(
        points=points,
        edge_offsets=offsets_of(np.array([len(piece) for piece in pieces], np.int64)),
        closed=np.zeros(len(pieces), bool),
        observations=Observations.of_pixels(
            offsets=offsets_of(lengths),
            views=views.astype(np.int32),
            pixels=np.column_stack([owners, views]).astype(float),
        ),
        sigmas=np.arange(len(points), dtype=float),
        end_nodes=np.full((len(pieces), 2), -1, np.int32),
        colors=np.arange(3 * len(points)).reshape(-1, 3).astype(np.uint8),
    )


def through_all_gaps(ends, a, b):
    return np.ones(len(a), bool)


def link(*pieces, **options):
    return link_edges(edges_of(*pieces), LinkingOptions(**options), through_all_gaps)


def helix(count=120, radius=10.0):
    angle = np.arange(count) / radius
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.2 * np.arange(count)])


def circle(count=80):
    angle = 2 * np.pi * np.arange(count) / count
    return count / (2 * np.pi) * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_pieces_in_any_order_and_direction_are_one_curve(seed, scale):
    rng = np.random.default_rng(seed)
    whole = scale * helix()
    pieces = np.split(whole, [23, 50, 61, 90])
    pieces = [piece[:: rng.choice([-1, 1])] for piece in pieces]
    linked = link(*(pieces[i] for i in rng.permutation(5)))
    assert linked.edge_offsets.tolist() == [0, len(whole)]
    assert not linked.closed[0]
    forward = linked.points if linked.points[0, 2] < linked.points[-1, 2] else linked.points[::-1]
    np.testing.assert_array_equal(forward, whole)


def test_tracks_go_with_their_points():
    pieces = np.split(helix(40), [15, 30])
    before = edges_of(pieces[2], pieces[0][::-1], pieces[1])
    after = link_edges(before, LinkingOptions(), through_all_gaps)
    for row, origin in enumerate(after.sigmas.astype(int)):
        np.testing.assert_array_equal(after.points[row], before.points[origin])
        own = slice(after.observations.offsets[row], after.observations.offsets[row + 1])
        assert after.observations.pixels[own, 0].tolist() == [origin] * (origin % 3 + 1)
        assert after.observations.views[own].tolist() == list(range(origin % 3 + 1))
        np.testing.assert_array_equal(after.colors[row], before.colors[origin])
    assert sorted(after.sigmas) == list(range(40))


def test_a_circle_in_pieces_is_closed():
    linked = link(*np.split(circle(), [30, 55]))
    assert linked.closed.tolist() == [True]
    assert linked.num_points == 80
    assert linked.end_nodes.tolist() == [[-1, -1]]
    assert link(circle()).closed.tolist() == [True]
    assert link(circle()[:60]).closed.tolist() == [False]


def test_gaps_in_a_small_circle_are_bridged():
    whole = circle(32)
    rng = np.random.default_rng(0)
    whole += rng.normal(scale=0.02, size=whole.shape)
    # Ends three distances apart differ by more than 30 degrees.
    linked = link(whole[0:7], whole[9:16], whole[18:30])
    assert linked.closed.tolist() == [True]


def test_gaps_are_bridged_up_to_the_limit():
    curve = helix(radius=40.0)
    assert link(curve[:50], curve[55:]).num_edges == 1
    assert link(curve[:50], curve[70:]).num_edges == 2
    assert link(curve[:50], curve[55:], max_gap_spacings=3.0).num_edges == 2


def test_overlapping_points_are_left_out():
    curve = helix()
    linked = link(curve[:60], curve[58:] + 0.01)
    assert linked.num_edges == 1
    assert linked.num_points < 121
    steps = np.linalg.norm(np.diff(linked.points, axis=0), axis=1)
    assert steps.min() > 0.25
    turns = np.einsum(
        "ij,ij->i", np.diff(linked.points[1:], axis=0), np.diff(linked.points[:-1], axis=0)
    )
    assert (turns > 0).all()


@pytest.mark.parametrize("count", range(3, 9))
def test_something_of_a_piece_remains_that_others_overlap_from_both_sides(count):
    along = np.column_stack([np.arange(40.0), np.zeros(40), np.zeros(40)])
    aside = np.array([0.0, 0.5, 0.0])  # so that the long ones cannot be joined to each other
    first, middle = 20 - count // 2, along[20 - count // 2 :][:count]
    before = along[: first + min(count, 4)] + aside
    after = along[first + count - min(count, 4) :] - aside
    linked = link(before, after, middle)
    assert linked.num_edges == 1
    assert 0 < np.isin(linked.points[:, 1], 0.0).sum() <= count
    assert len(before) + len(after) < linked.num_points <= len(before) + len(after) + count


def test_corners_and_parallels_are_not_joined():
    along = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])
    across = along[:, [1, 0, 2]] + np.array([19.5, 0.5, 0])
    corner = link(along, across)
    assert corner.num_edges == 2
    parallel = link(along, along + np.array([0, 3, 0]))
    assert parallel.num_edges == 2


def test_nothing_in_nothing_out():
    assert link().num_edges == 0
