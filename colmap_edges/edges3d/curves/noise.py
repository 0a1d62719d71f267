"""The noise of edge points, and the costs of curves that follow from it (BIC).

The cost of a curve is the sum of its squared residuals, in standard deviations, plus the number of
its parameters times the logarithm of the number of independent points (Schwarz 1978).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, offsets_of, ranges_of
from colmap_edges.core.curves3d import ARC, CIRCLE, ELLIPSE, ELLIPTIC_ARC, LINE
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS, PointSequences

# Numbers of parameters of curves; those of open ones include the end along the edge.
NUM_PARAMETERS = {LINE: 5, ARC: 8, CIRCLE: 6, ELLIPTIC_ARC: 10, ELLIPSE: 8}
# Maximum number of independent points of a curve, since errors of poses and light are shared.
MAX_INDEPENDENT = 16.0


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The noise of edge points.

    Attributes:
        sigmas: (N,) effective standard deviation of each point, world units.
        correlation: number of consecutive points that count as one independent point.
    """

    sigmas: FloatArray
    correlation: float

    @property
    def weights(self) -> FloatArray:
        """(N,) inverse variances."""
        return 1 / self.sigmas**2

    @property
    def outlier_cost(self) -> float:
        """Cost of a point that belongs to no curve."""
        return OUTLIER_SIGMAS**2 / self.correlation

    def sequences(self, points: FloatArray, bounds: IntArray) -> PointSequences:
        """The sequences of (N, 3) points in (S, 2) half-open ranges."""
        rows = ranges_of(bounds[:, 0], bounds[:, 1])
        return PointSequences(
            points=points[rows],
            weights=1 / self.sigmas[rows] ** 2,
            offsets=offsets_of(bounds[:, 1] - bounds[:, 0]),
        )

    def costs(self, points: PointSequences, squares: FloatArray) -> FloatArray:
        """(S,) costs of the residuals of curves, with (N,) squared distances of their points.

        No point costs more than an outlier.
        """
        shares = (self.correlation + points.lengths / MAX_INDEPENDENT)[points.owners]
        return points.sums(np.minimum(points.weights * squares / shares, self.outlier_cost))

    def parameter_costs(self, lengths: IntArray) -> FloatArray:
        """(E,) cost of one parameter of a curve of each edge of (E,) points."""
        # The BIC of few points takes at least exp(2) of them.
        return np.log(np.maximum(lengths / self.correlation, np.exp(2.0)))
