"""Refinement of curves' depths and places; medians that tell edges from contours."""

from dataclasses import replace

import curves as known
import numpy as np
import pytest

from colmap_edges.core.view import lift
from colmap_edges.edges2d.edge_graph import offsets_of
from colmap_edges.edges2d.edge_index import make_edge_index
from colmap_edges.edges3d.chains.curves import Curves
from colmap_edges.edges3d.chains.observing import Sums
from colmap_edges.edges3d.chains.refinement import depth_step, refine_curves
from colmap_edges.options import RefinementOptions

SPACING = 4  # points of a chain between two of a curve


def curve_on(view, curve, *, shift_px=0.0, depth_factor=1.0):
    """A curve of the reference view `view` beside the true one, every 4 px, at wrong depths."""
    graph = known.graph_of(view, [curve])
    rows = np.arange(0, len(graph.undistorted), SPACING)
    t = known.dense_parameters(view, curve)[rows]
    _, depths = view.project_undistorted(curve(t))
    return Curves(
        undistorted=graph.undistorted[rows] + shift_px * graph.normals[rows],
        inverse_depths=1 / (depth_factor * depths),
        indices=rows,
        offsets=offsets_of(np.array([len(rows)])),
        sides=np.ones(len(rows), np.int8),
    )


def chains_of(view, *curves):
    """The chains of curves in a view, in the kernels' form."""
    return make_edge_index(known.graph_of(view, list(curves)), view)


def refined_distances(reference, curves, views, curve):
    """Distances of the refined points to the true curve, in pixels of the reference."""
    own, *edge_indexes = (chains_of(view, curve) for view in (reference, *views))
    refined = refine_curves(reference, own, curves, edge_indexes, RefinementOptions(), 1)
    points = lift(reference, refined.curves.undistorted, refined.curves.inverse_depths)
    dense = curve(np.linspace(0, 1, 20001))
    apart = np.linalg.norm(points[:, None] - dense[None, ::20], axis=2).argmin(axis=1) * 20
    near = np.clip(apart[:, None] + np.arange(-20, 21), 0, len(dense) - 1)
    nearest = np.linalg.norm(points[:, None] - dense[near], axis=2).min(axis=1)
    return nearest * refined.curves.inverse_depths * reference.focal_px


@pytest.mark.parametrize(
    "curve",
    [known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1)), known.circle((0, 0, 0.1), 0.7)],
    ids=["line", "circle"],
)
def test_wrong_depths_are_corrected(curve):
    reference, *others = known.ring(7)
    curves = curve_on(reference, curve, depth_factor=1.003)
    assert np.median(refined_distances(reference, curves, others, curve)) < 0.03


@pytest.mark.parametrize("share", [0.0, 1e-16, 1e-12, 1e-9])
def test_points_seen_from_the_same_place_only_do_no_harm(share):
    """A photograph that is twice in the model moves no point: its speeds are rounding errors."""
    reference = known.ring(2)[0]
    curves = curve_on(reference, known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1)))
    count = len(curves.indices)
    speed2 = np.where(np.arange(count) % 4 == 1, 1e4, 1e4 * share**2)
    none = np.zeros(count)
    sums = Sums(
        count=np.ones(count, np.int64),
        speed2=speed2,
        slope_slope=speed2,
        slope_residual=none,
        slope_across=none,
        across_across=none,
        across_residual=none,
    )
    assert np.isfinite(depth_step(curves, sums, RefinementOptions())).all()


def test_the_driver_is_one_observation_of_many():
    curve = known.line((-0.2, -0.3, -0.4), (0.2, 0.1, 0.5))
    views = known.ring(9)
    reference, others = views[4], [*views[:4], *views[5:]]
    curves = curve_on(reference, curve, shift_px=0.5)
    # Kept on the reference view's chain, every point would stay half a pixel off.
    assert np.median(refined_distances(reference, curves, others, curve)) < 0.2


def test_a_curve_that_nothing_observes_stays():
    curve = known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1))
    reference, *others = known.ring(4)
    curves = curve_on(reference, curve)
    own, none = chains_of(reference, curve), [chains_of(view) for view in others]
    refined = refine_curves(reference, own, curves, none, RefinementOptions(), 1)
    assert np.allclose(refined.curves.undistorted, curves.undistorted)
    assert np.allclose(refined.curves.inverse_depths, curves.inverse_depths)
    assert np.isinf(refined.sigmas).all()
    assert np.isnan(refined.residuals).all()


def test_depths_never_leave_the_front():
    curve = known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1))
    reference, *others = known.ring(4)
    curves = curve_on(reference, curve)
    curves = replace(curves, inverse_depths=np.full(len(curves.undistorted), 1e-9))
    own, *edge_indexes = (chains_of(view, curve) for view in (reference, *others))
    refined = refine_curves(reference, own, curves, edge_indexes, RefinementOptions(), 1)
    assert (refined.curves.inverse_depths > 0).all()


ALONG = known.line((-1.2, 0, 0), (1.2, 0, 0))  # as the baseline of `known.row` is


def gray_along(view, *, body_only=False, seed=0):
    """The chain of `ALONG` in a view, with gray that belongs to places on the line beside it."""
    graph = known.graph_of(view, [ALONG])
    t = known.dense_parameters(view, ALONG)
    rng = np.random.default_rng(seed)
    knots = np.linspace(0, 1, 80)
    values = rng.uniform(60, 180, (2, len(knots)))
    exposure = 5.0 * view.image_id + 10 * t  # as light and cameras change it
    sides = np.stack([np.interp(t, knots, row) + exposure for row in values], axis=1)
    if body_only:  # behind the other side something else is seen from everywhere
        sides[:, 1] = np.random.default_rng(view.image_id).uniform(60, 200, len(t))
    return make_edge_index(replace(graph, sides=np.round(sides).astype(np.uint8)), view)


@pytest.mark.parametrize("body_only", [False, True])
def test_gray_beside_an_edge_along_the_baseline_tells_its_depth(body_only):
    reference, *others = known.row(6)
    own, *edge_indexes = (gray_along(view, body_only=body_only) for view in (reference, *others))
    true = curve_on(reference, ALONG)
    start = curve_on(reference, ALONG, depth_factor=1.004)
    baseline_px = np.ptp([view.center[0] for view in others]) * reference.focal_px

    def errors(weight):
        options = RefinementOptions(side_gray_weight=weight)
        refined = refine_curves(reference, own, start, edge_indexes, options, 1)
        wrong = refined.curves.inverse_depths - true.inverse_depths
        return np.median(np.abs(wrong)) * baseline_px, np.median(refined.sigmas) * baseline_px

    blind, blind_sigma = errors(0.0)
    seeing, seeing_sigma = errors(2.0)
    assert blind > 0.7  # places across the chains say nothing, so depths stay as they were
    assert seeing < 0.15
    assert seeing_sigma < 0.2 < blind_sigma


def test_gray_that_is_the_same_everywhere_moves_nothing():
    reference, *others = known.row(5)
    own, *edge_indexes = (chains_of(view, ALONG) for view in (reference, *others))
    start = curve_on(reference, ALONG, depth_factor=1.002)
    refined = refine_curves(reference, own, start, edge_indexes, RefinementOptions(), 1)
    plain = replace(RefinementOptions(), side_gray_weight=0.0)
    alone = refine_curves(reference, own, start, edge_indexes, plain, 1)
    np.testing.assert_allclose(
        refined.curves.inverse_depths, alone.curves.inverse_depths, rtol=1e-6
    )
