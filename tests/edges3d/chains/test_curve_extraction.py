"""Samples to runs to curves: links, runs and depths between samples worked out by hand."""

import curves as known
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.view import lift
from colmap_edges.edges2d.edge_index import make_edge_index
from colmap_edges.edges3d.chains.curve_extraction import (
    densify,
    find_curves,
    link_samples,
    sure_runs,
)
from colmap_edges.edges3d.chains.depths import ChainDepths
from colmap_edges.options import TracingOptions

STEP = 8
SIGMA = 1 / 64  # so that a disparity of a pixel a pixel is a change of 1 / 8 from sample to sample


def graph_of_lengths(*lengths):
    points = np.column_stack([np.arange(sum(lengths)), np.zeros(sum(lengths))]).astype(float)
    return known.bare_graph(points, lengths)


def depths_of(samples, inverse_depths, supports=None, sigma=SIGMA):
    """Depths of samples, each with one supporting crossing unless said otherwise."""
    count = len(samples)
    supports = np.ones(count, np.int64) if supports is None else np.array(supports, np.int64)
    return ChainDepths(
        samples=np.array(samples, np.int64),
        sample_offsets=np.array([0, count]),
        inverse_depths=np.array(inverse_depths, float),
        sigmas=np.full(count, sigma),
        scores=np.ones(count),
        support_offsets=offsets_of(supports),
        support_views=np.zeros(supports.sum(), np.int32),
        support_positions=np.zeros(supports.sum()),
    )


def links(graph, depths, rows=None, **options):
    rows = np.arange(len(depths.samples)) if rows is None else np.array(rows, np.int64)
    return link_samples(graph, depths, rows, TracingOptions(**options)).tolist()


def test_samples_link_up_to_the_largest_gradient():
    depths = depths_of([0, 8, 16, 24], [1, 1.125, 1.0, 1.1251])
    assert links(graph_of_lengths(100), depths) == [True, True, False]
    assert links(graph_of_lengths(100), depths, max_disparity_gradient=1.1) == [True, True, True]


def test_more_support_allows_more_change():
    depths = depths_of([0, 8, 16], [1, 1.25, 1.5], supports=[4, 1, 1])  # sigma is of their mean
    assert links(graph_of_lengths(100), depths) == [True, False]


def test_samples_of_two_chains_do_not_link():
    depths = depths_of([2, 8, 12, 18], [1, 1, 1, 1])
    assert links(graph_of_lengths(10, 10), depths) == [True, False, True]


def test_a_missing_sample_is_bridged_where_the_gap_is_short():
    depths = depths_of([0, 8, 16, 24], [1, 0, 1, 1])
    graph = graph_of_lengths(100)
    assert links(graph, depths, rows=[0, 2, 3], max_bridge_px=16) == [True, True]
    assert links(graph, depths, rows=[0, 2, 3], max_bridge_px=15) == [False, True]
    # Where none is missing, the distance does not count.
    assert links(graph, depths, rows=[2, 3], max_bridge_px=0) == [True]


@pytest.mark.parametrize("rows", [[], [1]])
def test_one_sample_has_no_link(rows):
    depths = depths_of([0, 8], [1, 1])
    assert links(graph_of_lengths(20), depths, rows=rows) == []


def runs_of(linked, agreeing, **options):
    found = sure_runs(
        np.array(linked, bool), np.array(agreeing, np.int32), TracingOptions(**options)
    )
    return tuple(array.tolist() for array in found)


def test_runs_need_samples_and_views_that_agree():
    linked = [True, True, False, True, False, False]
    agreeing = [2, 2, 1, 2, 3, 5, 1]
    expected = ([3, 2, 1, 1], [False, True, False, False])
    assert runs_of(linked, agreeing, min_confirmed_ratio=0.7) == expected
    assert runs_of(linked, agreeing, min_confirmed_ratio=0.6)[1] == [True, True, False, False]
    assert runs_of(linked, agreeing, min_agreeing_views=3)[1] == [False] * 4


def test_no_samples_have_no_runs():
    assert runs_of([], []) == ([], [])


@given(
    st.lists(st.tuples(st.booleans(), st.integers(0, 4)), min_size=1, max_size=30),
    st.integers(1, 4),
    st.integers(2, 5),
    st.floats(0, 1),
)
def test_runs_are_told_by_walking_the_samples(rows, views, samples, ratio):
    linked, agreeing = [row[0] for row in rows[1:]], [row[1] for row in rows]
    runs = [[agreeing[0]]]
    for goes_on, count in zip(linked, agreeing[1:], strict=True):
        runs[-1].append(count) if goes_on else runs.append([count])
    sizes, kept = runs_of(
        linked,
        agreeing,
        min_agreeing_views=views,
        min_run_samples=samples,
        min_confirmed_ratio=ratio,
    )
    assert sizes == [len(run) for run in runs]
    for run, is_kept in zip(runs, kept, strict=True):
        sure = sum(count >= views for count in run)
        assert is_kept == (len(run) >= samples and sure >= ratio * len(run))


