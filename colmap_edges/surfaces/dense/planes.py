"""Planes through the neighbours of points, which average their noise and tell how large it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray

NUM_NEIGHBORS = 24  # points of a plane: noise along its normal shrinks to a third


class Planes(NamedTuple):
    """Planes of groups of points.

    Attributes:
        centers: (N, 3) weighted means.
        normals: (N, 3) unit normals, of either sign.
        sigmas: (N,) standard deviations of single points from their plane.
        radii: (N,) root mean squares of the distances along the longest axis.
        are_flat: (N,) whether the points are on a plane.
    """

    centers: FloatArray
    normals: FloatArray
    sigmas: FloatArray
    radii: FloatArray
    are_flat: BoolArray


def planes_at(groups: FloatArray) -> Planes:
    """Robust planes of (N, K, 3) points, by iteratively reweighted least squares."""
    count = groups.shape[1]
    weights = np.full(groups.shape[:2], 1 / count)
    # After three rounds, points of another surface hardly count.
    for _ in range(3):
        weights /= weights.sum(axis=1, keepdims=True)
        centers = (weights[:, None] @ groups)[:, 0]
        offsets = groups - centers[:, None]
        spread = (offsets * weights[..., None]).transpose(0, 2, 1) @ offsets
        variances, axes = np.linalg.eigh(spread)
        residuals = (offsets @ axes[:, :, :1])[..., 0]
        sigmas = 1.4826 * np.median(np.abs(residuals), axis=1, keepdims=True)
        # With a scale of two robust standard deviations.
        weights = 1 / (1 + (residuals / np.maximum(2.0 * sigmas, 1e-300)) ** 2) ** 2
    variances = np.maximum(variances, 0)
    return Planes(
        centers=centers,
        normals=axes[:, :, 0],
        sigmas=sigmas[:, 0] * np.sqrt(count / max(count - 3, 1)),
        radii=np.sqrt(variances[:, 2]),
        # At most a tenth of the spread across is along the normal.
        are_flat=variances[:, 0] < 0.1**2 * variances[:, 1],
    )
