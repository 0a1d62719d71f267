"""Ends of edges that point at each other are led to the corner where they meet."""

import curves as known
import numpy as np
import pytest

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges2d.edge_index import look_up
from colmap_edges.edges3d.linking.corners import meet_at_corners
from colmap_edges.options import LinkingOptions, PipelineOptions

VIEWS = known.ring(6)
CORNER = np.array([0.1, -0.05, 0.2])
AXES = np.array([[1, 0.2, 0], [-0.3, 1, 0.1], [0.1, 0.3, 1]], float)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
STEP = 0.02  # between edge points, about three pixels


def arm(axis, corner=CORNER):
    """A straight curve of length 0.8 that starts at a corner."""
    return known.line(corner, corner + 0.8 * axis)


def edges_of(pieces, observing, closed):
    """Edges through points, which each of some views observes."""
    observing = list(observing)
    points = np.concatenate(pieces)
    count = len(points) * len(observing)
    return Edges3D(
        points=points,
        edge_offsets=offsets_of(np.array([len(piece) for piece in pieces])),
        closed=np.full(len(pieces), closed),
        observations=known.unplaced(
            np.arange(0, count + 1, len(observing)),
            np.tile(np.array(observing, np.int32), len(points)),
        ),
        sigmas=np.arange(1.0, len(points) + 1),
        end_nodes=np.full((len(pieces), 2), -1, np.int32),
        colors=np.zeros((len(points), 3), np.uint8),
    )


def part_of(curve, first, last):
    return known.line(*curve(np.array([first, last])))


def short_of(axis, missing, corner=CORNER):
    """Points of an arm that begins so far before its corner."""
    return corner + np.arange(missing, 0.7, STEP)[:, None] * axis


def met(pieces, chains, num_threads=1, observing=range(6), closed=False, **linking):
    """The edges in views with such chains each, led to their corners."""
    options = PipelineOptions(linking=LinkingOptions(**linking))
    edges = edges_of(pieces, observing, closed)
    return meet_at_corners(edges, views_of(chains), options, num_threads)


def views_of(chains):
    """The views with such chains each."""
    graphs = [known.graph_of(view, of) for view, of in zip(VIEWS, chains, strict=True)]
    return known.tracing_input(VIEWS, graphs)


def all_arms():
    return [arm(axis) for axis in AXES]


@pytest.mark.parametrize("num_threads", [1, 2])
@pytest.mark.parametrize("missing", [(0.03, 0.05, 0.09), (0.09, 0.08, 0.005), (-0.01, 0.04, 0)])
def test_three_edges_end_in_one_corner(missing, num_threads):
    pieces = [short_of(*of) for of in zip(AXES, missing, strict=True)]
    pieces[1] = pieces[1][::-1]
    edges = met(pieces, [all_arms()] * 6, num_threads)
    first, last = edges.edge_offsets[:-1], edges.edge_offsets[1:] - 1
    tips = [first[0], last[1], first[2]]
    np.testing.assert_allclose(edges.points[tips], np.tile(CORNER, (3, 1)), atol=1e-9)
    # Every edge goes straight from one end to the other, without a point past the corner.
    for i, axis in enumerate(AXES):
        along = (edges.points[first[i] : last[i] + 1] - CORNER) @ axis
        steps = np.diff(along if i != 1 else along[::-1])
        assert (steps > 0.4 * STEP).all()


def test_the_corner_is_observed_where_it_is_seen():
    pieces = [short_of(axis, 0.06) for axis in AXES]
    chains = [all_arms()] * 4 + [[]] * 2
    edges = met(pieces, chains)
    for tip in edges.edge_offsets[:-1]:
        [(seen, _)] = look_up(views_of(chains), edges.observations.select(np.array([tip])))
        assert seen.views.tolist() == [0, 1, 2, 3]
        expected = [VIEWS[v].project(CORNER[None])[0][0] for v in range(4)]
        np.testing.assert_allclose(seen.pixels, expected, atol=0.1)
        assert edges.sigmas[tip] == edges.sigmas[tip + 1]


@pytest.mark.parametrize(("seen", "expected"), [(2, 0), (3, 3), (6, 3)])
def test_half_of_the_views_of_an_edge_must_observe_its_corner(seen, expected):
    pieces = [short_of(axis, 0.06) for axis in AXES]
    broken = [part_of(of, 0.07, 1) for of in all_arms()]
    edges = met(pieces, [all_arms()] * seen + [broken] * (6 - seen))
    assert edges.num_points - sum(map(len, pieces)) == expected


