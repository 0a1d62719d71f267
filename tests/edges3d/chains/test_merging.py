"""Each edge once, whichever sides of it views saw; neighbours stay apart."""

from __future__ import annotations

import curves as known
import numpy as np
import pytest
from scipy.spatial import cKDTree

from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.chains.tracing import trace_edges
from colmap_edges.options import PipelineOptions

VIEWS = known.ring(12)
PIXEL = 5.0 / known.FOCAL  # length of a pixel at the origin, roughly
START, END = np.array([-0.8, -0.3, 0.1]), np.array([0.7, 0.4, -0.1])
ACROSS = np.cross(END - START, (0.0, 0.0, 1.0))
ACROSS /= np.linalg.norm(ACROSS)
# What makes the scene known well, as other edges do.
AROUND = [known.line((x, -1.2, 0), (x + 0.3, -0.8, 0.3)) for x in np.linspace(-1, 1, 6)]


def traced(curves_of_view, sides_of_view, num_threads=1):
    """The edges of views that see known curves, each with its bright side."""
    graphs = [
        known.graph_of(view, [*curves_of_view(i), *AROUND], [*sides_of_view(i), *[1] * len(AROUND)])
        for i, view in enumerate(VIEWS)
    ]
    options = PipelineOptions(refine_poses=False, num_threads=num_threads)
    found, stats = trace_edges(known.model_of(VIEWS), Graphs.of(graphs), options)
    return found.edges, stats


def on(edges, curve, distance=0.5 * PIXEL):
    """The edges most of whose points lie on a curve."""
    near = cKDTree(curve(np.linspace(0, 1, 5000))).query(edges.points)[0] < distance
    shares = np.bincount(edges.edge_ids, near, edges.num_edges) / np.diff(edges.edge_offsets)
    return np.flatnonzero(shares > 0.6)


def length(edges, edge):
    points = edges.points[edges.edge_offsets[edge] : edges.edge_offsets[edge + 1]]
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def either_side(view):
    return [1 if view % 2 else -1]


def test_an_edge_whose_sides_change_between_views_comes_once_with_all_of_them():
    curve = known.line(START, END)
    edges, stats = traced(lambda view: [curve], either_side)
    assert stats["points_merged"] > 25
    (edge,) = on(edges, curve)
    assert length(edges, edge) == pytest.approx(np.linalg.norm(END - START), rel=0.03)
    middle = (edges.edge_offsets[edge] + edges.edge_offsets[edge + 1]) // 2
    rows = slice(*edges.observations.offsets[middle : middle + 2])
    assert sorted(edges.observations.views[rows]) == list(range(len(VIEWS)))


def test_the_number_of_threads_changes_nothing():
    curve = known.line(START, END)
    one, two = (traced(lambda view: [curve], either_side, threads)[0] for threads in (1, 2))
    np.testing.assert_array_equal(one.points, two.points)
    np.testing.assert_array_equal(one.observations.positions, two.observations.positions)


@pytest.mark.parametrize(
    ("width_px", "turns"), [(2.0, False), (2.5, True), (3.0, False), (3.0, True)]
)
def test_the_two_edges_of_a_bar_stay_two(width_px, turns):
    offsets = [sign * width_px / 2 * PIXEL * ACROSS for sign in (-1, 1)]
    sides = [known.line(START + offset, END + offset) for offset in offsets]
    # Where it turns, a dark bar for some views, before the light; a bright one for others.
    edges, _ = traced(lambda view: sides, lambda view: [1, -1] if view % 2 and turns else [-1, 1])
    for side in sides:
        (edge,) = on(edges, side, 0.3 * PIXEL)
        assert length(edges, edge) == pytest.approx(np.linalg.norm(END - START), rel=0.05)


def test_copies_that_no_view_sees_beside_each_other_become_one():
    """Light that moves shifts an edge: every view sees it, but not in the same place."""
    shifted = [known.line(START + d * PIXEL * ACROSS, END + d * PIXEL * ACROSS) for d in (0, 2.5)]
    edges, _ = traced(lambda view: [shifted[view % 3 == 0]], lambda view: [1 if view % 3 else -1])
    assert len(on(edges, shifted[0])) == 1
    assert len(on(edges, shifted[1])) == 0


def test_pieces_that_overlap_in_part_become_one_edge_of_the_whole_length():
    whole = known.line(START, END)
    first = known.line(START, START + 0.65 * (END - START))
    last = known.line(START + 0.35 * (END - START), END)
    edges, _ = traced(lambda view: [first if view % 2 else last], either_side)
    (edge,) = on(edges, whole)
    assert length(edges, edge) == pytest.approx(np.linalg.norm(END - START), rel=0.03)


def test_a_circle_seen_from_both_sides_is_one_closed_edge():
    circle = known.circle((0, 0.1, 0), 0.5)
    edges, _ = traced(lambda view: [circle], either_side)
    (edge,) = on(edges, circle)
    assert edges.closed[edge]
    assert length(edges, edge) == pytest.approx(np.pi, rel=0.03)


def test_each_physical_point_is_one_point_of_the_result():
    curve = known.line(START, END)
    edges, _ = traced(lambda view: [curve], either_side)
    points, places = edges.distinct()
    assert len(points.points) == edges.num_distinct
    np.testing.assert_array_equal(points.points[places], edges.points)
    nearest = cKDTree(points.points).query(points.points, k=2)[0][:, 1]
    assert nearest.min() > 0.2 * PIXEL
