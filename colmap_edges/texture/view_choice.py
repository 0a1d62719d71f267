"""The view that gives the texture of each triangle, mostly that of its neighbours."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    medians_of,
    offsets_of,
    ranks_of,
    robust_sigma,
)
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.texture.gains import USABLE_LEVELS, gained
from colmap_edges.texture.seen_faces import SeenFaces

# What a triangle costs is the logarithm of the area and contrast that its view lacks to the best
# one, and these terms; two neighbours of different views cost SEAM.
SEAM = 1.0
HIDDEN = 20.0  # cost of a hidden triangle, multiplied by its hidden share
NEAR = 3.0  # cost of one beside a body that hides what is behind it, multiplied by the share
SATURATED = 2.0  # cost of a mean colour with a saturated channel, which gains cannot correct
STRANGE = 5.0  # cost of a colour unlike that in other views, which shows something else
MIN_SIGMA = 0.03  # least standard deviation of logarithms of colours between views
MAX_CANDIDATES = 12  # most views that are compared for a triangle, the cheapest
NUM_SWEEPS = 8  # sweeps of message passing, there and back


def choose_views(seen: SeenFaces, gains: FloatArray, pairs: Int32Array) -> IntArray:
    """The chosen pair of each triangle.

    Args:
        seen: the pairs of triangles and views.
        gains: (V, 3) of `find_gains`.
        pairs: (P, 2) neighbouring triangles.

    Returns:
        (F,) rows of `seen`; -1 of triangles that no view sees.
    """
    costs = costs_of(seen, gains)
    rows = cheapest(seen, costs)
    offsets = offsets_of(np.bincount(seen.faces[rows], minlength=len(seen.offsets) - 1))
    chosen = _kernels.label_views(offsets, seen.views[rows], costs[rows], pairs, SEAM, NUM_SWEEPS)
    if not len(rows):
        return np.full(len(chosen), -1)
    return np.where(chosen >= 0, rows[np.minimum(offsets[:-1] + chosen, len(rows) - 1)], -1)


def costs_of(seen: SeenFaces, gains: FloatArray) -> FloatArray:
    """(C,) the cost of each pair of a triangle and a view."""
    if not len(seen.views):
        return np.zeros(0)
    # Noise and plain walls have slopes as well, so that a view is worth its area at least.
    qualities = np.log(seen.areas * (seen.slopes + np.median(seen.slopes) + 1e-6) + 1e-12)
    lacks = best_of(seen, qualities) - qualities
    hidden = HIDDEN * (1 - seen.shares) + NEAR * (1 - seen.clear)
    saturated = SATURATED * (seen.colors > USABLE_LEVELS[1]).any(axis=1)
    return np.asarray(lacks + hidden + saturated + STRANGE * strangeness(seen, gains))


def best_of(seen: SeenFaces, values: FloatArray) -> FloatArray:
    """(C,) the largest value of each triangle, for each of its pairs."""
    starts = seen.offsets[:-1][np.diff(seen.offsets) > 0]
    largest = np.maximum.reduceat(values, starts)
    return np.repeat(largest, np.diff(seen.offsets)[np.diff(seen.offsets) > 0])


def strangeness(seen: SeenFaces, gains: FloatArray) -> FloatArray:
    """(C,) how unlike the median over a triangle's views its colour is: 0 if not, then more.

    Two views cannot tell which of them is strange.
    """
    logs = np.log(gained(seen.colors, gains[seen.views]) + 4)
    counts = np.diff(seen.offsets)
    residuals = np.zeros(len(logs))
    for channel in logs.T:
        medians = medians_of(channel, seen.faces, len(counts))
        residuals = np.maximum(residuals, np.abs(channel - np.repeat(medians, counts)))
    sigma = max(robust_sigma(residuals), MIN_SIGMA)
    unlike = np.log(np.maximum(residuals / sigma, 1))
    return np.where(np.repeat(counts, counts) > 2, unlike, 0.0)


def by_face(seen: SeenFaces, values: FloatArray) -> IntArray:
    """The order of pairs by triangle, then by value."""
    low, high = values.min(initial=0), values.max(initial=0)
    return np.argsort(seen.faces + 0.5 * (values - low) / max(high - low, 1e-300), kind="stable")


def cheapest(seen: SeenFaces, costs: FloatArray) -> IntArray:
    """Ascending rows of the cheapest pairs of each triangle, at most `MAX_CANDIDATES`."""
    order = by_face(seen, costs)
    return np.sort(order[ranks_of(np.diff(seen.offsets)) < MAX_CANDIDATES])


def neighbours(faces: Int32Array) -> tuple[Int32Array, IntArray]:
    """(P, 2) triangles that share a side, and (P, 2) vertices of the side."""
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = sides[:, 0] * (int(faces.max(initial=0)) + 1) + sides[:, 1]
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    owners = np.column_stack([order[same], order[same + 1]]) // 3
    return owners.astype(np.int32), sides[order[same]]
