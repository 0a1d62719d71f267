"""Epipolar lines, triangulation and distances of posed pinhole views: pure numpy.

Pixels are *undistorted* (see `colmap_edges.core.view.View`). References for the kernels, which hold
faster versions of the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from colmap_edges.core.arrays import FloatArray


class PinholeView(Protocol):
    """What geometry needs of a view; `colmap_edges.core.view.View` has it."""

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation of cam_from_world."""

    @property
    def translation(self) -> FloatArray:
        """(3,) translation of cam_from_world."""

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""


def cross_matrix(vector: FloatArray) -> FloatArray:
    """(3, 3) matrix M with M @ x = vector x x."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def fundamental_matrix(view1: PinholeView, view2: PinholeView) -> FloatArray:
    """(3, 3) F with x2' F x1 = 0 for undistorted pixels x1, x2 of one scene point."""
    rotation = view2.rotation @ view1.rotation.T
    baseline = view2.rotation.T @ view2.translation - view1.rotation.T @ view1.translation
    translation = view2.rotation @ baseline
    inverse1 = np.diag([1 / view1.focal_px, 1 / view1.focal_px, 1.0])
    inverse2 = np.diag([1 / view2.focal_px, 1 / view2.focal_px, 1.0])
    result: FloatArray = inverse2 @ cross_matrix(translation) @ rotation @ inverse1
    return result


def epipolar_lines(fundamental: FloatArray, pixels: FloatArray) -> FloatArray:
    """(N, 3) lines (a, b, c), a^2 + b^2 = 1, in the second view of (N, 2) pixels of the first.

    NaN where the line is undefined (at the epipole of equal centres).
    """
    homogeneous = np.column_stack([pixels, np.ones(len(pixels))])
    lines = homogeneous @ fundamental.T
    with np.errstate(divide="ignore", invalid="ignore"):
        result: FloatArray = lines / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    return result


def view_rays(view: PinholeView, pixels: FloatArray) -> FloatArray:
    """(N, 3) unit directions in the world of the rays through (N, 2) undistorted pixels."""
    local = np.column_stack([pixels, np.full(len(pixels), view.focal_px)])
    rays = local @ view.rotation
    result: FloatArray = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return result


def triangulate(
    views: Sequence[PinholeView], pixels: FloatArray, *, iterations: int = 10
) -> FloatArray:
    """(3,) least-squares point of one undistorted pixel in each view; NaN when there is none.

    Direct linear transform, then Gauss-Newton on the reprojection errors. There is none when the
    rays are parallel or the point lies behind a view (cheirality).

    Args:
        views: the (V >= 2) views that see the point.
        pixels: (V, 2) the undistorted pixel in each.
        iterations: most Gauss-Newton steps.
    """
    missing = np.full(3, np.nan)
    point = triangulate_linear(views, pixels)
    for _ in range(iterations):
        residuals, jacobian, depths = reprojection_terms(views, pixels, point)
        if not np.all(depths > 0) or np.linalg.cond(jacobian) > 1e7:
            return missing
        step = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        point = point - step
        if np.linalg.norm(jacobian @ step) < 1e-9:
            break
    depths = reprojection_terms(views, pixels, point)[2]
    return point if np.all(depths > 0) else missing


def triangulate_linear(views: Sequence[PinholeView], pixels: FloatArray) -> FloatArray:
    """(3,) point by the direct linear transform; NaN when it is at infinity."""
    rows = []
    for view, (x, y) in zip(views, pixels, strict=True):
        matrix = np.column_stack([view.rotation, view.translation])
        rows += [
            x / view.focal_px * matrix[2] - matrix[0],
            y / view.focal_px * matrix[2] - matrix[1],
        ]
    homogeneous = np.linalg.svd(np.array(rows))[2][-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        point: FloatArray = homogeneous[:3] / homogeneous[3]
    return point if np.isfinite(point).all() else np.full(3, np.nan)


def reprojection_terms(
    views: Sequence[PinholeView], pixels: FloatArray, point: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals (2V,) in pixels, their Jacobian (2V, 3) by the point, and the depths (V,)."""
    residuals, jacobian, depths = [], [], []
    for view, pixel in zip(views, pixels, strict=True):
        x, y, z = view.rotation @ point + view.translation
        scale = view.focal_px / z if z != 0 else np.nan
        residuals += [scale * x - pixel[0], scale * y - pixel[1]]
        jacobian += [
            scale * (view.rotation[0] - x / z * view.rotation[2]),
            scale * (view.rotation[1] - y / z * view.rotation[2]),
        ]
        depths.append(z)
    return np.array(residuals), np.array(jacobian), np.array(depths)


def point_segment_distances(points: FloatArray, starts: FloatArray, ends: FloatArray) -> FloatArray:
    """(N,) distances of (N, D) points to the segments from (N, D) starts to ends."""
    along = ends - starts
    squared = np.einsum("...i,...i->...", along, along)
    projected = np.einsum("...i,...i->...", points - starts, along)
    fractions = np.clip(projected / np.where(squared > 0, squared, 1), 0, 1)
    result: FloatArray = np.linalg.norm(starts + fractions[..., None] * along - points, axis=-1)
    return result
