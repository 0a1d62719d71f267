"""Least squares on the depths of curves: normal residuals in all views, smooth along the curve.

A curve is a run of points on a chain of one view, its driver; the unknown of each point is its
inverse depth there, and in the end how far it lies off that chain. An observation on a chain of
another view says only how far the point lies across that chain, since an edge point may slide
along its edge. On a straight edge inverse depth is affine along the image line, so the smoothness
term, a second difference, costs nothing there; where an edge runs along the epipolar lines of all
views it carries depth in from the ends.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from colmap_edges.array_types import FloatArray, IntArray
from colmap_edges.cross_check import lift
from colmap_edges.csr import entries_of, offsets_of, owners_of
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.model import View
from colmap_edges.options import RefinementOptions

GRAY_REACHES = (4, 2, 1, 0)  # points of chains over which gray is smoothed: coarse, then fine
WELL_ACROSS = 0.25  # mean squared sine of the angles to epipolar lines that is enough for depth
GRAY_WINDOW = 8  # points of a curve to both sides within which differences of gray are compared


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Curves on chains of one driver view.

    Attributes:
        ideal: (N, 2) float64 points on the driver's chains, ideal pixels.
        inverse_depths: (N,) float64 in the driver.
        indices: (N,) int64 the same in the driver's graph.
        offsets: (E + 1,) int64 CSR of the points by curve.
        sides: (N,) int8 +1 or -1, the side of the tangent on which the edge is bright.
    """

    ideal: FloatArray
    inverse_depths: FloatArray
    indices: IntArray
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

    def select(self, curves: IntArray) -> tuple[IntArray, Curves]:
        """The points of some curves, ascending, and those curves alone."""
        rows = entries_of(self.offsets, curves)
        return rows, Curves(
            ideal=self.ideal[rows],
            inverse_depths=self.inverse_depths[rows],
            indices=self.indices[rows],
            offsets=offsets_of(np.diff(self.offsets)[curves]),
            sides=self.sides[rows],
        )


@dataclass(frozen=True, kw_only=True)
class Sums:
    """Sums over the observations of N points, weighted by how well they fit, (N,) each.

    An observation has a residual, its signed distance across the chain in pixels, a slope, by
    which that changes with inverse depth, and one across, by which it changes with a shift of the
    driver's pixel along a given direction.

    Attributes:
        slope_slope: squared slopes.
        slope_residual: slopes times residuals.
        slope_across: slopes times those across.
        across_across: squared slopes across.
        across_residual: slopes across times residuals.
        speed2: squared change of the projection with inverse depth, px^2, without weights.
        count: observations.
    """

    slope_slope: FloatArray
    slope_residual: FloatArray
    slope_across: FloatArray
    across_across: FloatArray
    across_residual: FloatArray
    speed2: FloatArray
    count: FloatArray


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
    positions: FloatArray = _kernels.associate(
        edge_views, points, tangents, curves.sides, max_distance_px, cosine, num_threads
    )
    positions[positions < 0] = np.nan
    return positions


def sum_observations(
    driver: View,
    curves: Curves,
    edge_views: list[_kernels.EdgeView],
    positions: FloatArray,
    directions: FloatArray,
    robust_scale_px: float,
    num_threads: int,
) -> Sums:
    """Sums over the observations of every point at the present depths.

    Args:
        driver: the view on whose chains the curves are.
        curves: the curves, N points.
        edge_views: the chains of K views.
        positions: (N, K) positions on the chains that observe the points; NaN where none.
        directions: (N, 2) unit directions in the driver's image in which points may move.
        robust_scale_px: residual at which an observation counts a quarter (Geman-McClure).
        num_threads: threads to use; the result does not depend on it.
    """
    sums = _kernels.sum_observations(
        *placed(driver, curves), directions, positions, edge_views, robust_scale_px, num_threads
    )
    return Sums(**{entry.name: row for entry, row in zip(fields(Sums), sums, strict=True)})


def placed(
    driver: View, curves: Curves
) -> tuple[FloatArray, FloatArray, float, FloatArray, FloatArray]:
    """The driver's pose and focal length, and the curves' pixels and inverse depths."""
    rotation, translation = driver.rotation, driver.translation
    return rotation, translation, driver.focal_px, curves.ideal, curves.inverse_depths


