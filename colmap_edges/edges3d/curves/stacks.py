"""Stacks of weighted point sequences, for fitting many curves at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, offsets_of, owners_of, ranges_of

MISFIT = 3.0  # distance from a curve, in standard deviations, beyond which a point is an outlier
SOFT = 2.0  # threshold of Huber's weights, in standard deviations


@dataclass(frozen=True, kw_only=True)
class Stack:
    """Weighted sequences of points, in CSR arrays.

    Attributes:
        points: (N, 3) float64, world units.
        weights: (N,) float64 inverse variances, 1 / world units squared.
        offsets: (S + 1,) int64; sequence s is points[offsets[s]:offsets[s + 1]].
    """

    points: FloatArray
    weights: FloatArray
    offsets: IntArray

    @property
    def size(self) -> int:
        """Number of sequences."""
        return len(self.offsets) - 1

    @cached_property
    def owners(self) -> IntArray:
        """(N,) sequence of each point."""
        return owners_of(self.offsets)

    def select(self, rows: IntArray) -> Stack:
        """The selected sequences."""
        first, end = self.offsets[:-1][rows], self.offsets[1:][rows]
        points = ranges_of(first, end)
        return Stack(
            points=self.points[points],
            weights=self.weights[points],
            offsets=offsets_of(end - first),
        )

    def sums(self, values: FloatArray) -> FloatArray:
        """(S, ...) sums of (N, ...) values per sequence; no sequence may be empty."""
        if not self.size:
            return np.zeros((0, *values.shape[1:]))
        return np.asarray(np.add.reduceat(values, self.offsets[:-1], axis=0))

    def products(self, weights: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
        """(S, j, k) weighted sums of the outer products of (N, j) and (N, k) rows."""
        return self.sums((weights[:, None] * a)[:, :, None] * b[:, None])


def softened(weights: FloatArray, squares: FloatArray) -> FloatArray:
    """(N,) weights times Huber's weights for (N,) squared distances from a curve."""
    with np.errstate(divide="ignore"):
        return weights * np.minimum(1, SOFT / np.sqrt(weights * squares))


def costs_of(squares: FloatArray, shares: FloatArray | float, correlation: float) -> FloatArray:
    """(N,) costs of residuals, at most the cost of an outlier.

    Args:
        squares: (N,) squared residuals, in standard deviations.
        shares: (N,) or one divisor of the squares (`Noise.shares`).
        correlation: number of consecutive points that count as one independent point.
    """
    return np.minimum(squares / shares, MISFIT**2 / correlation)


def solved(matrices: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solutions (S, k) of (S, k, k) normal equations with slight damping, and the inverses."""
    damped = matrices.copy()
    diagonals = np.einsum("sii->si", damped)  # a view
    diagonals += 1e-12 * diagonals + 1e-300
    inverses = np.asarray(np.linalg.inv(damped), dtype=np.float64)
    return np.einsum("sij,sj->si", inverses, values), inverses
