"""Segmentation of edges into lines and circular arcs, and estimation of the edges' noise.

The standard deviations of tracing are correct up to a factor that depends on the scene, since poses
and detection are better or worse than assumed. The estimated factor minimises the cost of
describing the edges by lines, arcs and outliers: minus log-likelihood plus half the number of
parameters times the logarithm of the number of points (BIC).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, offsets_of, ranges_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges3d.curves.rounds import fit_lines, principal_axes
from colmap_edges.edges3d.curves.stacks import MISFIT, Stack, softened
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

NOTHING, LINE, ARC = -1, 0, 1  # kinds of pieces, numbered as in the kernel
# Numbers of parameters, one of which is the end of the piece along the edge.
LINE_FREEDOM, ARC_FREEDOM = 5, 8
MIN_LOG = 2.0  # minimum logarithm of the number of points in the BIC
FACTORS = 2.0 ** (np.arange(-8, 13) / 2)  # candidate factors of the standard deviations
TAILS = 3.0  # factor for heavy tails: 1 point in 100 has errors this many times as large
MAX_SAMPLE = 400  # maximum number of edges from which the noise is estimated
MIN_SAMPLE_POINTS = 8  # minimum number of points of such an edge
MAX_PLACES = 64  # candidate cuts of an edge in the exact search; the others are refined afterwards
FIRST_CORRELATION = 2.0  # initial number of correlated points that count as one
MAX_LAG = 2  # maximum lag of the correlation; beyond it shared errors dominate (SHARED)
STRAY = 16.0  # cost of an outlier while the factor is estimated: 4 standard deviations, squared
# Maximum number of independent points of a curve, since errors of poses and light are shared.
SHARED = 16.0
SMALLEST = 1e-7  # minimum standard deviation relative to the scene's size, for rounding errors


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The noise of edge points.

    Attributes:
        sigmas: (N,) effective standard deviation of each point, world units.
        correlation: number of consecutive points that count as one independent point.
    """

    sigmas: FloatArray
    correlation: float

    def shares(self, lengths: IntArray) -> FloatArray:
        """(R,) divisors of the squared residuals of curves with (R,) numbers of points."""
        return np.asarray(self.correlation + lengths / SHARED)

    @property
    def weights(self) -> FloatArray:
        """(N,) inverse variances."""
        return 1 / self.sigmas**2


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """Pieces of edges: ranges of points that are one line, one arc or outliers.

    Attributes:
        bounds: (K, 2) range of points, end exclusive.
        kinds: (K,) LINE, ARC or NOTHING.
        offsets: (E + 1,) pieces of edge e are offsets[e]:offsets[e + 1].
    """

    bounds: IntArray
    kinds: Int32Array
    offsets: IntArray


def stated_sigmas(edges: Edges3D) -> FloatArray:
    """(N,) standard deviations from tracing; where missing, estimated from the edges' roughness."""
    points = edges.points
    known = np.isfinite(edges.sigmas) & (edges.sigmas > 0)
    bends = points[2:] - 2 * points[1:-1] + points[:-2]
    within = edges.edge_ids[2:] == edges.edge_ids[:-2]
    rough = np.linalg.norm(bends[within], axis=1) / np.sqrt(6)
    usual = float(np.median(rough)) if len(rough) else 0.0
    smallest = SMALLEST * float(np.ptp(points, axis=0).max(initial=0)) or 1.0
    return np.maximum(np.where(known, edges.sigmas, usual), smallest)


def log_counts(lengths: IntArray, correlation: float) -> FloatArray:
    """(E,) logarithms of the numbers of independent points of edges with (E,) points."""
    return np.log(np.maximum(lengths / correlation, np.exp(MIN_LOG)))


