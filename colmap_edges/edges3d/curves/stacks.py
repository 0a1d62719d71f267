"""Stacks of weighted point sequences, for fitting many curves at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, offsets_of, owners_of, ranges_of

MISFIT = 3.0  # distance from a curve, in standard deviations, beyond which a point is an outlier
SOFT = 2.0  # threshold of Huber's weights, in standard deviations


@dataclass(frozen=True, kw_only=True)
class Stack:
    """Stretches of points, in CSR arrays.

    Attributes:
        points: (N, 3) float64, world units.
        weights: (N,) float64 over the squares of effective deviations, 1 / world units squared.
        offsets: (S + 1,) int64; stretch s is points[offsets[s]:offsets[s + 1]].
    """

    points: FloatArray
    weights: FloatArray
    offsets: IntArray

    @property
    def size(self) -> int:
        """Number of stretches."""
        return len(self.offsets) - 1

    @property
    def owners(self) -> IntArray:
        """(N,) stretch of each point."""
        return owners_of(self.offsets)

    def select(self, rows: IntArray) -> Stack:
        """Some of the stretches."""
        first, end = self.offsets[:-1][rows], self.offsets[1:][rows]
        points = ranges_of(first, end)
        return Stack(
            points=self.points[points],
            weights=self.weights[points],
            offsets=offsets_of(end - first),
        )

    def sums(self, values: FloatArray) -> FloatArray:
        """(S, ...) sums of (N, ...) values over each stretch, none of which is empty."""
        if not self.size:
            return np.zeros((0, *values.shape[1:]))
        return np.asarray(np.add.reduceat(values, self.offsets[:-1], axis=0))

    def products(self, weights: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
        """(S, j, k) sums of the outer products of (N, j) and (N, k) rows of (N,) weights."""
        return self.sums((weights[:, None] * a)[:, :, None] * b[:, None])


def softened(weights: FloatArray, squares: FloatArray) -> FloatArray:
    """(N,) weights of points whose (N,) squared distances from a curve are this (Huber's)."""
    with np.errstate(divide="ignore"):
        return weights * np.minimum(1, SOFT / np.sqrt(weights * squares))


def costs_of(squares: FloatArray, shares: FloatArray | float, correlation: float) -> FloatArray:
    """(N,) costs of residuals, none larger than that of a point of no curve.

    Args:
        squares: (N,) squares of residuals, in deviations.
        shares: (N,), or of all: by what they are divided (`Noise.shares`).
        correlation: number of successive points that say as much as one.
    """
    return np.minimum(squares / shares, MISFIT**2 / correlation)


def solved(matrices: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solutions (S, k) of (S, k, k) normal equations, and the inverses, a little damped."""
    damped = matrices.copy()
    diagonals = np.einsum("sii->si", damped)  # a view
    diagonals += 1e-12 * diagonals + 1e-300
    inverses = np.asarray(np.linalg.inv(damped), dtype=np.float64)
    return np.einsum("sij,sj->si", inverses, values), inverses
