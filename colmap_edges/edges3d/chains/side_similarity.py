"""Likelihood that two views see the same edge, from the intensities on its two sides.

At least one side of an edge belongs to the surface that it lies on, and looks similar in all views.
The distributions of the remaining differences of true matches (exposure, gloss, moving lights) and
of random pairs depend on the scene and are learned from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from colmap_edges.core.arrays import Float32Array, FloatArray, IntArray

BINS = np.array([0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 70, 256])  # bins of intensity differences
OUTLIER_RATE = 0.1  # share of true matches with random differences
PRIOR_COUNT = 20  # pseudo-count of matches with random differences


@dataclass(frozen=True, kw_only=True)
class SideLikelihoods:
    """Likelihood ratio of differences of side intensities: one edge against two edges.

    Attributes:
        limit: intensity levels (0 to 255); if both sides differ by more, edges are not matched.
        ratios: (B, B) likelihood ratios by the bins (`BINS`) of the smaller and the larger
            difference.
    """

    limit: float
    ratios: FloatArray

    @cached_property
    def table(self) -> Float32Array:
        """(256, 256) ratios by the differences of the dark and the bright sides; 0 for no match."""
        levels = np.arange(256)
        bins = bins_of(levels)
        small, large = np.minimum.outer(levels, levels), np.maximum.outer(levels, levels)
        ratios = self.ratios[bins[small], bins[large]]
        return np.where(small <= self.limit, ratios, 0).astype(np.float32)


NOTHING_LEARNED = SideLikelihoods(limit=255.0, ratios=np.ones((len(BINS) - 1,) * 2))


def estimate(same: IntArray, chance: IntArray) -> SideLikelihoods:
    """Learn the likelihood ratios from examples of matches.

    Args:
        same: (N, 2) differences of the dark and the bright sides of one edge in two views, in
            intensity levels; may contain outliers.
        chance: (M, 2) the same differences for random pairs of edges.

    Returns:
        The ratios; the limit is 1.5 times the 90 % quantile of the smaller difference, plus 1.
    """
    limit = 1.5 * float(np.percentile(same.min(axis=1), 90)) + 1
    same, chance = same[same.min(axis=1) <= limit], chance[chance.min(axis=1) <= limit]
    counts, by_chance = histogram(same), histogram(chance) + 1
    by_chance /= by_chance.sum()
    likely = (counts + PRIOR_COUNT * by_chance) / (counts.sum() + PRIOR_COUNT)
    ratios = (1 - OUTLIER_RATE) * likely / by_chance + OUTLIER_RATE
    return SideLikelihoods(limit=limit, ratios=ratios)


def histogram(differences: IntArray) -> FloatArray:
    """(B, B) counts of (N, 2) differences by the bins of the smaller and of the larger."""
    bins = bins_of(np.sort(differences, axis=1))
    count = len(BINS) - 1
    flat = np.bincount(bins[:, 0] * count + bins[:, 1], minlength=count * count)
    return flat.reshape(count, count).astype(np.float64)


def bins_of(differences: IntArray) -> IntArray:
    """The bin of each difference, of any shape."""
    return np.asarray(np.searchsorted(BINS, differences, "right") - 1, np.int64)
