"""Test of whether curves continue smoothly or at an angle; cuts edges at sharp bends in space.

Chains are cut at corners that are visible in the image. An edge can continue around a corner if
the reference views see it nearly unbent, or if its pieces were joined across it. Conversely, the
ends of a gap in a small circle are at an angle, and their tangents meet outside the circle.

Two models with the same number of parameters are compared: one polynomial, or two of lower degree.
The one with smaller residuals is significantly better if the ratio of the squared residuals
exceeds the quantile of the F distribution (F test).
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtri

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, blocks, ranks_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import end_points, nearest_on_lines, unit
from colmap_edges.edges3d.linking.ends import MAX_MISS_SPACINGS, MIN_ANGLE_DEG

SIDE_POINTS = (6, 5, 4)  # points fitted on each side; the largest number that the edge has
ROUNDED = 1  # points on each side of a corner that refinement may have displaced


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
    ranks = ranks_of(sizes)
    order = offsets[owners] + (ranks + shifts[owners]) % sizes[owners]
    of = owners[bends]
    cuts = offsets[of] + (ranks[bends] - shifts[of]) % sizes[of]
    pieces = np.unique(np.append(offsets, cuts))
    return edges.reordered(order, pieces, (edges.closed & ~rolled)[owners[pieces[:-1]]])


def find_bends(edges: Edges3D) -> IntArray:
    """(B,) indices of the points before which edges are to be cut, ascending."""
    owners, offsets = edges.edge_ids, edges.edge_offsets
    sizes, loops = np.diff(offsets)[owners], edges.closed[owners]
    ranks = ranks_of(np.diff(offsets))
    to_end = np.where(loops, sizes // 2, np.minimum(ranks, sizes - 1 - ranks))
    found = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, bool))]
    for side in SIDE_POINTS:
        reach = to_end >= ROUNDED + side
        if side < SIDE_POINTS[0]:
            reach &= to_end < ROUNDED + side + 1
        at = np.flatnonzero(reach & (sizes > 2 * (ROUNDED + side)))
        steps = np.arange(-ROUNDED - side, ROUNDED + side + 1)
        windows = offsets[owners[at], None] + (ranks[at, None] + steps) % sizes[at, None]
        turning = np.flatnonzero(turn_somewhat(edges.points[windows]))
        ratios, ahead = bend_ratios(edges.points[windows[turning]], side)
        sharp = ratios > 1
        found.append((at[turning[sharp]], ratios[sharp], ahead[sharp]))
    places, ratios, ahead = (np.concatenate(of) for of in zip(*found, strict=True))
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
    middle = windows.shape[1] // 2
    before = unit(windows[:, middle - ROUNDED - 1] - windows[:, 0])
    behind = unit(windows[:, -1] - windows[:, middle + ROUNDED + 1])
    return np.asarray(
        np.einsum("ni,ni->n", before, behind) <= np.cos(np.radians(MIN_ANGLE_DEG / 2))
    )


def bend_ratios(windows: FloatArray, side: int) -> tuple[FloatArray, BoolArray]:
    """F test of a sharp bend in the middle of each of (n, k, 3) sequences of points.

    Returns:
        (n,) ratio of squared residuals of a smooth curve to those of a bent one, relative to the
        quantile of the F test; 0 if the sides do not meet there at an angle. (n,) whether they
        meet after the middle point.
    """
    along, spacings = lengths_along(windows)
    outer = np.abs(np.arange(windows.shape[1]) - side - ROUNDED) > ROUNDED
    _, smooth = polynomials(along[:, outer], windows[:, outer], 5)
    before, rest = polynomials(along[:, :side], windows[:, :side], 2)
    behind, more = polynomials(along[:, -side:], windows[:, -side:], 2)
    middle = windows[:, side + ROUNDED]
    powers = along[:, side + ROUNDED, None, None] ** np.arange(3)
    slopes = np.arange(3) * along[:, side + ROUNDED, None, None] ** np.array([0, 0, 1])
    starts = [(powers @ of)[:, 0] for of in (before, behind)]
    ways = [unit((slopes @ of)[:, 0]) for of in (before, behind)]
    near = nearest_on_lines(starts[0], ways[0], starts[1], ways[1])
    shift = (near[0] + near[1]) / 2 - middle
    meet = np.linalg.norm(near[1] - near[0], axis=1) <= 2 * MAX_MISS_SPACINGS * spacings
    # It lies near the edge, but farther at fillets.
    meet &= np.linalg.norm(shift, axis=1) <= 0.85 * spacings
    meet &= np.einsum("ni,ni->n", *ways) <= np.cos(np.radians(MIN_ANGLE_DEG))
    ratios = smooth / (rest + more + 1e-300) / by_chance(np.array(2 * side), 6)
    return np.where(meet, ratios, 0), np.einsum("ni,ni->n", shift, ways[0] + ways[1]) > 0


def go_on_smoothly(edges: Edges3D, a: IntArray, b: IntArray) -> BoolArray:
    """Whether (n,) ends `a` and (n,) ends `b` belong to one smooth curve with a gap.

    A cubic must be significantly better than two lines, and two parabolas must not be
    significantly better than a polynomial of degree five.
    """
    most, fewest = SIDE_POINTS[0], SIDE_POINTS[-1]
    tips, inner = end_points(edges.edge_offsets, most - 1)
    sides = np.abs(inner - tips) + 1
    steps = np.sign(inner - tips)[:, None] * np.minimum(np.arange(most), sides[:, None] - 1)
    rows, given = tips[:, None] + steps, np.arange(most) < sides[:, None]
    counts, least = sides[a] + sides[b], np.minimum(sides[a], sides[b])

    def squares(pairs: IntArray, degree: int) -> tuple[FloatArray, FloatArray]:
        points = edges.points[np.concatenate([rows[a[pairs], ::-1], rows[b[pairs]]], axis=1)]
        weights = np.concatenate([given[a[pairs], ::-1], given[b[pairs]]], axis=1)
        return one_and_two(points, weights.astype(np.float64), degree)

    smooth = np.zeros(len(a), bool)
    for pairs in blocks(len(a), 1 << 12):
        # Fewer than three points are not joined as a smooth curve.
        left = pairs.start + np.flatnonzero(least[pairs] >= 3)
        cubic, lines = squares(left, 1)
        left = left[by_chance(counts[left], 4) * cubic < lines]
        quintic, parabolas = squares(left, 2)
        bent = quintic > by_chance(counts[left], 6) * parabolas
        smooth[left] = ~(bent & (least[left] >= fewest))
    return smooth


def one_and_two(
    points: FloatArray, weights: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Squared residuals of one polynomial, and of one of lower degree for each half of the points.

    Args:
        points: (n, 2k, 3) sequences of points.
        weights: (n, 2k) their weights.
        degree: degree of the two polynomials; the one has as many parameters as both.
    """
    along, _ = lengths_along(points)
    half = points.shape[1] // 2
    two = np.zeros(len(points))
    for of in (slice(0, half), slice(half, None)):
        two += polynomials(along[:, of], points[:, of], degree, weights[:, of])[1]
    return polynomials(along, points, 2 * degree + 1, weights)[1], two