def dense(graph, samples, values, sizes, sure, **options):
    depths = depths_of(samples, values)
    found = densify(
        graph,
        depths,
        np.arange(len(samples)),
        np.array(sizes, np.int64),
        np.array(sure),
        TracingOptions(**options),
    )
    return tuple(array.tolist() for array in found)


def test_depths_are_linear_between_samples_and_beyond():
    points, inverse, runs = dense(
        graph_of_lengths(40), [8, 16, 24], [1.0, 2.0, 2.5], [3], [True],
        curve_step_points=4, extension_px=8,
    )  # fmt: skip
    assert points == [0, 4, 8, 12, 16, 20, 24, 28, 32]
    assert inverse == [1.0, 0.5, 1.0, 1.5, 2.0, 2.25, 2.5, 2.75, 3.0]  # at 0 it would be none
    assert runs == [0] * 9


def test_runs_end_where_their_chain_does_and_unsure_ones_are_left_out():
    points, inverse, runs = dense(
        graph_of_lengths(12, 30), [4, 8, 13, 15, 20, 30], [1, 1, 1, 1, 2, 4], [2, 2, 2],
        [True, False, True], curve_step_points=2, extension_px=100,
    )  # fmt: skip
    assert points == [0, 2, 4, 6, 8, 10, *range(12, 42, 2)]
    assert runs == [0] * 6 + [2] * 15
    expected = [2 + (p - 20) / 5 for p in range(12, 42, 2)]
    assert inverse == pytest.approx([1] * 6 + expected)


def test_no_sure_run_has_no_points():
    assert dense(graph_of_lengths(20), [4, 8], [1, 1], [2], [False]) == ([], [], [])


VIEW = known.looking((0.5, -4.0, 2.5))
LINE = known.line((-0.8, -0.3, 0.2), (0.7, 0.4, -0.1))


def curves_of_line(side=1, covered=(), agreeing=3, **options):
    """Curves found on a straight line whose depths are known every 24 points; and how many."""
    graph = known.graph_of(VIEW, [LINE], [side])
    t = known.dense_parameters(VIEW, LINE)
    inverse = 1 / VIEW.project_undistorted(LINE(t))[1]
    samples = np.arange(6, len(t) - 6, 24)
    hidden = np.zeros(len(t), bool)
    hidden[list(covered)] = True
    return find_curves(
        graph,
        make_edge_index(graph, VIEW),
        hidden,
        depths_of(samples, inverse[samples], sigma=1e-3),
        np.full(len(samples), agreeing, np.int32),
        TracingOptions(**options),
    )


@pytest.mark.parametrize("side", [1, -1])
def test_a_straight_line_is_found_exactly(side):
    """The inverse depth of a straight line is linear in its image."""
    found, count = curves_of_line(side)
    graph = known.graph_of(VIEW, [LINE])
    samples = np.arange(6, len(graph.points) - 6, 24)
    assert count == len(samples)
    assert found.offsets.tolist() == [0, len(found.indices)]
    end = min(samples[-1] + TracingOptions().extension_px, len(graph.points) - 1)
    expected = np.arange(0, end + 1, TracingOptions().curve_step_points)
    np.testing.assert_array_equal(found.indices, expected)
    np.testing.assert_array_equal(found.undistorted, graph.undistorted[found.indices])
    assert (found.sides == side).all()
    points = lift(VIEW, found.undistorted, found.inverse_depths)
    t = known.dense_parameters(VIEW, LINE)[found.indices]
    np.testing.assert_allclose(points, LINE(t), atol=1e-5)


def test_what_is_covered_ends_curves():
    whole, _ = curves_of_line()
    found, _ = curves_of_line(covered=range(40, 61))
    assert found.indices.tolist() == [i for i in whole.indices.tolist() if not 40 <= i <= 60]
    assert found.offsets.tolist() == [0, 10, len(found.indices)]
    # What is left of the line before is too short for an edge.
    short, _ = curves_of_line(covered=range(8, 61))
    assert short.indices.tolist() == [i for i in whole.indices.tolist() if i > 60]
    kept, _ = curves_of_line(covered=range(8, 61), min_curve_points=2)
    assert kept.offsets.tolist() == [0, 2, len(kept.indices)]


@pytest.mark.parametrize(
    "arguments", [{"agreeing": 0}, {"agreeing": 1}, {"covered": range(100)}], ids=str
)
def test_nothing_sure_or_uncovered_is_no_curve(arguments):
    if "covered" in arguments:
        size = len(known.graph_of(VIEW, [LINE]).points)
        arguments = {"covered": range(size)}
    found, count = curves_of_line(**arguments)
    assert found.offsets.tolist() == [0]
    assert len(found.indices) == len(found.sides) == 0
    assert (count > 0) == ("covered" in arguments)
