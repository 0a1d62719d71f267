"""Ends that meet are extended to a node, one point with its own deviation and track."""

from __future__ import annotations

import curves as known
import numpy as np
import pytest

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges2d.edge_index import look_up
from colmap_edges.edges3d.linking.nodes import meet_at_nodes
from colmap_edges.options import LinkingOptions, PipelineOptions

VIEWS = known.ring(6)
CORNER = np.array([0.1, -0.05, 0.2])
AXES = np.array([[1, 0.2, 0], [-0.3, 1, 0.1], [0.1, 0.3, 1]], float)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
STEP = 0.02  # between edge points, about three pixels
SIGMA = 0.001
PASSING = CORNER + np.arange(-0.5, 0.5, STEP)[:, None] * AXES[0]


def arm(start, axis, missing=0.0):
    """Points from so far beside a start along an axis."""
    return start + np.arange(missing, 0.7, STEP)[:, None] * axis


def arms(*missing):
    """Points along all axes, each from so far before the corner."""
    return [arm(CORNER, *of) for of in zip(AXES, missing, strict=True)]


def arms_from(start, *axes, before=0.05):
    return [known.line(start - before * axis, start + 0.8 * axis) for axis in axes]


def part_of(curve, first, last):
    return known.line(*curve(np.array([first, last])))


WHOLE = arms_from(CORNER, *AXES, before=0.0)  # chains that end in the corner


def views_of(chains):
    """The views with such chains each."""
    graphs = [known.graph_of(view, of) for view, of in zip(VIEWS, chains, strict=True)]
    return known.tracing_input(VIEWS, graphs)


def met(pieces, chains, num_threads=1, observing=range(6), closed=False, sigmas=SIGMA, **linking):
    """Edges that some views observe, in views with such chains each, with nodes."""
    edges = known.observed_edges(pieces, observing, sigmas, closed)
    options = PipelineOptions(linking=LinkingOptions(**linking))
    return meet_at_nodes(edges, views_of(chains), options, num_threads)


def num_added(edges, pieces):
    return edges.num_points - sum(map(len, pieces))


@pytest.mark.parametrize("num_threads", [1, 2])
@pytest.mark.parametrize("missing", [(0.03, 0.05, 0.09), (0.09, 0.08, 0.005), (-0.01, 0.04, 0)])
def test_three_edges_are_extended_to_one_corner(missing, num_threads):
    pieces = arms(*missing)
    pieces[1] = pieces[1][::-1]
    edges = met(pieces, [WHOLE] * 6, num_threads)
    assert edges.end_nodes.tolist() == [[0, -1], [-1, 0], [0, -1]]
    np.testing.assert_allclose(edges.nodes.points, [CORNER], atol=1e-9)
    first, last = edges.edge_offsets[:-1], edges.edge_offsets[1:] - 1
    tips = [first[0], last[1], first[2]]
    np.testing.assert_array_equal(edges.points[tips], edges.nodes.points[[0, 0, 0]])
    # Every edge goes straight from one end to the other, without a point past the corner.
    for i, axis in enumerate(AXES):
        along = (edges.points[first[i] : last[i] + 1] - CORNER) @ axis
        steps = np.diff(along if i != 1 else along[::-1])
        assert (steps > 0.4 * STEP).all()


@pytest.mark.parametrize("missing", [0.06, 0.015])
def test_a_node_has_a_deviation_and_a_track_where_it_is_seen(missing):
    chains = [WHOLE] * 4 + [[]] * 2
    edges = met(arms(missing, missing, missing), chains)
    nodes = edges.nodes
    assert 0.2 * SIGMA < nodes.sigmas[0] < 2 * SIGMA
    [(seen, _)] = look_up(views_of(chains), nodes.observations, num_threads=1)
    assert seen.views.tolist() == [0, 1, 2, 3]
    expected = [view.project(CORNER[None])[0][0] for view in VIEWS[:4]]
    np.testing.assert_allclose(seen.pixels, expected, atol=0.3)
    assert edges.num_distinct == edges.num_points - 2
    assert np.flatnonzero(edges.node_ids == 0).tolist() == edges.edge_offsets[:-1].tolist()


@pytest.mark.parametrize(("seen", "expected"), [(2, 0), (3, 3), (6, 3)])
def test_half_of_the_views_of_an_edge_must_observe_its_corner(seen, expected):
    pieces = arms(0.06, 0.06, 0.06)
    broken = [part_of(of, 0.07, 1) for of in WHOLE]
    edges = met(pieces, [WHOLE] * seen + [broken] * (6 - seen))
    assert num_added(edges, pieces) == expected


def test_views_that_do_not_observe_the_edge_are_not_asked():
    pieces = arms(0.06, 0.06, 0.06)
    chains = [WHOLE] * 2 + [[]] + [WHOLE] * 3
    assert num_added(met(pieces, chains, observing=range(3)), pieces) == 0
    assert num_added(met(pieces, chains), pieces) == 3


def test_a_far_corner_must_be_observed_on_the_way():
    pieces = arms(0.14, 0.14, 0.14)
    assert num_added(met(pieces, [WHOLE] * 6), pieces) == 3
    broken = [part for of in WHOLE for part in (part_of(of, 0, 0.03), part_of(of, 0.17, 1))]
    assert num_added(met(pieces, [broken] * 6), pieces) == 0