def depth_step(curves: Curves, sums: Sums, options: RefinementOptions) -> FloatArray:
    """(N,) changes of inverse depth of one Gauss-Newton step, points staying on their chains."""
    speed = typical_speed(sums)
    return solve_smooth(curves, sums.slope_slope, -sums.slope_residual, speed, options)


def joint_step(
    curves: Curves, sums: Sums, options: RefinementOptions
) -> tuple[FloatArray, FloatArray]:
    """One Gauss-Newton step in which the driver's chain is one observation of many.

    A point may leave it, across. How far is a point's own affair, so that it is eliminated (Schur
    complement) before the depths are solved for.

    Returns:
        (N,) changes of inverse depth and (N,) shifts across the driver's chain in pixels.
    """
    shared, pull = sums.slope_across, -sums.across_residual
    stiffness = sums.across_across + 1  # the driver's own residual is zero
    information = np.maximum(sums.slope_slope - shared**2 / stiffness, 0)
    gradient = -sums.slope_residual - shared * pull / stiffness
    changes = solve_smooth(curves, information, gradient, typical_speed(sums), options)
    shifts: FloatArray = (pull - shared * changes) / stiffness
    return changes, shifts


def solve_smooth(
    curves: Curves,
    information: FloatArray,
    gradient: FloatArray,
    speed: FloatArray,
    options: RefinementOptions,
) -> FloatArray:
    """(N,) changes of inverse depth by (N,) information and gradient, smooth along the curves.

    `speed` (N,) is by how many pixels a change of inverse depth moves a point's projections.
    """
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


def typical_speed(sums: Sums) -> FloatArray:
    """(N,) root mean square of a point's speeds; the mean of all where it has none."""
    count = sums.count
    overall = np.sqrt(sums.speed2.sum() / max(count.sum(), 1)) if count.any() else 1.0
    return np.where(count > 0, np.sqrt(sums.speed2 / np.maximum(count, 1)), overall)


def second_differences(offsets: IntArray) -> tuple[IntArray, IntArray]:
    """(M, 3) consecutive points within curves, and (M,) the middle ones."""
    index = np.arange(max(int(offsets[-1]) - 2, 0))
    ids = owners_of(offsets)
    index = index[ids[index] == ids[index + 2]]
    return index[:, None] + np.arange(3), index + 1


@dataclass(frozen=True, kw_only=True)
class Observers:
    """The views that curves are refined on.

    Attributes:
        driver: the view on whose chains the curves are.
        own: its chains, in the kernels' form.
        others: the chains of the K views that may observe the curves.
        options: how near and how parallel an observation is, noise and smoothness.
        num_threads: threads to use; no result depends on it.
    """

    driver: View
    own: _kernels.EdgeView
    others: list[_kernels.EdgeView]
    options: RefinementOptions
    num_threads: int

    def find(self, curves: Curves, radius_px: float) -> FloatArray:
        """(N, K) positions at which the curves are observed within a radius; NaN where not."""
        angle = self.options.max_tangent_angle_deg
        found = associate(self.driver, curves, self.others, radius_px, angle, self.num_threads)
        return drop_lone(found, curves.offsets)

    def sums(
        self, curves: Curves, positions: FloatArray, directions: FloatArray | None = None
    ) -> Sums:
        """Sums over these observations; of shifts in (N, 2) directions, too, where given."""
        directions = np.zeros_like(curves.ideal) if directions is None else directions
        scale = self.options.robust_scale_px
        return sum_observations(
            self.driver, curves, self.others, positions, directions, scale, self.num_threads
        )


