"""Likelihood that two views see the same edge, from the intensities on its two sides.

At least one side of an edge belongs to the surface that it lies on, and looks similar in all views.
The distributions of the remaining differences of true matches (exposure, gloss, moving lights) and
of random pairs depend on the scene and are learned from it. Until enough matches are known,
differences of true matches are assumed to be distributed as half of those of random pairs.
"""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import Float32Array, FloatArray, IntArray

BINS = np.array([0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 70, 256])  # bins of intensity differences
OUTLIER_RATE = 0.1  # share of true matches with random differences
PRIOR_COUNT = 200  # pseudo-count of matches with half of random differences


def nothing_learned() -> Float32Array:
    """(256, 256) ratios of 1, with which sides make no difference."""
    return np.ones((256, 256), np.float32)


def estimate(same: IntArray, chance: IntArray) -> Float32Array:
    """Learn the likelihood ratios of differences from examples: one edge against two edges.

    Args:
        same: (N, 2) differences of the dark and the bright sides of one edge in two views, in
            intensity levels (0 to 255); may contain outliers.
        chance: (M, 2) the same differences for random pairs of edges.

    Returns:
        (256, 256) ratios by the differences of the dark and the bright sides.
    """
    by_chance, prior = histogram(chance) + 1, histogram(chance // 2) + 1
    by_chance, prior = by_chance / by_chance.sum(), prior / prior.sum()
    likely = (histogram(same) + PRIOR_COUNT * prior) / (len(same) + PRIOR_COUNT)
    ratios = (1 - OUTLIER_RATE) * likely / by_chance + OUTLIER_RATE
    levels = np.arange(256)
    bins = bins_of(levels)
    small, large = np.minimum.outer(levels, levels), np.maximum.outer(levels, levels)
    return np.asarray(ratios[bins[small], bins[large]], np.float32)


def histogram(differences: IntArray) -> FloatArray:
    """(B, B) counts of (N, 2) differences by the bins of the smaller and of the larger."""
    bins = bins_of(np.sort(differences, axis=1))
    count = len(BINS) - 1
    flat = np.bincount(bins[:, 0] * count + bins[:, 1], minlength=count * count)
    return flat.reshape(count, count).astype(np.float64)


def bins_of(differences: IntArray) -> IntArray:
    """The bin of each difference, of any shape."""
    return np.asarray(np.searchsorted(BINS, differences, "right") - 1, np.int64)
