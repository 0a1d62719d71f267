"""Later rounds: what is left of the edge graphs, and what is found there."""

from __future__ import annotations

from dataclasses import replace

import curves as known
import numpy as np
import pytest
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import long_runs, owners_of
from colmap_edges.core.observations import ChainObservations
from colmap_edges.edges2d.edge_graph import keep_points
from colmap_edges.edges2d.edge_index import at_positions
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.chains.coverage import (
    among_all_points,
    mark_covered,
    what_remains,
    without_repeats,
)
from colmap_edges.edges3d.chains.filtering import FilteredCurves, Limits
from colmap_edges.edges3d.chains.traced_curves import TracedCurves, TracedObservations
from colmap_edges.edges3d.chains.tracing import trace_edges
from colmap_edges.edges3d.chains.tracing_input import make_input
from colmap_edges.edges3d.chains.view_selection import select_views
from colmap_edges.options import PipelineOptions, TracingOptions

OPTIONS = PipelineOptions(refine_poses=False, num_threads=1)
VIEWS = known.ring(9)
FENCE = [known.line((x, -1, 0), (x, 1, 0.2)) for x in np.linspace(-1, 1, 24)]
BEFORE = known.line((-0.7, -0.9, 0.5), (0.1, 0.9, 0.6))  # few views see it


def graphs_of_views(seeing):
    """Edge graphs of the fence, in views `seeing` with the line before it."""
    return [
        known.graph_of(view, [*FENCE, BEFORE] if index in seeing else FENCE)
        for index, view in enumerate(VIEWS)
    ]


def points_before(num_rounds, seeing=(3, 5, 7)):
    """Edges of the scene, and which of their points are on the line before the fence."""
    options = replace(OPTIONS, tracing=TracingOptions(num_rounds=num_rounds))
    traced, stats = trace_edges(known.model_of(VIEWS), Graphs.of(graphs_of_views(seeing)), options)
    true = BEFORE(np.linspace(0, 1, 4000))
    edges = traced.edges
    return edges, cKDTree(true).query(edges.points)[0] < 0.01, stats


def test_second_round_finds_what_few_views_see_among_much():
    first, on_line, _ = points_before(1)
    assert first.num_points > 900
    assert on_line.sum() < 10
    second, on_line, stats = points_before(2)
    assert on_line.sum() > 50
    assert cKDTree(second.points).query(first.points)[0].max() < 0.01
    owners = np.repeat(np.arange(second.num_points), np.diff(second.observations.offsets))
    rows = on_line[owners]
    assert set(second.observations.views[rows]) == {3, 5, 7}
    for view in (3, 5, 7):
        at = rows & (second.observations.views == view)
        seen, _ = VIEWS[view].project(second.points[owners[at]])
        assert np.linalg.norm(seen - second.observations.pixels[at], axis=1).max() < 1
    assert stats["views"] == len(VIEWS)
    assert stats["samples"] > stats["samples_with_depth"] > stats["samples_in_runs"] > 0


def test_second_round_stands_alone_where_the_first_finds_nothing():
    tracing = TracingOptions(min_agreeing_views=3)  # of two others at most
    model, graphs = known.model_of(VIEWS[3:6]), Graphs.of(graphs_of_views(())[3:6])
    once = replace(OPTIONS, tracing=replace(tracing, num_rounds=1))
    nothing, _ = trace_edges(model, graphs, once)
    assert nothing.edges.num_points == 0
    traced, _ = trace_edges(model, graphs, replace(OPTIONS, tracing=tracing))
    assert traced.edges.num_points > 100


def test_what_is_left_is_cut_where_curves_run():
    graph = known.graph_of(VIEWS[0], [*FENCE[:2], known.circle((0, 0, 0), 0.5)])
    offsets = graph.polyline_offsets
    assert graph.closed.tolist() == [False, False, True]
    keep = np.ones(len(graph.points), bool)
    keep[offsets[0] + 30 : offsets[0] + 50] = False
    keep[offsets[1] : offsets[2]] = False
    left = keep_points(graph, keep)
    assert left.num_polylines == 3
    assert left.closed.tolist() == [False, False, True]
    for name in ("points", "undistorted", "normals", "sides"):
        np.testing.assert_array_equal(getattr(left, name), getattr(graph, name)[keep])
    keep[offsets[2] + 5] = False
    assert not keep_points(graph, keep).closed.any()


