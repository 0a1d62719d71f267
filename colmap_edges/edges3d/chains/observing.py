"""Association of curves with the chains of other views, and their residuals."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.polylines import curve_tangents
from colmap_edges.core.view import View, lift
from colmap_edges.edges3d.chains.curves import Curves
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import RefinementOptions


@dataclass(frozen=True, kw_only=True)
class Sums:
    """Robustly weighted sums over the observations of N points, (N,) each.

    An observation has a residual, its signed distance across the chain in pixels; a slope, the
    derivative of the residual with respect to inverse depth; and a slope across, the derivative
    with respect to a shift of the reference view's pixel along a given direction.

    Attributes:
        slope_slope: squared slopes.
        slope_residual: slopes times residuals.
        slope_across: slopes times slopes across.
        across_across: squared slopes across.
        across_residual: slopes across times residuals.
        speed2: squared derivatives of the projection by inverse depth, px^2, unweighted.
        count: numbers of observations.
    """

    slope_slope: FloatArray
    slope_residual: FloatArray
    slope_across: FloatArray
    across_across: FloatArray
    across_residual: FloatArray
    speed2: FloatArray
    count: FloatArray


def associate(
    reference: View,
    curves: Curves,
    edge_indexes: list[_kernels.EdgeIndex],
    max_distance_px: float,
    max_angle_deg: float,
    num_threads: int,
) -> FloatArray:
    """(N, K) positions on the chains of K views that observe the points; NaN where none."""
    points = lift(reference, curves.undistorted, curves.inverse_depths)
    tangents = curve_tangents(points, curves.offsets)
    cosine = float(np.cos(np.radians(max_angle_deg)))
    positions: FloatArray = _kernels.associate(
        edge_indexes, points, tangents, curves.sides, max_distance_px, cosine, num_threads
    )
    positions[positions < 0] = np.nan
    return positions


def sum_observations(
    reference: View,
    curves: Curves,
    edge_indexes: list[_kernels.EdgeIndex],
    positions: FloatArray,
    directions: FloatArray | None,
    robust_scale_px: float,
    num_threads: int,
) -> Sums:
    """Sums over the observations of every point at the current depths.

    Args:
        reference: the view on whose chains the curves are.
        curves: the curves, N points.
        edge_indexes: the chains of K views.
        positions: (N, K) positions on the chains that observe the points; NaN where none.
        directions: (N, 2) unit directions in the reference view's image in which points may move;
            None if they stay on its chains.
        robust_scale_px: residual at which the weight of an observation is 1/4 (Geman-McClure).
        num_threads: threads to use; the result does not depend on it.
    """
    sums = _kernels.sum_observations(
        *placed(reference, curves),
        directions,
        positions,
        edge_indexes,
        robust_scale_px,
        num_threads,
    )
    return Sums(**{entry.name: row for entry, row in zip(fields(Sums), sums, strict=True)})


def placed(
    reference: View, curves: Curves
) -> tuple[FloatArray, FloatArray, float, FloatArray, FloatArray]:
    """Arguments of kernels: the view's pose and focal length, the curves' pixels and depths."""
    rotation, translation = reference.rotation, reference.translation
    return rotation, translation, reference.focal_px, curves.undistorted, curves.inverse_depths


@dataclass(frozen=True, kw_only=True)
class Observers:
    """The views on whose chains curves are refined.

    Attributes:
        reference: the view on whose chains the curves are.
        own: search index of its chains.
        others: the chains of the K views that may observe the curves.
        options: search radius and maximum angle of observations, noise and smoothness.
        num_threads: threads to use; results do not depend on it.
    """

    reference: View
    own: _kernels.EdgeIndex
    others: list[_kernels.EdgeIndex]
    options: RefinementOptions
    num_threads: int

    def find(self, curves: Curves, radius_px: float) -> FloatArray:
        """(N, K) positions on chains within a radius that observe the curves; NaN where none."""
        angle = self.options.max_tangent_angle_deg
        found = associate(self.reference, curves, self.others, radius_px, angle, self.num_threads)
        return drop_lone(found, curves.offsets)

    def sums(
        self, curves: Curves, positions: FloatArray, directions: FloatArray | None = None
    ) -> Sums:
        """Sums over these observations, including shifts along (N, 2) `directions` if given."""
        scale = self.options.robust_scale_px
        return sum_observations(
            self.reference, curves, self.others, positions, directions, scale, self.num_threads
        )


def drop_lone(positions: FloatArray, offsets: IntArray) -> FloatArray:
    """Keep observations only if a neighbouring point of the curve is observed on the same chain.

    Chain and curve must run in parallel: neighbouring points are observed at neighbouring
    positions in one order.
    """
    kept: FloatArray = _kernels.drop_lone(positions, offsets)
    return kept
