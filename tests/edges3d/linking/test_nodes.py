"""Ends that meet share a node, one point with its own deviation and track."""

from __future__ import annotations

import curves as known
import numpy as np

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges2d.edge_index import look_up
from colmap_edges.edges3d.linking.nodes import meet_at_nodes
from colmap_edges.options import PipelineOptions

VIEWS = known.ring(6)
CORNER = np.array([0.1, -0.05, 0.2])
AXES = np.array([[1, 0.2, 0], [-0.3, 1, 0.1], [0.1, 0.3, 1]], float)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
STEP = 0.02
SIGMA = 0.001


def arm(start, axis, missing=0.0):
    """Points from so far beside a start along an axis."""
    return start + np.arange(missing, 0.7, STEP)[:, None] * axis


def met(pieces, curves, num_seeing=6, sigmas=SIGMA):
    points = np.concatenate(pieces)
    edges = Edges3D(
        points=points,
        edge_offsets=offsets_of(np.array([len(piece) for piece in pieces])),
        closed=np.zeros(len(pieces), bool),
        observations=known.unplaced(
            np.arange(0, 6 * len(points) + 1, 6),
            np.tile(np.arange(6, dtype=np.int32), len(points)),
        ),
        sigmas=np.repeat(np.full(len(pieces), sigmas), [len(piece) for piece in pieces]),
        end_nodes=np.full((len(pieces), 2), -1, np.int32),
        colors=np.zeros((len(points), 3), np.uint8),
    )
    return meet_at_nodes(edges, views_of(curves, num_seeing), PipelineOptions(), 1)


def views_of(curves, num_seeing=6):
    """Views of which so many have chains along the curves."""
    chains = [curves] * num_seeing + [[]] * (6 - num_seeing)
    graphs = [known.graph_of(view, of) for view, of in zip(VIEWS, chains, strict=True)]
    return known.tracing_input(VIEWS, graphs)


def arms_from(start, *axes):
    return [known.line(start - 0.05 * axis, start + 0.8 * axis) for axis in axes]


def test_three_ends_share_one_point_with_a_track():
    pieces = [arm(CORNER, axis, gap) for axis, gap in zip(AXES, (0.01, 0.02, 0.015), strict=True)]
    pieces[1] = pieces[1][::-1]
    edges = met(pieces, arms_from(CORNER, *AXES))
    assert edges.end_nodes.tolist() == [[0, -1], [-1, 0], [0, -1]]
    nodes = edges.nodes
    np.testing.assert_allclose(nodes.points, [CORNER], atol=SIGMA / 5)
    assert 0.2 * SIGMA < nodes.sigmas[0] < 2 * SIGMA
    assert nodes.observations.views.tolist() == list(range(6))
    expected = [view.project(CORNER[None])[0][0] for view in VIEWS]
    [(seen, _)] = look_up(views_of(arms_from(CORNER, *AXES)), nodes.observations)
    np.testing.assert_allclose(seen.pixels, expected, atol=0.3)
    first, last = edges.edge_offsets[:-1], edges.edge_offsets[1:] - 1
    tips = [first[0], last[1], first[2]]
    np.testing.assert_array_equal(edges.points[tips], nodes.points[[0, 0, 0]])
    assert edges.num_distinct == edges.num_points - 2
    assert np.flatnonzero(edges.node_ids == 0).tolist() == sorted(tips)


def test_an_end_on_an_edge_that_passes_is_a_junction():
    passing = CORNER + np.arange(-0.5, 0.5, STEP)[:, None] * AXES[0]
    ending = arm(CORNER, AXES[1], 0.03)
    through = known.line(passing[0], passing[-1])
    edges = met([passing, ending], [through, *arms_from(CORNER, AXES[1])])
    assert edges.end_nodes.tolist() == [[-1, -1], [0, -1]]
    nodes = edges.nodes
    np.testing.assert_allclose(nodes.points, [CORNER], atol=SIGMA / 5)
    place = nodes.through_points[0]
    assert edges.edge_ids[place] == 0
    np.testing.assert_array_equal(edges.points[place], nodes.points[0])
    np.testing.assert_array_equal(edges.points[edges.edge_offsets[1]], nodes.points[0])
    assert edges.num_distinct == edges.num_points - 1
    assert 0.2 * SIGMA < nodes.sigmas[0] < 2 * SIGMA
    # The passing edge stays straight and in order.
    along = (edges.points[: edges.edge_offsets[1]] - CORNER) @ AXES[0]
    assert (np.diff(along) > 0).all()


def test_an_edge_of_few_points_does_not_end_on_another():
    passing = CORNER + np.arange(-0.5, 0.5, STEP)[:, None] * AXES[0]
    through = known.line(passing[0], passing[-1])
    for count, nodes in ((2, 0), (3, 0), (4, 1)):
        ending = arm(CORNER, AXES[1], 0.03)[:count]
        edges = met([passing, ending], [through, *arms_from(CORNER, AXES[1])])
        assert len(edges.nodes.points) == nodes


def test_a_corner_that_too_few_views_observe_is_none():
    pieces = [arm(CORNER, axis, 0.015) for axis in AXES]
    assert len(met(pieces, arms_from(CORNER, *AXES), num_seeing=2).nodes.points) == 0
    assert len(met(pieces, arms_from(CORNER, *AXES), num_seeing=3).nodes.points) == 1


def test_neighbours_that_end_side_by_side_do_not_meet():
    beside = CORNER + 0.02 * AXES[2]
    pieces = [arm(CORNER, AXES[0]), arm(beside, AXES[0])]
    edges = met(pieces, [*arms_from(CORNER, AXES[0]), *arms_from(beside, AXES[0])])
    assert (edges.end_nodes == -1).all()
    np.testing.assert_array_equal(edges.points, np.concatenate(pieces))


def test_ends_led_to_a_corner_keep_it_beside_one_that_runs_elsewhere():
    aside = CORNER + 0.9 * STEP * np.cross(AXES[0], AXES[1])
    pieces = [arm(CORNER, AXES[0]), arm(CORNER, AXES[1]), arm(aside, -AXES[0])]
    edges = met(pieces, arms_from(CORNER, *AXES[:2]), sigmas=[SIGMA, SIGMA, SIGMA / 4])
    assert edges.end_nodes[:2].tolist() == [[0, -1], [0, -1]]
    np.testing.assert_allclose(edges.nodes.points[0], CORNER, atol=0.3 * STEP)


def test_two_corners_near_each_other_stay_two():
    other = CORNER + 0.04 * AXES[2]
    pieces = [arm(start, axis) for start in (CORNER, other) for axis in AXES[:2]]
    curves = [line for start in (CORNER, other) for line in arms_from(start, *AXES[:2])]
    edges = met(pieces, curves)
    assert edges.end_nodes[:, 0].tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(edges.nodes.points, [CORNER, other], atol=SIGMA / 5)


def test_no_edges_have_no_nodes():
    nothing = known.tracing_input((), [])
    assert meet_at_nodes(Edges3D.none(), nothing, PipelineOptions(), 1).num_edges == 0
