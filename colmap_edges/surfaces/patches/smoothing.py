"""Planes through neighbouring patches of a view, which average their noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    robust_sigma,
    row_numbers,
)

NUM_LEVELS = 5  # planes of up to 32 by 32 sites
MIN_ON_PLANE = 6  # patches
MAX_ROUGHNESS, MAX_RESIDUAL = 1.5, 4.0  # of patches on a plane, in standard deviations


def smoothed(rows: Int32Array, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Patches moved onto the planes that they share with their neighbours, where there are such.

    Args:
        rows: (P, 5) of the kernel's agreed patches.
        values: (P, 7) of the same.

    Returns:
        (P, 3) inverse depths and slopes, (P,) standard deviations of these inverse depths, and
        (P,) those of single patches.
    """
    values = values.copy()
    values[:, 5] *= noise_factor(rows, values)
    planes, sigmas = values[:, 2:5].copy(), values[:, 5].copy()
    left = np.arange(len(rows))
    for level in range(NUM_LEVELS, 0, -1):
        fits = fitted_planes(values[left], cells_of(rows[left], level))
        moved = fits.is_plane
        planes[left[moved]], sigmas[left[moved]] = fits.planes[moved], fits.sigmas[moved]
        left = left[~moved]
    return planes, sigmas, values[:, 5]


def cells_of(rows: Int32Array, level: int) -> IntArray:
    """(P,) numbers, from 0, of the squares of 2 ** level sites that hold patches."""
    squares = np.column_stack([rows[:, 0], rows[:, 1] >> level, rows[:, 2] >> level])
    numbers: IntArray = np.unique(row_numbers(squares), return_inverse=True)[1]
    return numbers


def noise_factor(rows: Int32Array, values: FloatArray) -> float:
    """True standard deviations of patches over those of their correlation, at least 1.

    By the residuals of planes: most small parts of surfaces are planar.
    """
    fits = fitted_planes(values, cells_of(rows, 2))
    known = fits.residuals[np.isfinite(fits.residuals)]
    return max(1.0, robust_sigma(known)) if len(known) else 1.0


class PlaneFits(NamedTuple):
    """Planes of groups of patches, at each patch.

    Attributes:
        planes: (P, 3) inverse depths and slopes.
        sigmas: (P,) standard deviations of these inverse depths.
        residuals: (P,) distances from them, in standard deviations as if of no fit; NaN without.
        is_plane: (P,) whether all patches of the group are on its plane.
    """

    planes: FloatArray
    sigmas: FloatArray
    residuals: FloatArray
    is_plane: BoolArray


def fitted_planes(values: FloatArray, own: IntArray) -> PlaneFits:
    """Planes of groups, by weighted least squares.

    Args:
        values: (P, 7) of the kernel's agreed patches.
        own: (P,) groups, from 0.
    """
    count = int(own.max(initial=-1)) + 1
    size = np.bincount(own, minlength=count).astype(np.float64)
    sums = [np.bincount(own, axis, count) for axis in values[:, :2].T]
    mean = np.column_stack(sums) / np.maximum(size, 1)[:, None]
    design = np.column_stack([np.ones(len(own)), values[:, :2] - mean[own]])
    weights = 1 / values[:, 5] ** 2
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for i in range(3):
        right[:, i] = np.bincount(own, weights * design[:, i] * values[:, 2], count)
        for j in range(3):
            matrix[:, i, j] = np.bincount(own, weights * design[:, i] * design[:, j], count)
    scale = 1 / np.sqrt(np.maximum(matrix[:, [0, 1, 2], [0, 1, 2]], 1e-300))
    matrix *= scale[:, :, None] * scale[:, None]
    fits = (size >= MIN_ON_PLANE) & (np.linalg.det(matrix) > 1e-3)
    matrix[~fits] = np.eye(3)
    inverse = np.linalg.inv(matrix) * scale[:, :, None] * scale[:, None]
    plane = np.einsum("gij,gj->gi", inverse, right)
    planes = plane[own]
    planes[:, 0] = np.einsum("pi,pi->p", design, planes)
    sigmas = np.sqrt(np.einsum("pi,pij,pj->p", design, inverse[own], design))
    freedom = np.sqrt(size / np.maximum(size - 3, 1))[own]
    residuals = freedom * (values[:, 2] - planes[:, 0]) / values[:, 5]
    residuals[~fits[own]] = np.nan
    rough = np.sqrt(np.bincount(own, residuals**2, count) / np.maximum(size, 1))
    most = np.zeros(count)
    np.maximum.at(most, own, np.nan_to_num(np.abs(residuals)))
    is_plane = fits & (rough <= MAX_ROUGHNESS) & (most <= MAX_RESIDUAL)
    return PlaneFits(planes, sigmas, residuals, is_plane[own])
