"""Least-squares refinement of curves: residuals across chains in all views, and smoothness.

A curve is a run of points on a chain of its reference view. The unknowns of a point are its inverse
depth there and, in the last step, its offset from that chain. An observation on a chain of another
view constrains the point only across that chain, since a point can slide along its edge. On a
straight edge inverse depth is affine along the image line, so the smoothness term, a second
difference, vanishes. Where an edge is parallel to the epipolar lines of all views, this term
propagates depth from the ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solveh_banded

from colmap_edges.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    entries_of,
    owners_of,
)
from colmap_edges.core.view import View
from colmap_edges.edges3d.chains.curves import Curves, replace_depths
from colmap_edges.edges3d.chains.observing import Observers, Sums, drop_lone, placed
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import RefinementOptions

# half widths, in chain points, of the smoothing of intensities, coarse to fine
GRAY_REACHES = (4, 2, 1, 0)
# mean squared sine of the angles to epipolar lines that constrains depth without intensities
WELL_ACROSS = 0.25
# half width, in curve points, of the window in which intensity differences are compared
GRAY_WINDOW = 8


@dataclass(frozen=True, kw_only=True)
class Refined:
    """Refined curves and their observations.

    Attributes:
        curves: the curves at their new depths.
        positions: (N, K) positions on the chains of K views; NaN where not observed.
        residuals: (N, K) signed distances across those chains in pixels.
        drifts: (N, K) their changes by the radius of a rounded edge, pixels per pixel.
        sigmas: (N,) standard deviations of inverse depth; infinite without observations.
    """

    curves: Curves
    positions: FloatArray
    residuals: FloatArray
    drifts: FloatArray
    sigmas: FloatArray


def depth_step(curves: Curves, sums: Sums, options: RefinementOptions) -> FloatArray:
    """(N,) changes of inverse depth of one Gauss-Newton step, points staying on their chains."""
    speed = typical_speed(sums)
    return solve_smooth(curves, sums.slope_slope, -sums.slope_residual, speed, options)


def joint_step(
    curves: Curves, sums: Sums, options: RefinementOptions
) -> tuple[FloatArray, FloatArray]:
    """One Gauss-Newton step in which the reference view's chain is one observation among others.

    A point may move across this chain. Its shift does not interact with other points' shifts, so
    it is eliminated (Schur complement) before the depths are solved for.

    Returns:
        (N,) changes of inverse depth and (N,) shifts across the reference view's chain in pixels.
    """
    shared, pull = sums.slope_across, -sums.across_residual
    stiffness = sums.across_across + 1  # the reference view's own residual is zero
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
    """(N,) changes of inverse depth from (N,) information and gradient, smooth along the curves.

    `speed` (N,) is the displacement of a point's projections in pixels per unit of inverse depth.
    """
    smooth, inner = second_differences(curves.offsets)
    unit = speed[inner] / options.max_bend_px
    second = curves.inverse_depths[smooth] @ np.array([1.0, -2.0, 1.0])
    weight = unit**2 / (1 + (unit * second) ** 2)
    count = len(curves.undistorted)
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
    """(N,) root mean square of each point's speeds; the mean of all points if it has none.

    Views from the same place give no speed; a small one keeps the equations regular.
    """
    count = sums.count
    overall = np.sqrt(sums.speed2.sum() / max(count.sum(), 1)) if count.any() else 1.0
    speeds = np.where(count > 0, np.sqrt(sums.speed2 / np.maximum(count, 1)), overall)
    return np.maximum(speeds, 1e-3 * overall)


def second_differences(offsets: IntArray) -> tuple[IntArray, IntArray]:
    """(M, 3) consecutive points within curves, and (M,) the middle ones."""
    index = np.arange(max(int(offsets[-1]) - 2, 0))
    ids = owners_of(offsets)
    index = index[ids[index] == ids[index + 2]]
    return index[:, None] + np.arange(3), index + 1


def refine_curves(
    reference: View,
    own: _kernels.EdgeIndex,
    curves: Curves,
    edge_indexes: list[_kernels.EdgeIndex],
    options: RefinementOptions,
    num_threads: int,
) -> Refined:
    """Refine the depths of curves on their observations.

    Args:
        reference: the view on whose chains the curves are.
        own: search index of its chains.
        curves: the curves, N points, at depths accurate enough to find their observations.
        edge_indexes: the chains of the K views that may observe them.
        options: search radius, noise and smoothness.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The curves at their new depths, with (N, K) observations and (N,) standard deviations.
    """
    observers = Observers(
        reference=reference, own=own, others=edge_indexes, options=options, num_threads=num_threads
    )
    for radius in (options.search_radius_px, options.search_radius_px / 2):
        positions = observers.find(curves, radius)
        for _ in range(2):
            changes = depth_step(curves, observers.sums(curves, positions), options)
            curves = replace_depths(curves, curves.inverse_depths + changes)
    # In the last step only: wrong observations of earlier steps would move points off the chain.
    normals = curves.normals
    changes, shifts = joint_step(curves, observers.sums(curves, positions, normals), options)
    curves = replace(curves, undistorted=curves.undistorted + shifts[:, None] * normals)
    curves = replace_depths(curves, curves.inverse_depths + changes)
    positions = observers.find(curves, options.max_residual_px)
    curves, positions, information = align_side_gray(curves, positions, observers)
    residuals, slopes2 = _kernels.observation_residuals(
        *placed(reference, curves), positions, edge_indexes, num_threads
    )
    with np.errstate(divide="ignore"):
        sigmas = options.noise_px / np.sqrt(slopes2 + information)
    drifts = rounding_drifts(curves, positions, observers)
    return Refined(
        curves=curves, positions=positions, residuals=residuals, drifts=drifts, sigmas=sigmas
    )


def rounding_drifts(curves: Curves, positions: FloatArray, observers: Observers) -> FloatArray:
    """(N, K) changes of residuals by the radius of a rounded edge, in pixels per pixel.

    The point observed on a rounded edge moves over it with the view. Depths and shifts follow, so
    that an edge with another radius fits the observations as well as possible.
    """
    drifts: FloatArray = _kernels.rounding_drifts(
        *placed(observers.reference, curves),
        curves.normals,
        positions,
        observers.others,
        observers.options.robust_scale_px,
        observers.num_threads,
    )
    return drifts


def with_reference(values: FloatArray) -> Float32Array:
    """(N, 1 + K) values of observations; the reference view, in front, has the value 0."""
    return np.column_stack([np.zeros(len(values), np.float32), values.astype(np.float32)])


def align_side_gray(
    curves: Curves, positions: FloatArray, observers: Observers
) -> tuple[Curves, FloatArray, FloatArray]:
    """Refine depths by the photometric term along edges parallel to the epipolar lines.

    Intensity profiles along the sides of an edge determine its displacement along itself, which
    distances across chains do not. Edges parallel to the epipolar lines have no other constraint.

    Returns:
        The curves at their new depths, their (N, K) observed positions, and (N,) the information on
        inverse depth from intensities, in the units of that from distances across chains.
    """
    information = np.zeros(len(curves.indices))
    if observers.options.side_gray_weight == 0:
        return curves, positions, information
    sums = observers.sums(curves, positions)
    weak = np.flatnonzero(are_weak(curves, sums))
    if len(weak) == 0:
        return curves, positions, information
    rows, chosen = entries_of(curves.offsets, weak), curves.select(weak)
    depths, positions = curves.inverse_depths.copy(), positions.copy()
    moved, positions[rows], information[rows] = aligned(chosen, positions[rows], observers)
    depths[rows] = moved.inverse_depths
    return replace(curves, inverse_depths=depths), positions, information


def are_weak(curves: Curves, sums: Sums) -> BoolArray:
    """(E,) whether curves are along epipolar lines: their depths come from intensities."""
    across, every = (
        np.bincount(curves.curve_ids, of, len(curves.lengths))
        for of in (sums.slope_slope, sums.speed2)
    )
    return np.asarray(across < WELL_ACROSS * every)


def aligned(
    curves: Curves, positions: FloatArray, observers: Observers
) -> tuple[Curves, FloatArray, FloatArray]:
    """One pass of `align_side_gray` from coarse to fine; returns the same."""
    options, num_threads = observers.options, observers.num_threads
    weight = options.side_gray_weight * options.noise_px**2
    for reach in GRAY_REACHES:
        sums = observers.sums(curves, positions)
        information, gradient = weight * _kernels.sum_side_gray(
            *placed(observers.reference, curves),
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
            *placed(observers.reference, curves), positions, observers.others, num_threads
        )
    residuals, _ = _kernels.observation_residuals(
        *placed(observers.reference, curves), positions, observers.others, num_threads
    )
    near = np.abs(residuals) <= options.max_residual_px
    return curves, drop_lone(np.where(near, positions, np.nan), curves.offsets), information
