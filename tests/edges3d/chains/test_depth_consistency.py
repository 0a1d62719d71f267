from dataclasses import replace

import curves as known
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.view import lift
from colmap_edges.edges3d.chains.depth_consistency import (
    count_agreeing_views,
    depths_at,
    world_points,
)
from colmap_edges.edges3d.chains.depths import ChainDepths, compute_chain_depths
from colmap_edges.edges3d.chains.view_selection import DepthRange
from colmap_edges.options import ChainDepthOptions

RANGE = DepthRange.without_points((0.05, 1.0))
VIEW = known.looking((1.0, -4.0, 2.0), roll=0.3)


def flat_graph(*lengths):
    """Polylines of the given numbers of points."""
    parts = [np.column_stack([np.arange(n), np.full(n, 10.0 * i)]) for i, n in enumerate(lengths)]
    return known.graph_from_undistorted(VIEW, parts, parts, [False] * len(parts))


def hand_made(samples, counts, inverse, sigmas):
    """Chain depths; samples of inverse depth 0 have none."""
    inverse = np.array(inverse, float)
    support = offsets_of((inverse > 0).astype(np.int64))
    return ChainDepths(
        samples=np.array(samples),
        sample_offsets=offsets_of(np.array(counts)),
        inverse_depths=inverse,
        sigmas=np.array(sigmas, float),
        scores=np.zeros(len(inverse)),
        support_offsets=support,
        support_views=np.zeros(support[-1], np.int32),
        support_positions=np.zeros(support[-1]),
    )


def test_depths_are_linear_between_samples():
    graph = flat_graph(41, 41)
    depths = hand_made(
        [4, 12, 20, 28, 36, 45, 53, 61], [5, 3], [2, 4, 3, 0, 1, 8, 6, 7], range(1, 9)
    )
    at = np.array([0, 4, 6, 10, 12, 16, 20, 23, 25, 31, 33, 36, 40.5, 41, 45, 49, 58, 61, 81])
    inverse, sigmas = depths_at(graph, depths, at)
    nan = np.nan
    np.testing.assert_allclose(
        inverse, [2, 2, 2.5, 3.5, 4, 3.5, 3, 3, nan, nan, 1, 1, 1, 8, 8, 7, 6.625, 7, 7]
    )
    np.testing.assert_allclose(sigmas[[0, 2, 3, 12, 13, 18]], [1, 1, 2, 5, 6, 8])


def test_depth_of_a_chain_with_one_sample_is_that_everywhere():
    graph = flat_graph(5, 30)
    depths = hand_made([2, 10, 20, 30], [1, 3], [3, 5, 5, 5], [1, 1, 1, 1])
    inverse, _ = depths_at(graph, depths, np.array([0.0, 2.0, 4.9]))
    np.testing.assert_allclose(inverse, 3)
    empty, sigmas = depths_at(graph, depths, np.zeros(0))
    assert empty.shape == sigmas.shape == (0,)


coordinates = st.floats(-2, 2)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=1, max_size=8),
    st.floats(-3, 3),
    st.floats(0.01, 100),
)
def test_lift_and_projection_are_inverse(points, roll, scale):
    base = known.looking((1.0, -6.0, 2.0), roll=roll)
    view = known.make_view(base.rotation, scale * base.translation)
    world = scale * np.array(points)
    undistorted, depth = view.project_undistorted(world)
    assert (depth > 0).all()
    np.testing.assert_allclose(lift(view, undistorted, 1 / depth), world, atol=1e-9 * scale)
    pixels = np.array(points)[:, :2] * 100
    inverse = np.linspace(0.1, 0.5, len(pixels)) / scale
    again, depth = view.project_undistorted(lift(view, pixels, inverse))
    np.testing.assert_allclose(again, pixels, atol=1e-8)
    np.testing.assert_allclose(1 / depth, inverse, rtol=1e-10)


def test_samples_without_depth_have_no_point():
    graph = flat_graph(41)
    depths = hand_made([4, 12, 20, 28, 36], [5], [0.2, 0, 0.3, 0, 0.1], [1] * 5)
    points = world_points(VIEW, graph, depths)
    assert np.isnan(points).all(axis=1).tolist() == [False, True, False, True, False]
    undistorted, depth = VIEW.project_undistorted(points[[0, 2, 4]])
    np.testing.assert_allclose(undistorted, graph.undistorted[[4, 20, 36]], atol=1e-9)
    np.testing.assert_allclose(1 / depth, [0.2, 0.3, 0.1])


@pytest.fixture(scope="module")
def traced():
    """Views with their graphs, and depths, of three lines that every view sees."""
    views = known.ring(5, arc_deg=50)
    truth = [
        known.line((-0.8, -0.6, 0), (-0.5, 0.8, 0.2)),
        known.line((0.6, -0.7, 0.3), (0.3, 0.8, 0)),
        known.line((-0.2, -0.8, 0), (0.1, 0.7, 0.5)),
    ]
    graphs = [known.graph_of(view, truth, [1, -1, 1]) for view in views]
    given = known.tracing_input(views, graphs)
    return given, [
        compute_chain_depths(given, view, RANGE, ChainDepthOptions(), 1) for view in range(5)
    ]


def test_true_depths_agree_in_all_views(traced):
    given, depths = traced
    for view in range(5):
        counts = count_agreeing_views(given, depths, view, 3.0)
        assert counts.shape == depths[view].samples.shape
        assert counts.max() == 4
        assert (counts[depths[view].found] >= 3).mean() > 0.9
        np.testing.assert_array_equal(counts[~depths[view].found], 0)
        assert depths[view].found.mean() > 0.9


def test_view_with_other_depths_does_not_agree(traced):
    given, depths = traced
    wrong = replace(depths[2], inverse_depths=1.3 * depths[2].inverse_depths)
    spoiled = [*depths[:2], wrong, *depths[3:]]
    counts = count_agreeing_views(given, spoiled, 0, 3.0)
    assert counts.max() == 3
    assert (counts[depths[0].found] == 3).mean() > 0.9
    assert count_agreeing_views(given, spoiled, 2, 3.0).max() == 0


def test_allowance_is_in_pixels(traced):
    """Depths wrong by six of their sigmas, each of which is what a pixel changes."""
    given, depths = traced
    moved = replace(depths[2], inverse_depths=depths[2].inverse_depths + 6 * depths[2].sigmas)
    spoiled = [*depths[:2], moved, *depths[3:]]
    strict = count_agreeing_views(given, spoiled, 0, 3.0)
    loose = count_agreeing_views(given, spoiled, 0, 9.0)
    assert strict.max() == 3
    assert (loose[depths[0].found] == 4).mean() > 0.9


def test_missing_depths_do_not_agree(traced):
    given, depths = traced
    none = np.zeros(len(depths[1].samples) + 1, np.int64)
    blind = replace(
        depths[1],
        support_offsets=none,
        support_views=depths[1].support_views[:0],
        support_positions=depths[1].support_positions[:0],
    )
    counts = count_agreeing_views(given, [depths[0], blind, *depths[2:]], 0, 3.0)
    assert counts.max() == 3
    assert (counts[depths[0].found] == 3).mean() > 0.9
    nothing = count_agreeing_views(given, [depths[0], blind, *depths[2:]], 1, 3.0)
    assert nothing.tolist() == [0] * len(depths[1].samples)
