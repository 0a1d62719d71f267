"""Least squares on the depths of curves: normal residuals in all views, smooth along the curve.

A curve is a run of points on a chain of one view, its driver; the unknown of each point is its
inverse depth there, and in the end how far it lies off that chain. An observation on a chain of
another view says only how far the point lies across that chain, since an edge point may slide
along its edge. On a straight edge inverse depth is affine along the image line, so the smoothness
term, a second difference, costs nothing there; where an edge runs along the epipolar lines of all
views it carries depth in from the ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from colmap_edges.array_types import FloatArray, IntArray
from colmap_edges.cross_check import lift
from colmap_edges.csr import owners_of
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.model import View
from colmap_edges.options import RefinementOptions


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Curves on chains of one driver view.

    Attributes:
        ideal: (N, 2) float64 points on the driver's chains, ideal pixels.
        inverse_depths: (N,) float64 in the driver.
        offsets: (E + 1,) int64 CSR of the points by curve.
        sides: (N,) int8 +1 or -1, the side of the tangent on which the edge is bright.
    """

    ideal: FloatArray
    inverse_depths: FloatArray
    offsets: IntArray
    sides: NDArray[np.int8]

    @property
    def normals(self) -> FloatArray:
        """(N, 2) unit normals of the curves in the driver's image."""
        tangents = curve_tangents(self.ideal, self.offsets)
        tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
        return np.column_stack([-tangents[:, 1], tangents[:, 0]])

    @property
    def curve_ids(self) -> IntArray:
        """(N,) curve of each point."""
        return owners_of(self.offsets)


@dataclass(frozen=True, kw_only=True)
class Linearization:
    """Residuals of all observations and how they change with inverse depth, (N, K) each.

    Attributes:
        residuals: signed distance across the chain in pixels; NaN where not observed.
        slopes: change of the residual with inverse depth.
        across: change of the residual with a shift of the driver's pixel along given directions;
            NaN without any.
        speeds: change of the projection with inverse depth in pixels, along and across.
    """

    residuals: FloatArray
    slopes: FloatArray
    across: FloatArray
    speeds: FloatArray


@dataclass(frozen=True, kw_only=True)
class Refined:
    """Refined curves and what observes them.

    Attributes:
        curves: the curves at their new depths.
        positions: (N, K) positions on the chains of K views; NaN where not observed.
        residuals: (N, K) signed distances across those chains in pixels.
        sigmas: (N,) standard deviations of inverse depth; infinite where nothing observes.
    """

    curves: Curves
    positions: FloatArray
    residuals: FloatArray
    sigmas: FloatArray


def curve_tangents(points: FloatArray, offsets: IntArray) -> FloatArray:
    """(N, 3) directions along curves of (N, 3) points by central differences."""
    first = np.repeat(offsets[:-1], np.diff(offsets))
    last = np.repeat(offsets[1:], np.diff(offsets)) - 1
    index = np.arange(len(points))
    tangents: FloatArray = (
        points[np.minimum(index + 1, last)] - points[np.maximum(index - 1, first)]
    )
    return tangents


def associate(
    driver: View,
    curves: Curves,
    edge_views: list[_kernels.EdgeView],
    max_distance_px: float,
    max_angle_deg: float,
    num_threads: int,
) -> FloatArray:
    """(N, K) positions on the chains of K views that observe the points; NaN where none."""
    points = lift(driver, curves.ideal, curves.inverse_depths)
    tangents = curve_tangents(points, curves.offsets)
    cosine = float(np.cos(np.radians(max_angle_deg)))
    columns = [
        _kernels.associate(
            view, points, tangents, curves.sides, max_distance_px, cosine, num_threads
        )
        for view in edge_views
    ]
    positions = np.column_stack(columns) if columns else np.zeros((len(points), 0))
    positions[positions < 0] = np.nan
    return positions