def test_views_that_do_not_observe_the_edge_are_not_asked():
    pieces = [short_of(axis, 0.06) for axis in AXES]
    chains = [all_arms()] * 2 + [[]] + [all_arms()] * 3
    assert met(pieces, chains, observing=range(3)).num_points == sum(map(len, pieces))
    assert met(pieces, chains).num_points == sum(map(len, pieces)) + 3


def test_a_far_corner_must_be_observed_on_the_way():
    pieces = [short_of(axis, 0.14) for axis in AXES]
    assert met(pieces, [all_arms()] * 6).num_points == sum(map(len, pieces)) + 3
    broken = [part for of in all_arms() for part in (part_of(of, 0, 0.03), part_of(of, 0.17, 1))]
    assert met(pieces, [broken] * 6).num_points == sum(map(len, pieces))


def test_an_edge_that_ends_in_the_corner_stays_as_it_is():
    pieces = [short_of(axis, 0.0) for axis in AXES]
    edges = met(pieces, [all_arms()] * 6)
    assert edges.num_points == sum(map(len, pieces))
    np.testing.assert_allclose(edges.points, np.concatenate(pieces), atol=1e-9)


def test_one_edge_alone_has_no_corner():
    pieces = [short_of(AXES[0], 0.06)]
    edges = met(pieces, [all_arms()] * 6)
    np.testing.assert_array_equal(edges.points, pieces[0])


def test_the_third_edge_stays_where_it_misses_the_corner_of_two():
    aside = CORNER + 2 * STEP * np.cross(AXES[0], AXES[1])
    pieces = [short_of(AXES[0], 0.06), short_of(AXES[1], 0.06), short_of(AXES[2], 0.06, aside)]
    pieces[2] += 2 * STEP * np.cross(AXES[2], AXES[0])
    edges = met(pieces, [[*all_arms(), known.line(pieces[2][0], pieces[2][-1])]] * 6)
    added = [length - len(p) for length, p in zip(np.diff(edges.edge_offsets), pieces, strict=True)]
    assert added == [1, 1, 0]
    np.testing.assert_allclose(edges.points[edges.edge_offsets[:2]], [CORNER] * 2, atol=1e-9)


def test_nearly_parallel_lines_do_not_meet():
    axis = AXES[0] + 0.2 * AXES[1]
    pieces = [short_of(AXES[0], 0.06), short_of(axis / np.linalg.norm(axis), 0.06)]
    edges = met(pieces, [all_arms()] * 6)
    assert edges.num_points == sum(map(len, pieces))


@pytest.mark.parametrize(("reach", "expected"), [(0.0, 0), (2.0, 0), (4.0, 3)])
def test_corners_farther_than_the_option_says_stay_open(reach, expected):
    pieces = [short_of(axis, 0.06) for axis in AXES]
    edges = met(pieces, [all_arms()] * 6, max_corner_spacings=reach)
    assert edges.num_points - sum(map(len, pieces)) == expected


def test_edges_of_two_points_and_closed_ones_are_left_alone():
    short = [short_of(axis, 0.06)[:2] for axis in AXES]
    assert met(short, [all_arms()] * 6).num_points == 6
    whole = [short_of(axis, 0.06) for axis in AXES]
    assert met(whole, [all_arms()] * 6, closed=True).num_points == sum(map(len, whole))


def test_no_edges_stay_none():
    nothing = known.tracing_input((), [])
    assert meet_at_corners(Edges3D.none(), nothing, PipelineOptions(), 1).num_edges == 0


def test_the_order_of_edges_does_not_matter():
    other = CORNER + 0.8 * AXES[0]
    pieces = [short_of(axis, 0.06) for axis in AXES]
    pieces.append(short_of(AXES[1], 0.05, other))
    chains = [[*all_arms(), arm(AXES[1], other)]] * 6
    edges = met(pieces, chains)
    assert edges.num_points == sum(map(len, pieces)) + 5
    order = [3, 1, 0, 2]
    shuffled = met([pieces[i] for i in order], chains)
    tips = edges.points[edges.edge_offsets[:-1]]
    np.testing.assert_allclose(
        shuffled.points[shuffled.edge_offsets[:-1]], tips[order], rtol=0, atol=1e-12
    )