def refine_curves(
    driver: View,
    own: _kernels.EdgeView,
    curves: Curves,
    edge_views: list[_kernels.EdgeView],
    options: RefinementOptions,
    num_threads: int,
) -> Refined:
    """Refine the depths of curves on their observations.

    Args:
        driver: the view on whose chains the curves are.
        own: its chains, in the kernels' form.
        curves: the curves, N points, at depths near enough to find their observations.
        edge_views: the chains of the K views that may observe them.
        options: search radius, noise and smoothness.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The curves at their new depths, with (N, K) observations and (N,) standard deviations.
    """
    observers = Observers(
        driver=driver, own=own, others=edge_views, options=options, num_threads=num_threads
    )
    for radius in (options.search_radius_px, options.search_radius_px / 2):
        positions = observers.find(curves, radius)
        for _ in range(2):
            changes = depth_step(curves, observers.sums(curves, positions), options)
            curves = replace_depths(curves, curves.inverse_depths + changes)
    # Once more, now that observations are sure: earlier, wrong ones would pull points away.
    normals = curves.normals
    changes, shifts = joint_step(curves, observers.sums(curves, positions, normals), options)
    curves = replace(curves, ideal=curves.ideal + shifts[:, None] * normals)
    curves = replace_depths(curves, curves.inverse_depths + changes)
    positions = observers.find(curves, options.max_residual_px)
    curves, positions, information = align_side_gray(curves, positions, observers)
    residuals, slopes2 = _kernels.observation_residuals(
        *placed(driver, curves), positions, edge_views, num_threads
    )
    with np.errstate(divide="ignore"):
        sigmas = options.noise_px / np.sqrt(slopes2 + information)
    return Refined(curves=curves, positions=positions, residuals=residuals, sigmas=sigmas)


def align_side_gray(
    curves: Curves, positions: FloatArray, observers: Observers
) -> tuple[Curves, FloatArray, FloatArray]:
    """Refine depths also by the gray beside the edges, which runs alike along them in all views.

    It tells how far a curve is moved along itself, of which its places across the chains say
    nothing: the only thing to be known where an edge runs along the epipolar lines.

    Returns:
        The curves at their new depths, (N, K) positions at which they are observed there, and (N,)
        what gray added to the information on inverse depth, in units of that of places across.
    """
    information = np.zeros(len(curves.indices))
    if observers.options.side_gray_weight == 0:
        return curves, positions, information
    sums = observers.sums(curves, positions)
    count = len(curves.offsets) - 1
    across, every = (
        np.bincount(curves.curve_ids, of, count) for of in (sums.slope_slope, sums.speed2)
    )
    weak = np.flatnonzero(across < WELL_ACROSS * every)
    if len(weak) == 0:
        return curves, positions, information
    rows, chosen = curves.select(weak)
    depths, positions = curves.inverse_depths.copy(), positions.copy()
    moved, positions[rows], information[rows] = aligned(chosen, positions[rows], observers)
    depths[rows] = moved.inverse_depths
    return replace(curves, inverse_depths=depths), positions, information


def aligned(
    curves: Curves, positions: FloatArray, observers: Observers
) -> tuple[Curves, FloatArray, FloatArray]:
    """The curves at depths at which the gray beside them is alike, too: as `align_side_gray`."""
    options, num_threads = observers.options, observers.num_threads
    weight = options.side_gray_weight * options.noise_px**2
    for reach in GRAY_REACHES:
        sums = observers.sums(curves, positions)
        information, gradient = weight * _kernels.sum_side_gray(
            *placed(observers.driver, curves),
            positions,
            observers.others,
            observers.own,
            curves.indices,
            curves.offsets,
            reach,
            GRAY_WINDOW,
            num_threads,
        )
        changes = solve_smooth(
            curves,
            sums.slope_slope + information,
            gradient - sums.slope_residual,
            typical_speed(sums),
            options,
        )
        curves = replace_depths(curves, curves.inverse_depths + changes)
        positions = _kernels.slide_positions(
            *placed(observers.driver, curves), positions, observers.others, num_threads
        )
    residuals, _ = _kernels.observation_residuals(
        *placed(observers.driver, curves), positions, observers.others, num_threads
    )
    near = np.abs(residuals) <= options.max_residual_px
    return curves, drop_lone(np.where(near, positions, np.nan), curves.offsets), information


def replace_depths(curves: Curves, inverse_depths: FloatArray) -> Curves:
    """The curves at new depths; a depth that left the front of the driver stays as it was."""
    depths = np.where(inverse_depths > 0, inverse_depths, curves.inverse_depths)
    return replace(curves, inverse_depths=depths)


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
