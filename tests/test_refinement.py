"""Refinement of curves' depths and places; medians that tell edges from outlines."""

from dataclasses import replace

import curves as known
import numpy as np
import pytest

from colmap_edges.chain_depths import make_edge_view
from colmap_edges.cross_check import lift
from colmap_edges.edge_graph import offsets_of
from colmap_edges.options import RefinementOptions
from colmap_edges.refinement import Curves, refine_curves
from colmap_edges.sorting import group_medians, row_medians


def curve_on(view, curve, *, shift_px=0.0, depth_factor=1.0):
    """A curve of the driver `view` beside the true one, every 4 px, at wrong depths."""
    graph = known.graph_of(view, [curve])
    rows = np.arange(0, len(graph.ideal), 4)
    t = known.dense_parameters(view, curve)[rows]
    _, depths = view.project_ideal(curve(t))
    return Curves(
        ideal=graph.ideal[rows] + shift_px * graph.normals[rows],
        inverse_depths=1 / (depth_factor * depths),
        offsets=offsets_of(np.array([len(rows)])),
        sides=np.ones(len(rows), np.int8),
    )


def refined_distances(driver, curves, views, curve):
    """Distances of the refined points to the true curve, in pixels of the driver."""
    edge_views = [make_edge_view(known.graph_of(view, [curve]), view) for view in views]
    refined = refine_curves(driver, curves, edge_views, RefinementOptions(), 1)
    points = lift(driver, refined.curves.ideal, refined.curves.inverse_depths)
    dense = curve(np.linspace(0, 1, 20001))
    apart = np.linalg.norm(points[:, None] - dense[None, ::20], axis=2).argmin(axis=1) * 20
    near = np.clip(apart[:, None] + np.arange(-20, 21), 0, len(dense) - 1)
    nearest = np.linalg.norm(points[:, None] - dense[near], axis=2).min(axis=1)
    return nearest * refined.curves.inverse_depths * driver.focal_px


@pytest.mark.parametrize(
    "curve",
    [known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1)), known.circle((0, 0, 0.1), 0.7)],
    ids=["line", "circle"],
)
def test_wrong_depths_are_corrected(curve):
    driver, *others = known.ring(7)
    curves = curve_on(driver, curve, depth_factor=1.003)
    assert np.median(refined_distances(driver, curves, others, curve)) < 0.03


def test_the_driver_is_one_observation_of_many():
    curve = known.line((-0.2, -0.3, -0.4), (0.2, 0.1, 0.5))
    views = known.ring(9)
    driver, others = views[4], [*views[:4], *views[5:]]
    curves = curve_on(driver, curve, shift_px=0.5)
    # Kept on the driver's chain, every point would stay half a pixel off.
    assert np.median(refined_distances(driver, curves, others, curve)) < 0.2


def test_a_curve_that_nothing_observes_stays():
    curve = known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1))
    driver, *others = known.ring(4)
    curves = curve_on(driver, curve)
    none = [make_edge_view(known.graph_of(view, []), view) for view in others]
    refined = refine_curves(driver, curves, none, RefinementOptions(), 1)
    assert np.allclose(refined.curves.ideal, curves.ideal)
    assert np.allclose(refined.curves.inverse_depths, curves.inverse_depths)
    assert np.isinf(refined.sigmas).all()
    assert np.isnan(refined.residuals).all()


def test_depths_never_leave_the_front():
    curve = known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1))
    driver, *others = known.ring(4)
    curves = curve_on(driver, curve)
    curves = replace(curves, inverse_depths=np.full(len(curves.ideal), 1e-9))
    edge_views = [make_edge_view(known.graph_of(view, [curve]), view) for view in others]
    refined = refine_curves(driver, curves, edge_views, RefinementOptions(), 1)
    assert (refined.curves.inverse_depths > 0).all()


def test_row_medians_are_those_of_what_is_finite():
    rng = np.random.default_rng(3)
    values = rng.random((40, 7))
    values[rng.random(values.shape) < 0.4] = np.nan
    values[0] = np.nan
    expected = [np.sort(row[np.isfinite(row)]) for row in values]
    expected = [row[(len(row) - 1) // 2] if len(row) else 0.0 for row in expected]
    assert np.array_equal(row_medians(values), expected)
    assert np.array_equal(row_medians(np.zeros((3, 0))), np.zeros(3))


def test_group_medians_are_those_of_each_group():
    rng = np.random.default_rng(4)
    sizes = rng.integers(1, 9, 30)
    groups = np.repeat(np.arange(30), sizes)
    values = rng.random(len(groups))
    parts = np.split(values, np.cumsum(sizes)[:-1])
    expected = [np.sort(part)[(len(part) - 1) // 2] for part in parts]
    assert np.array_equal(group_medians(values, groups, 30), expected)
    assert len(group_medians(np.zeros(0), np.zeros(0, np.int64), 0)) == 0