def learn_noise(edges: Edges3D, num_threads: int) -> Noise:
    """Estimate the factor of the standard deviations and the correlation from the edges."""
    sigmas = stated_sigmas(edges)
    lengths = np.diff(edges.edge_offsets)
    long = np.flatnonzero(lengths >= MIN_SAMPLE_POINTS)
    if not len(long):
        return Noise(sigmas=sigmas, correlation=FIRST_CORRELATION)
    chosen = long[:: -(-len(long) // MAX_SAMPLE)]
    rows = ranges_of(edges.edge_offsets[chosen], edges.edge_offsets[chosen + 1])
    points, offsets = edges.points[rows], offsets_of(lengths[chosen])
    costs = cut_costs(lengths[chosen], FACTORS, FIRST_CORRELATION, STRAY)
    totals, *_ = _kernels.cut_pieces(
        points, 1 / sigmas[rows] ** 2, offsets, costs, MAX_PLACES, num_threads
    )
    misses = 4 * np.log(FACTORS) * len(rows) / FIRST_CORRELATION
    best = int(np.argmin(totals.sum(axis=1) + misses))
    sigmas = TAILS * FACTORS[best] * sigmas
    first = Noise(sigmas=sigmas[rows], correlation=FIRST_CORRELATION)
    pieces = cut(points, offsets, first, num_threads)
    return Noise(sigmas=sigmas, correlation=correlation_of(points, first, pieces))


def cut_costs(
    lengths: IntArray, factors: FloatArray, correlation: float, stray: float
) -> FloatArray:
    """(F, E, 5) costs in the kernel's order, for edges of (E,) points and (F,) factors.

    `stray` is the cost of an outlier at factor 1.
    """
    costs = np.zeros((len(factors), len(lengths), 5))
    logs = log_counts(lengths, correlation)
    costs[:, :, 0], costs[:, :, 1] = LINE_FREEDOM * logs, ARC_FREEDOM * logs
    # The likelihood of an outlier does not depend on the factor; that of inliers does.
    costs[:, :, 2] = np.maximum(stray - 4 * np.log(factors), 1)[:, None] / correlation
    costs[:, :, 3] = (factors**2 * correlation)[:, None]
    costs[:, :, 4] = SHARED * correlation
    return costs


def cut(points: FloatArray, offsets: IntArray, noise: Noise, num_threads: int) -> Pieces:
    """Segment polylines (CSR arrays) given the noise of their points."""
    costs = cut_costs(np.diff(offsets), np.ones(1), noise.correlation, MISFIT**2)
    _, bounds, kinds, piece_offsets = _kernels.cut_pieces(
        points, noise.weights, offsets, costs, MAX_PLACES, num_threads
    )
    return Pieces(bounds=bounds, kinds=kinds, offsets=piece_offsets)


def correlation_of(points: FloatArray, noise: Noise, pieces: Pieces) -> float:
    """Number of consecutive points that count as one, from the residuals of lines."""
    bounds = pieces.bounds[pieces.kinds == LINE]
    if not len(bounds):
        return noise.correlation
    rows = ranges_of(bounds[:, 0], bounds[:, 1])
    stack = Stack(
        points=points[rows],
        weights=noise.weights[rows],
        offsets=offsets_of(bounds[:, 1] - bounds[:, 0]),
    )
    origins, vectors = principal_axes(stack, softened(stack.weights, fit_lines(stack).squares))
    q = stack.points - origins[stack.owners]
    direction = vectors[stack.owners, 2]
    off = (q - np.einsum("ij,ij->i", q, direction)[:, None] * direction) / noise.sigmas[rows, None]
    off /= np.maximum(1, np.linalg.norm(off, axis=1) / MISFIT)[:, None]
    total = 1.0
    for lag in range(1, MAX_LAG + 1):
        same = stack.owners[lag:] == stack.owners[:-lag]
        products = np.einsum("ij,ij->i", off[lag:][same], off[:-lag][same]).sum()
        shared = products / max((off[lag:][same] ** 2).sum(), 1e-300)
        if shared < 0.05:
            break
        total += 2 * float(shared)
    return total
