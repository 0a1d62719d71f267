"""Planes through the neighbours of points, which average their noise and tell how large it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray

NUM_NEIGHBORS = 24  # points of a plane: noise along its normal shrinks to a third
NUM_ROUNDS = 3  # of reweighting, after which points of another surface hardly count
# Scale of the weights of residuals, in their robust standard deviations.
ROBUST_SIGMAS = 2.0
# Largest spread along the normal of a plane, relative to that across.
MAX_SPREAD = 0.1


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
    for _ in range(NUM_ROUNDS):
        weights /= weights.sum(axis=1, keepdims=True)
        centers = (weights[:, None] @ groups)[:, 0]
        offsets = groups - centers[:, None]
        spread = (offsets * weights[..., None]).transpose(0, 2, 1) @ offsets
        variances, axes = np.linalg.eigh(spread)
        residuals = (offsets @ axes[:, :, :1])[..., 0]
        sigmas = 1.4826 * np.median(np.abs(residuals), axis=1, keepdims=True)
        weights = 1 / (1 + (residuals / np.maximum(ROBUST_SIGMAS * sigmas, 1e-300)) ** 2) ** 2
    variances = np.maximum(variances, 0)
    return Planes(
        centers=centers,
        normals=axes[:, :, 0],
        sigmas=sigmas[:, 0] * np.sqrt(count / max(count - 3, 1)),
        radii=np.sqrt(variances[:, 2]),
        are_flat=variances[:, 0] < MAX_SPREAD**2 * variances[:, 1],
    )
