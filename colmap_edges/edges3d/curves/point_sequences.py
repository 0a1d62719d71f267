"""Weighted sequences of points, and the least-squares steps with which curves are fitted to them.

Many sequences are fitted at once. Each fit is robust: Huber's weights limit the influence of
outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import FloatArray, RaggedTable

OUTLIER_SIGMAS = 3.0  # distance from a curve, in standard deviations, of outliers


@dataclass(frozen=True, kw_only=True)
class PointSequences(RaggedTable):
    """Weighted sequences of points, in CSR arrays.

    Attributes:
        points: (N, 3) float64, world units.
        weights: (N,) float64 inverse variances, 1 / world units squared.
        offsets: (S + 1,) int64; sequence s is points[offsets[s]:offsets[s + 1]].
    """

    points: FloatArray
    weights: FloatArray

    @property
    def size(self) -> int:
        """Number of sequences."""
        return len(self.offsets) - 1

    def sums(self, values: FloatArray) -> FloatArray:
        """(S, ...) sums of (N, ...) values per sequence; no sequence may be empty."""
        if not self.size:
            return np.zeros((0, *values.shape[1:]))
        return np.asarray(np.add.reduceat(values, self.offsets[:-1], axis=0))

    def products(self, weights: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
        """(S, j, k) weighted sums of the outer products of (N, j) and (N, k) rows."""
        return self.sums((weights[:, None] * a)[:, :, None] * b[:, None])

    def robust_weights(self, squares: FloatArray) -> FloatArray:
        """(N,) weights times Huber's weights for (N,) squared distances from a curve."""
        with np.errstate(divide="ignore"):
            # Huber's weights, with a threshold of two standard deviations.
            return self.weights * np.minimum(1, 2.0 / np.sqrt(self.weights * squares))

    def least_squares(
        self, weights: FloatArray, rows: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Solve a linear system for each sequence: (S, k) solutions, (S, k, k) covariances.

        Args:
            weights: (N,) weights of the equations.
            rows: (N, k) coefficients of the unknowns in the equation of each point.
            values: (N,) right-hand sides.
        """
        normal = self.products(weights, rows, rows)
        return solved(normal, self.sums((weights * values)[:, None] * rows))

    def principal_axes(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(S, 3) weighted means and (S, 3, 3) unit rows, the direction of largest spread last."""
        totals = self.sums(weights)[:, None]
        origins = self.sums(weights[:, None] * self.points) / totals
        q = self.points - origins[self.owners]
        spread = self.products(weights, q, q) / totals[:, :, None]
        return origins, np.swapaxes(np.linalg.eigh(spread)[1], 1, 2)

    def planes(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(S, 3) weighted means and (S, 3, 3) unit axes: two in the plane of most spread, normal.

        The first axis is the direction of largest spread.
        """
        origins, vectors = self.principal_axes(weights)
        first, second = vectors[:, 2], vectors[:, 1]
        return origins, np.stack([first, second, np.cross(first, second)], axis=1)

    def coordinates(self, origins: FloatArray, axes: FloatArray) -> FloatArray:
        """(N, 3) coordinates of the points along (S, 3, 3) axes through (S, 3) origins."""
        offset = self.points - origins[self.owners]
        return np.asarray(np.einsum("ijk,ik->ij", axes[self.owners], offset))


@dataclass(frozen=True, kw_only=True)
class Fits:
    """Lines, circles or ellipses fitted to S sequences of points.

    Attributes:
        frames: (S, 3, 3) rows: of lines a point, the unit direction, and 0; of circles and ellipses
            the centre and the half axes, the longer first.
        sigmas: (S, 5) standard deviations of the point or centre within its plane, of the centre
            across its plane, of the direction or normal (radians), and of the two radii; infinite
            where there is no fit.
        squares: (N,) squared distances of the points.
    """

    frames: FloatArray
    sigmas: FloatArray
    squares: FloatArray


def solved(matrices: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solutions (S, k) of (S, k, k) normal equations with slight damping, and the inverses."""
    damped = matrices.copy()
    diagonals = np.einsum("sii->si", damped)  # a view
    diagonals += 1e-12 * diagonals + 1e-300
    inverses = np.asarray(np.linalg.inv(damped), dtype=np.float64)
    return np.einsum("sij,sj->si", inverses, values), inverses