def linearize(
    driver: View,
    curves: Curves,
    views: list[View],
    edge_views: list[_kernels.EdgeView],
    positions: FloatArray,
    directions: FloatArray | None = None,
) -> Linearization:
    """Residuals across the observed chains and their slopes at the present depths.

    Args:
        driver: the view on whose chains the curves are.
        curves: the curves, N points.
        views: the K views.
        edge_views: their chains.
        positions: (N, K) positions on the chains that observe the points; NaN where none.
        directions: (N, 2) unit directions in the driver's image in which points may move, if any.
    """
    shape = positions.shape
    residuals, slopes, across, speeds = (np.full(shape, np.nan) for _ in range(4))
    rays = np.column_stack([curves.ideal / driver.focal_px, np.ones(len(curves.ideal))])
    for k, (view, edge_view) in enumerate(zip(views, edge_views, strict=True)):
        rows = np.flatnonzero(np.isfinite(positions[:, k]))
        if len(rows) == 0:
            continue
        rotation = view.rotation @ driver.rotation.T
        translation = view.translation - rotation @ driver.translation
        local = rays[rows] @ rotation.T + curves.inverse_depths[rows, None] * translation
        depth = local[:, 2:]
        projected = view.focal_px * local[:, :2] / depth
        moving = (view.focal_px * translation[:2] - projected * translation[2]) / depth
        at, tangent = _kernels.chain_points(edge_view, np.ascontiguousarray(positions[rows, k]))
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
        residuals[rows, k] = np.einsum("ij,ij->i", projected - at, normal)
        slopes[rows, k] = np.einsum("ij,ij->i", moving, normal)
        if directions is not None:
            turned = directions[rows] / driver.focal_px @ rotation[:, :2].T
            shifted = (view.focal_px * turned[:, :2] - projected * turned[:, 2:]) / depth
            across[rows, k] = np.einsum("ij,ij->i", shifted, normal)
        speeds[rows, k] = np.linalg.norm(moving, axis=1)
    return Linearization(residuals=residuals, slopes=slopes, across=across, speeds=speeds)


def robust_weights(residuals: FloatArray, scale: float) -> FloatArray:
    """Geman-McClure weights of residuals in pixels; 0 where there is none."""
    weights: FloatArray = np.nan_to_num(1 / (1 + (residuals / scale) ** 2) ** 2, nan=0.0)
    return weights


def depth_step(curves: Curves, linear: Linearization, options: RefinementOptions) -> FloatArray:
    """(N,) changes of inverse depth of one Gauss-Newton step, points staying on their chains."""
    weights = robust_weights(linear.residuals, options.robust_scale_px)
    slopes, residuals = np.nan_to_num(linear.slopes), np.nan_to_num(linear.residuals)
    information = np.sum(weights * slopes**2, axis=1)
    gradient = -np.sum(weights * slopes * residuals, axis=1)
    return solve_smooth(curves, information, gradient, linear.speeds, options)


def joint_step(
    curves: Curves, linear: Linearization, options: RefinementOptions
) -> tuple[FloatArray, FloatArray]:
    """One Gauss-Newton step in which the driver's chain is one observation of many.

    A point may leave it, across. How far is a point's own affair, so that it is eliminated (Schur
    complement) before the depths are solved for.

    Returns:
        (N,) changes of inverse depth and (N,) shifts across the driver's chain in pixels.
    """
    weights = robust_weights(linear.residuals, options.robust_scale_px)
    slopes, residuals = np.nan_to_num(linear.slopes), np.nan_to_num(linear.residuals)
    across = np.nan_to_num(linear.across)
    shared = np.sum(weights * slopes * across, axis=1)
    stiffness = np.sum(weights * across**2, axis=1) + 1  # the driver's own residual is zero
    pull = -np.sum(weights * across * residuals, axis=1)
    information = np.sum(weights * slopes**2, axis=1) - shared**2 / stiffness
    gradient = -np.sum(weights * slopes * residuals, axis=1) - shared * pull / stiffness
    changes = solve_smooth(curves, np.maximum(information, 0), gradient, linear.speeds, options)
    shifts: FloatArray = (pull - shared * changes) / stiffness
    return changes, shifts


def solve_smooth(
    curves: Curves,
    information: FloatArray,
    gradient: FloatArray,
    speeds: FloatArray,
    options: RefinementOptions,
) -> FloatArray:
    """(N,) changes of inverse depth by (N,) information and gradient, smooth along the curves."""
    speed = typical_speed(speeds)
    smooth, inner = second_differences(curves.offsets)
    unit = speed[inner] / options.max_bend_px
    second = curves.inverse_depths[smooth] @ np.array([1.0, -2.0, 1.0])
    weight = unit**2 / (1 + (unit * second) ** 2)
    count = len(curves.ideal)
    bands = np.zeros((3, count))  # upper form: bands[2] diagonal, [1] next, [0] next but one
    bands[2] = information + 1e-4 * speed**2 + 1e-30
    for offset, factor in ((0, 1.0), (1, 4.0), (2, 1.0)):
        np.add.at(bands[2], smooth[:, offset], factor * weight)
    np.add.at(bands[1], smooth[:, 1], -2.0 * weight)
    np.add.at(bands[1], smooth[:, 2], -2.0 * weight)
    np.add.at(bands[0], smooth[:, 2], weight)
    for offset, factor in ((0, -1.0), (1, 2.0), (2, -1.0)):
        np.add.at(gradient, smooth[:, offset], factor * weight * second)
    return np.asarray(solveh_banded(bands, gradient), np.float64)