def by_chance(num_points: IntArray, num_parameters: int) -> FloatArray:
    """(n,) quantile of the ratio of squared residuals of two equally good models (F test)."""
    freedom = 3 * np.maximum(num_points - num_parameters, 1)
    return np.asarray(fdtri(freedom, freedom, 0.95), np.float64)


def lengths_along(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, k) arc length of (n, k, 3) points, scaled to [-1, 1]; (n,) mean distances of points."""
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=2)
    along = np.concatenate([np.zeros((len(points), 1)), np.cumsum(lengths, axis=1)], axis=1)
    return 2 * along / (along[:, -1:] + 1e-300) - 1, lengths.mean(axis=1)


def polynomials(
    along: FloatArray, points: FloatArray, degree: int, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Fit polynomials of (n, k) arc lengths to (n, k, 3) points.

    `weights` (n, k) of the points are optional. Returns (n, degree + 1, 3) coefficients and (n,)
    sums of squared residuals.
    """
    powers = np.ones((*along.shape, degree + 1))
    np.cumprod(np.broadcast_to(along[:, :, None], powers[:, :, 1:].shape), 2, out=powers[:, :, 1:])
    rows = (powers if weights is None else powers * weights[:, :, None]).swapaxes(1, 2)
    normal = rows @ powers
    normal += 1e-13 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(degree + 1)
    origin = points[:, :1]
    factors = np.asarray(np.linalg.solve(normal, rows @ (points - origin)), np.float64)
    squares = ((points - origin - powers @ factors) ** 2).sum(axis=2)
    factors[:, 0] += origin[:, 0]
    return factors, (squares if weights is None else squares * weights).sum(axis=1)