def test_an_edge_that_ends_in_the_corner_stays_as_it_is():
    pieces = arms(0.0, 0.0, 0.0)
    edges = met(pieces, [WHOLE] * 6)
    np.testing.assert_allclose(edges.points, np.concatenate(pieces), atol=1e-9)


def test_one_edge_alone_has_no_node():
    pieces = [arm(CORNER, AXES[0], 0.06)]
    edges = met(pieces, [WHOLE] * 6)
    np.testing.assert_array_equal(edges.points, pieces[0])
    assert len(edges.nodes.points) == 0


def test_the_third_edge_stays_where_it_misses_the_corner_of_two():
    aside = CORNER + 2 * STEP * (np.cross(AXES[0], AXES[1]) + np.cross(AXES[2], AXES[0]))
    pieces = [*arms(0.06, 0.06, 0.06)[:2], arm(aside, AXES[2], 0.06)]
    edges = met(pieces, [[*WHOLE, known.line(pieces[2][0], pieces[2][-1])]] * 6)
    added = [length - len(p) for length, p in zip(np.diff(edges.edge_offsets), pieces, strict=True)]
    assert added == [1, 1, 0]
    np.testing.assert_allclose(edges.points[edges.edge_offsets[:2]], [CORNER] * 2, atol=1e-9)


def test_nearly_parallel_lines_do_not_meet():
    axis = AXES[0] + 0.2 * AXES[1]
    pieces = [arm(CORNER, of, 0.06) for of in (AXES[0], axis / np.linalg.norm(axis))]
    assert num_added(met(pieces, [WHOLE] * 6), pieces) == 0


@pytest.mark.parametrize(("reach", "expected"), [(0.0, 0), (2.0, 0), (4.0, 3)])
def test_corners_farther_than_the_option_says_stay_open(reach, expected):
    pieces = arms(0.06, 0.06, 0.06)
    edges = met(pieces, [WHOLE] * 6, max_corner_spacings=reach)
    assert num_added(edges, pieces) == expected


def test_edges_of_two_points_and_closed_ones_are_left_alone():
    short = [piece[:2] for piece in arms(0.06, 0.06, 0.06)]
    assert num_added(met(short, [WHOLE] * 6), short) == 0
    pieces = arms(0.06, 0.06, 0.06)
    assert num_added(met(pieces, [WHOLE] * 6, closed=True), pieces) == 0


def test_the_order_of_edges_does_not_matter():
    other = CORNER + 0.8 * AXES[0]
    pieces = [*arms(0.06, 0.06, 0.06), arm(other, AXES[1], 0.05)]
    chains = [[*WHOLE, *arms_from(other, AXES[1])]] * 6
    edges = met(pieces, chains)
    assert num_added(edges, pieces) == 5
    order = [3, 1, 0, 2]
    shuffled = met([pieces[i] for i in order], chains)
    tips = edges.points[edges.edge_offsets[:-1]]
    np.testing.assert_allclose(
        shuffled.points[shuffled.edge_offsets[:-1]], tips[order], rtol=0, atol=1e-12
    )


def test_an_end_on_an_edge_that_passes_is_a_junction():
    chains = [known.line(PASSING[0], PASSING[-1]), *arms_from(CORNER, AXES[1])]
    edges = met([PASSING, arm(CORNER, AXES[1], 0.03)], [chains] * 6)
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


@pytest.mark.parametrize(("count", "nodes"), [(2, 0), (3, 0), (4, 1)])
def test_an_edge_of_few_points_does_not_end_on_another(count, nodes):
    chains = [known.line(PASSING[0], PASSING[-1]), *arms_from(CORNER, AXES[1])]
    edges = met([PASSING, arm(CORNER, AXES[1], 0.03)[:count]], [chains] * 6)
    assert len(edges.nodes.points) == nodes


def test_neighbours_that_end_side_by_side_do_not_meet():
    beside = CORNER + 0.02 * AXES[2]
    pieces = [arm(CORNER, AXES[0]), arm(beside, AXES[0])]
    edges = met(pieces, [[*arms_from(CORNER, AXES[0]), *arms_from(beside, AXES[0])]] * 6)
    assert (edges.end_nodes == -1).all()
    np.testing.assert_array_equal(edges.points, np.concatenate(pieces))


def test_ends_at_a_corner_keep_it_beside_one_that_runs_elsewhere():
    aside = CORNER + 0.9 * STEP * np.cross(AXES[0], AXES[1])
    pieces = [arm(CORNER, AXES[0]), arm(CORNER, AXES[1]), arm(aside, -AXES[0])]
    chains = [arms_from(CORNER, *AXES[:2])] * 6
    edges = met(pieces, chains, sigmas=[SIGMA, SIGMA, SIGMA / 4])
    assert edges.end_nodes[:2].tolist() == [[0, -1], [0, -1]]
    np.testing.assert_allclose(edges.nodes.points[0], CORNER, atol=0.3 * STEP)


def test_two_corners_near_each_other_stay_two():
    starts = CORNER, CORNER + 0.04 * AXES[2]
    pieces = [arm(start, axis) for start in starts for axis in AXES[:2]]
    edges = met(pieces, [[line for of in starts for line in arms_from(of, *AXES[:2])]] * 6)
    assert edges.end_nodes[:, 0].tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(edges.nodes.points, starts, atol=SIGMA / 5)


def test_no_edges_have_no_nodes():
    nothing = known.tracing_input((), [])
    assert meet_at_nodes(Edges3D.none(), nothing, PipelineOptions(), 1).num_edges == 0
