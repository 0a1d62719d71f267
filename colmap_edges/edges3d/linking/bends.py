"""Cutting of edges at sharp bends in space.

Chains are cut at corners that are visible in the image. An edge can continue around a corner if
the reference views see it nearly unbent, or if its pieces were joined across it.

Two models with the same number of parameters are compared: one polynomial, or two of lower degree.
The one with smaller residuals is significantly better if the ratio of the squared residuals
exceeds the quantile of the F distribution (F test).
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import nearest_on_lines, unit
from colmap_edges.edges3d.linking.ends import MAX_MISS_SPACINGS, MIN_ANGLE_DEG

SIDE_POINTS = 6  # points at an end, or on each side of a bend, to which curves are fitted


def cut_at_bends(edges: Edges3D) -> Edges3D:
    """Cut edges where two parabolas that meet at an angle are significantly better than one curve.

    Closed edges are cut only if they have at least two bends.
    """
    bends = find_bends(edges)
    if not len(bends):
        return edges
    owners, offsets, sizes = edges.edge_ids, edges.edge_offsets, np.diff(edges.edge_offsets)
    first, last = (np.searchsorted(bends, of) for of in (offsets[:-1], offsets[1:]))
    # A closed edge begins at its first bend.
    shifts, rolled = np.zeros(edges.num_edges, np.int64), edges.closed & (last > first)
    shifts[rolled] = bends[first[rolled]] - offsets[:-1][rolled]
    ranks = np.arange(edges.num_points) - offsets[owners]
    order = offsets[owners] + (ranks + shifts[owners]) % sizes[owners]
    of = owners[bends]
    cuts = offsets[of] + (ranks[bends] - shifts[of]) % sizes[of]
    pieces = np.unique(np.append(offsets, cuts))
    return edges.reordered(order, pieces, (edges.closed & ~rolled)[owners[pieces[:-1]]])


def find_bends(edges: Edges3D) -> IntArray:
    """(B,) indices of the points before which edges are to be cut, ascending."""
    owners, offsets = edges.edge_ids, edges.edge_offsets
    sizes, loops = np.diff(offsets)[owners], edges.closed[owners]
    ranks = np.arange(edges.num_points) - offsets[owners]
    to_end = np.where(loops, sizes // 2, np.minimum(ranks, sizes - 1 - ranks))
    at = np.flatnonzero((to_end >= SIDE_POINTS) & (sizes > 2 * SIDE_POINTS))
    steps = np.arange(-SIDE_POINTS, SIDE_POINTS + 1)
    windows = edges.points[offsets[owners[at], None] + (ranks[at, None] + steps) % sizes[at, None]]
    turning = turn_somewhat(windows)
    ratios, ahead = bend_ratios(windows[turning])
    sharp = ratios > 1
    places, ratios, ahead = at[turning][sharp], ratios[sharp], ahead[sharp]
    taken: list[int] = []
    for row in np.argsort(-ratios, kind="stable").tolist():
        apart = np.abs(places[row] - places[taken])
        apart = np.where(loops[places[row]], np.minimum(apart, sizes[places[row]] - apart), apart)
        # Two bends are at least three points apart.
        if (apart >= 3)[owners[places[taken]] == owners[places[row]]].all():
            taken.append(row)
    edge = owners[places[taken]]
    several = ~edges.closed[edge] | (np.bincount(edge, minlength=edges.num_edges)[edge] > 1)
    ranks = (ranks[places[taken]] + ahead[taken]) % np.diff(offsets)[edge]
    return np.sort((offsets[edge] + ranks)[several])


def turn_somewhat(windows: FloatArray) -> BoolArray:
    """Whether the chords of both halves of (n, k, 3) points differ enough for a bend in between."""
    before = unit(windows[:, SIDE_POINTS - 1] - windows[:, 0])
    behind = unit(windows[:, -1] - windows[:, SIDE_POINTS + 1])
    return np.asarray(
        np.einsum("ni,ni->n", before, behind) <= np.cos(np.radians(MIN_ANGLE_DEG / 2))
    )


def bend_ratios(windows: FloatArray) -> tuple[FloatArray, BoolArray]:
    """F test of a sharp bend in the middle of each of (n, k, 3) sequences of points.

    Returns:
        (n,) ratio of squared residuals of a smooth curve to those of a bent one, relative to the
        quantile of the F test; 0 if the sides do not meet there at an angle. (n,) whether they
        meet after the middle point.
    """
    along, spacings = lengths_along(windows)
    # Refinement may have displaced the point at a corner.
    outer = np.arange(windows.shape[1]) != SIDE_POINTS
    _, smooth = polynomials(along[:, outer], windows[:, outer], 5)
    before, rest = polynomials(along[:, :SIDE_POINTS], windows[:, :SIDE_POINTS], 2)
    behind, more = polynomials(along[:, -SIDE_POINTS:], windows[:, -SIDE_POINTS:], 2)
    middle = windows[:, SIDE_POINTS]
    powers = along[:, SIDE_POINTS, None, None] ** np.arange(3)
    slopes = np.arange(3) * along[:, SIDE_POINTS, None, None] ** np.array([0, 0, 1])
    starts = [(powers @ of)[:, 0] for of in (before, behind)]
    ways = [unit((slopes @ of)[:, 0]) for of in (before, behind)]
    near = nearest_on_lines(starts[0], ways[0], starts[1], ways[1])
    shift = (near[0] + near[1]) / 2 - middle
    meet = np.linalg.norm(near[1] - near[0], axis=1) <= 2 * MAX_MISS_SPACINGS * spacings
    # It lies near the edge, but farther at fillets.
    meet &= np.linalg.norm(shift, axis=1) <= 0.85 * spacings
    meet &= np.einsum("ni,ni->n", *ways) <= np.cos(np.radians(MIN_ANGLE_DEG))
    ratios = smooth / (rest + more + 1e-300) / by_chance(2 * SIDE_POINTS, 6)
    return np.where(meet, ratios, 0), np.einsum("ni,ni->n", shift, ways[0] + ways[1]) > 0


def by_chance(num_points: int, num_parameters: int) -> float:
    """Quantile of the ratio of squared residuals of two equally good models (F test)."""
    freedom = 3 * (num_points - num_parameters)
    return float(fdtri(freedom, freedom, 0.95))


def lengths_along(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, k) arc length of (n, k, 3) points, scaled to [-1, 1]; (n,) mean distances of points."""
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=2)
    along = np.concatenate([np.zeros((len(points), 1)), np.cumsum(lengths, axis=1)], axis=1)
    return 2 * along / (along[:, -1:] + 1e-300) - 1, lengths.mean(axis=1)


def polynomials(
    along: FloatArray, points: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Fit polynomials of (n, k) arc lengths to (n, k, 3) points.

    Returns (n, degree + 1, 3) coefficients and (n,) sums of squared residuals.
    """
    powers = np.ones((*along.shape, degree + 1))
    np.cumprod(np.broadcast_to(along[:, :, None], powers[:, :, 1:].shape), 2, out=powers[:, :, 1:])
    rows = powers.swapaxes(1, 2)
    normal = rows @ powers
    normal += 1e-13 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(degree + 1)
    origin = points[:, :1]
    factors = np.asarray(np.linalg.solve(normal, rows @ (points - origin)), np.float64)
    squares = ((points - origin - powers @ factors) ** 2).sum(axis=(1, 2))
    factors[:, 0] += origin[:, 0]
    return factors, squares