def along(chain, views, points, reference_observes=True):
    """A curve on the same `points` of one chain in all `views`, on the chains of the first."""
    count = len(points)
    at = np.tile((chain + points)[:, None].astype(float), len(views))
    if not reference_observes:
        at[:, 0] = np.nan
    return TracedCurves(
        points=np.column_stack([points, np.zeros((count, 2))]),
        sigmas=np.ones(count),
        uncertainties=np.ones(count),
        log_chances=np.full(count, -4.0),
        offsets=np.array([0, count]),
        reference=views[0],
        observations=TracedObservations.of_table(
            np.asarray(views),
            at,
            residuals=np.ones(at.shape, np.float32),
            drifts=np.zeros(at.shape, np.float32),
        ),
    )


@pytest.fixture(scope="module")
def fence():
    model = known.model_of(VIEWS)
    near = select_views(model, PipelineOptions().view_selection)
    return make_input(model, Graphs.of(graphs_of_views(())), near)


LIMITS = Limits(uncertainty_px=1.0, residual_px=0.4, log_chance=-3.0)


def test_edges_take_what_they_run_along_and_contours_nothing(fence):
    second = fence.polyline_offsets[0][1]
    points = np.arange(40, 120, 4)
    edges, contours = (along(chain, [0, 1, 2], points) for chain in (0, second))
    kept = FilteredCurves(edges=[edges], contours=[contours], limits=LIMITS)
    rest = what_remains(fence, kept, TracingOptions())
    for view in (0, 1, 2):
        assert not rest.free[view][40:117].any()
        assert rest.free[view][second : fence.polyline_offsets[view][2]].all()
    assert rest.free[3].all()


def test_of_contours_along_the_same_chain_the_first_is_left(fence):
    first = along(0, [0, 1, 2], np.arange(40, 120, 4))
    again = along(0, [1, 0, 2], np.arange(20, 160, 4))
    elsewhere = along(0, [3, 4], np.arange(40, 120, 4))
    not_in_reference = along(0, [2, 5, 6], np.arange(40, 120, 4), reference_observes=False)
    contours = [first, again, elsewhere, not_in_reference]
    kept = FilteredCurves(edges=[], contours=contours, limits=LIMITS)
    options = TracingOptions(curve_step_points=4, min_curve_points=3)
    left, counts = without_repeats(fence, kept, options)
    assert [of.points[:, 0].tolist() for of in left.contours] == [
        [*range(40, 120, 4)],
        [*range(20, 36, 4), *range(124, 160, 4)],  # 4 px beside a point are its own
        [*range(40, 120, 4)],
        [*range(40, 120, 4)],
    ]
    assert left.contours[1].offsets.tolist() == [0, 4, 13]
    assert left.contours[1].observations.select(np.array([4])).positions.tolist() == [124] * 3
    assert counts == {"points_of_contours": 73, "points_dropped_repeated": 22}
    shorter, _ = without_repeats(fence, kept, replace(options, min_curve_points=5))
    assert shorter.contours[1].points[:, 0].tolist() == [*range(124, 160, 4)]


def test_marks_stay_on_their_polyline():
    offsets = [np.array([0, 10, 20])]
    covered = [np.zeros(20, bool)]
    observed = ChainObservations.of_table(np.array([0]), np.array([[8.5], [13.0]]))
    mark_covered(covered, offsets, observed, reach=3)
    assert np.flatnonzero(covered[0]).tolist() == [5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]
    covered[0][:] = False
    mark_covered(covered, offsets, observed.select(np.array([0])), reach=3)
    assert np.flatnonzero(covered[0]).tolist() == [5, 6, 7, 8, 9]


@pytest.mark.parametrize("size", [0, 17])
def test_short_runs_are_left_out(size):
    free = np.ones(size, bool)
    free[3:5] = False
    offsets = np.array([0, size // 2, size])
    kept = np.flatnonzero(long_runs(free, 4, owners_of(offsets))).tolist()
    assert kept == ([*range(8, 17)] if size else [])


def test_positions_are_told_on_whole_graphs():
    graph = known.graph_of(VIEWS[0], [FENCE[0], known.circle((0, 0, 0), 0.5)])
    keep = np.ones(len(graph.points), bool)
    keep[10:40] = False
    left, kept = keep_points(graph, keep), np.flatnonzero(keep)
    on_left = np.array([0.25, 12.5, 20.0, len(left.points) - 0.5])  # the last across the seam
    table = np.column_stack([np.ones(4), on_left])
    observed = ChainObservations.of_table(np.array([1, 0]), table)
    whole = among_all_points(observed, [kept, np.arange(5)]).positions.reshape(4, 2)
    np.testing.assert_allclose(
        at_positions(graph, whole[:, 1], graph.points)[0],
        at_positions(left, on_left, left.points)[0],
    )
    np.testing.assert_array_equal(whole[:, 0], 1)
