"""Segmentation of edges into lines and circular arcs, and estimation of the edges' noise.

The standard deviations of tracing are correct up to a factor that depends on the scene, since poses
and detection are better or worse than assumed. The estimated factor minimises the cost of
describing the edges by lines, arcs and outliers: minus log-likelihood plus half the number of
parameters times the logarithm of the number of points (BIC).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, offsets_of, ranges_of
from colmap_edges.core.curves3d import ARC, LINE
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges3d.curves.lines_and_circles import fit_lines
from colmap_edges.edges3d.curves.noise import MAX_INDEPENDENT, NUM_PARAMETERS, Noise
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

NOTHING = -1  # kind of ranges of outliers
FACTORS = 2.0 ** (np.arange(-8, 13) / 2)  # candidate factors of the standard deviations
TAILS = 3.0  # factor for heavy tails: 1 point in 100 has errors this many times as large
MAX_SAMPLE = 400  # maximum number of edges from which the noise is estimated
MIN_SAMPLE_POINTS = 8  # minimum number of points of such an edge
MAX_PLACES = 64  # candidate cuts of an edge in the exact search; the others are refined afterwards
FIRST_CORRELATION = 2.0  # initial number of correlated points that count as one
MAX_LAG = 2  # maximum lag of the correlation; beyond it errors of poses dominate
# Cost of an outlier while the factor is estimated: 4 standard deviations, squared.
FIRST_OUTLIER_COST = 16.0
MIN_RELATIVE_SIGMA = 1e-7  # minimum deviation relative to the scene's size, for rounding errors


@dataclass(frozen=True, kw_only=True)
class Segmentation:
    """Ranges of the points of edges that are one line, one arc or outliers.

    Attributes:
        bounds: (K, 2) ranges of points, end exclusive.
        kinds: (K,) LINE, ARC or NOTHING.
        offsets: (E + 1,) the ranges of edge e are offsets[e]:offsets[e + 1].
    """

    bounds: IntArray
    kinds: Int32Array
    offsets: IntArray


def segmented(
    points: FloatArray, offsets: IntArray, noise: Noise, num_threads: int
) -> Segmentation:
    """Segment polylines (CSR arrays) given the noise of their points."""
    return segmented_by_factor(points, offsets, noise, np.ones(1), OUTLIER_SIGMAS**2, num_threads)[
        1
    ]


def segmented_by_factor(
    points: FloatArray,
    offsets: IntArray,
    noise: Noise,
    factors: FloatArray,
    outlier_cost: float,
    num_threads: int,
) -> tuple[FloatArray, Segmentation]:
    """(F,) costs with deviations times each of (F,) factors, and a segmentation by the first.

    `outlier_cost` is the cost of an outlier at factor 1.
    """
    lengths = np.diff(offsets)
    costs = np.zeros((len(factors), len(lengths), 5))  # in the kernel's order
    costs[:, :, :2] = noise.parameter_costs(lengths)[:, None] * [
        NUM_PARAMETERS[LINE],
        NUM_PARAMETERS[ARC],
    ]
    # The likelihood of an outlier does not depend on the factor; that of inliers does.
    costs[:, :, 2] = np.maximum(outlier_cost - 4 * np.log(factors), 1)[:, None] / noise.correlation
    costs[:, :, 3] = (factors**2 * noise.correlation)[:, None]
    costs[:, :, 4] = MAX_INDEPENDENT * noise.correlation
    totals, bounds, kinds, piece_offsets = _kernels.cut_pieces(
        points, noise.weights, offsets, costs, MAX_PLACES, num_threads
    )
    return totals.sum(axis=1), Segmentation(bounds=bounds, kinds=kinds, offsets=piece_offsets)


def learn_noise(edges: Edges3D, num_threads: int) -> Noise:
    """Estimate the factor of the standard deviations and the correlation from the edges."""
    lengths = np.diff(edges.edge_offsets)
    noise = Noise(sigmas=stated_sigmas(edges), correlation=FIRST_CORRELATION)
    long = np.flatnonzero(lengths >= MIN_SAMPLE_POINTS)
    if not len(long):
        return noise
    chosen = long[:: -(-len(long) // MAX_SAMPLE)]
    rows = ranges_of(edges.edge_offsets[chosen], edges.edge_offsets[chosen + 1])
    points, offsets = edges.points[rows], offsets_of(lengths[chosen])
    part = replace(noise, sigmas=noise.sigmas[rows])
    totals, _ = segmented_by_factor(points, offsets, part, FACTORS, FIRST_OUTLIER_COST, num_threads)
    misses = 4 * np.log(FACTORS) * len(rows) / FIRST_CORRELATION
    factor = TAILS * FACTORS[int(np.argmin(totals + misses))]
    part = replace(part, sigmas=factor * part.sigmas)
    pieces = segmented(points, offsets, part, num_threads)
    return Noise(sigmas=factor * noise.sigmas, correlation=correlation_of(points, part, pieces))


def stated_sigmas(edges: Edges3D) -> FloatArray:
    """(N,) standard deviations from tracing; where missing, estimated from the edges' roughness."""
    points = edges.points
    known = np.isfinite(edges.sigmas) & (edges.sigmas > 0)
    bends = points[2:] - 2 * points[1:-1] + points[:-2]
    within = edges.edge_ids[2:] == edges.edge_ids[:-2]
    rough = np.linalg.norm(bends[within], axis=1) / np.sqrt(6)
    usual = float(np.median(rough)) if len(rough) else 0.0
    smallest = MIN_RELATIVE_SIGMA * float(np.ptp(points, axis=0).max(initial=0)) or 1.0
    return np.maximum(np.where(known, edges.sigmas, usual), smallest)


def correlation_of(points: FloatArray, noise: Noise, pieces: Segmentation) -> float:
    """Number of consecutive points that count as one, from the residuals of lines."""
    bounds = pieces.bounds[pieces.kinds == LINE]
    if not len(bounds):
        return noise.correlation
    lines = noise.sequences(points, bounds)
    origins, vectors = lines.principal_axes(lines.robust_weights(fit_lines(lines).squares))
    q = lines.points - origins[lines.owners]
    direction = vectors[lines.owners, 2]
    off = q - np.einsum("ij,ij->i", q, direction)[:, None] * direction
    off *= np.sqrt(lines.weights)[:, None]
    off /= np.maximum(1, np.linalg.norm(off, axis=1) / OUTLIER_SIGMAS)[:, None]
    total = 1.0
    for lag in range(1, MAX_LAG + 1):
        same = lines.owners[lag:] == lines.owners[:-lag]
        products = np.einsum("ij,ij->i", off[lag:][same], off[:-lag][same]).sum()
        shared = products / max((off[lag:][same] ** 2).sum(), 1e-300)
        if shared < 0.05:
            break
        total += 2 * float(shared)
    return total