def typical_speed(speeds: FloatArray) -> FloatArray:
    """(N,) root mean square of a point's speeds; the mean of all where it has none."""
    seen = np.isfinite(speeds)
    count = seen.sum(axis=1)
    total = np.sum(np.nan_to_num(speeds) ** 2, axis=1)
    overall = np.sqrt(total.sum() / max(count.sum(), 1)) if count.any() else 1.0
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), overall)


def second_differences(offsets: IntArray) -> tuple[IntArray, IntArray]:
    """(M, 3) consecutive points within curves, and (M,) the middle ones."""
    index = np.arange(max(int(offsets[-1]) - 2, 0))
    ids = owners_of(offsets)
    index = index[ids[index] == ids[index + 2]]
    return index[:, None] + np.arange(3), index + 1


def refine_curves(
    driver: View,
    curves: Curves,
    views: list[View],
    edge_views: list[_kernels.EdgeView],
    options: RefinementOptions,
    num_threads: int,
) -> Refined:
    """Refine the depths of curves on their observations.

    Args:
        driver: the view on whose chains the curves are.
        curves: the curves, N points, at depths near enough to find their observations.
        views: the K views that may observe them.
        edge_views: their chains in the kernels' form.
        options: search radius, noise and smoothness.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The curves at their new depths, with (N, K) observations and (N,) standard deviations.
    """
    for radius in (options.search_radius_px, options.search_radius_px / 2):
        positions = associate(
            driver, curves, edge_views, radius, options.max_tangent_angle_deg, num_threads
        )
        positions = drop_lone(positions, curves.offsets)
        for _ in range(2):
            linear = linearize(driver, curves, views, edge_views, positions)
            changes = depth_step(curves, linear, options)
            curves = replace_depths(curves, curves.inverse_depths + changes)
    # Once more, now that observations are sure: earlier, wrong ones would pull points away.
    normals = curves.normals
    linear = linearize(driver, curves, views, edge_views, positions, normals)
    changes, shifts = joint_step(curves, linear, options)
    curves = replace(curves, ideal=curves.ideal + shifts[:, None] * normals)
    curves = replace_depths(curves, curves.inverse_depths + changes)
    positions = associate(
        driver,
        curves,
        edge_views,
        options.max_residual_px,
        options.max_tangent_angle_deg,
        num_threads,
    )
    positions = drop_lone(positions, curves.offsets)
    linear = linearize(driver, curves, views, edge_views, positions)
    information = np.sum(np.nan_to_num(linear.slopes) ** 2, axis=1) / options.noise_px**2
    with np.errstate(divide="ignore"):
        sigmas = 1 / np.sqrt(information)
    return Refined(curves=curves, positions=positions, residuals=linear.residuals, sigmas=sigmas)


def replace_depths(curves: Curves, inverse_depths: FloatArray) -> Curves:
    """The curves at new depths; a depth that left the front of the driver stays as it was."""
    good = inverse_depths > 0
    return Curves(
        ideal=curves.ideal,
        inverse_depths=np.where(good, inverse_depths, curves.inverse_depths),
        offsets=curves.offsets,
        sides=curves.sides,
    )


def drop_lone(positions: FloatArray, offsets: IntArray) -> FloatArray:
    """Keep observations only where a neighbour along the curve is seen on the same chain.

    Both directions of a chain must go with the curve: neighbouring points are observed at
    neighbouring positions, in one order.
    """
    same = owners_of(offsets)
    step = np.full(positions.shape, np.nan)
    if len(positions) > 1:
        step[1:] = np.diff(positions, axis=0)
        step[1:][same[1:] != same[:-1]] = np.nan
    limit = 4 * np.nanmedian(np.abs(step)) if np.isfinite(step).any() else 0.0
    linked = np.abs(step) <= limit
    keep = linked.copy()
    keep[:-1] |= linked[1:]
    return np.where(keep, positions, np.nan)
