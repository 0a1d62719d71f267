"""Joining of curve pieces end to end, for chains in images and edges in space.

Piece i has two ends: 2i at its first point and 2i + 1 at its last. Callers decide which ends may
join, and at what cost.
"""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, ranks_of


def end_points(offsets: IntArray, reach: int) -> tuple[IntArray, IntArray]:
    """(2P,) index of the point at each end of P pieces, and of the point `reach` points inward.

    On shorter pieces the latter is the opposite end.
    """
    first, last = offsets[:-1], offsets[1:] - 1
    tips = np.column_stack([first, last]).ravel()
    inner = np.column_stack([np.minimum(first + reach, last), np.maximum(last - reach, first)])
    return tips, inner.ravel()


def match_best_first(
    num_ends: int, a: IntArray, b: IntArray, allowed: BoolArray, costs: FloatArray
) -> IntArray:
    """(num_ends,) the end joined to each end, -1 for none; greedy by ascending cost.

    Args:
        num_ends: twice the number of pieces.
        a: (n,) first end of each candidate pair.
        b: (n,) second end of each candidate pair.
        allowed: (n,) whether the pair may be joined.
        costs: (n,) cost of joining the pair; of equal costs the first pair wins.
    """
    partner = np.full(num_ends, -1, np.int64)
    for row in np.flatnonzero(allowed)[np.argsort(costs[allowed], kind="stable")]:
        if partner[a[row]] < 0 and partner[b[row]] < 0:
            partner[a[row]], partner[b[row]] = b[row], a[row]
    return partner


def walk_joined(partner: IntArray) -> list[tuple[list[int], bool]]:
    """Paths of joined pieces: the ends at which pieces are entered, and whether it is closed."""
    count = len(partner) // 2
    seen = [False] * count
    ends = partner.tolist()
    paths = []
    free = [end for end in range(2 * count) if ends[end] < 0]
    for start in free + list(range(0, 2 * count, 2)):
        if seen[start // 2]:
            continue
        path, end = [], start
        while end >= 0 and not seen[end // 2]:
            seen[end // 2] = True
            path.append(end)
            end = ends[end ^ 1]
        paths.append((path, end == start))
    return paths


def points_along(
    paths: list[tuple[list[int], bool]], begins: IntArray, stops: IntArray
) -> tuple[IntArray, IntArray]:
    """The points along paths of pieces; piece p has the points begins[p]:stops[p].

    Returns:
        The concatenated points of all paths, and the (len(paths),) number of points of each.
    """
    ends = np.array([end for path, _ in paths for end in path], np.int64)
    path_ids = np.repeat(np.arange(len(paths)), [len(path) for path, _ in paths])
    begins, stops, backward = begins[ends // 2], stops[ends // 2], ends % 2 == 1
    lengths = stops - begins
    ranks = ranks_of(lengths) * np.repeat(np.where(backward, -1, 1), lengths)
    order: IntArray = np.repeat(np.where(backward, stops - 1, begins), lengths) + ranks
    return order, np.bincount(path_ids, lengths, len(paths)).astype(np.int64)


def curve_tangents(points: FloatArray, offsets: IntArray) -> FloatArray:
    """(N, 3) tangents of curves with (N, 3) points, by central differences."""
    first = np.repeat(offsets[:-1], np.diff(offsets))
    last = np.repeat(offsets[1:], np.diff(offsets)) - 1
    index = np.arange(len(points))
    tangents: FloatArray = (
        points[np.minimum(index + 1, last)] - points[np.maximum(index - 1, first)]
    )
    return tangents


def unit(vectors: FloatArray) -> FloatArray:
    """(..., k) vectors scaled to length 1; zero vectors are unchanged."""
    return np.asarray(vectors / (lengths_of(vectors)[..., None] + 1e-300))


def lengths_of(vectors: FloatArray) -> FloatArray:
    """(...,) lengths of (..., k) vectors; numpy takes ten times as long."""
    squares = vectors[..., 0] ** 2
    for k in range(1, vectors.shape[-1]):
        squares += vectors[..., k] ** 2
    return np.sqrt(squares)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(..., 3) cross products, broadcast; of few vectors in a third of the time of numpy's."""
    found = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        found[..., k] = a[..., k - 2] * b[..., k - 1] - a[..., k - 1] * b[..., k - 2]
    return found


def plane_basis(normal: FloatArray) -> FloatArray:
    """(2, 3) unit vectors at right angles to a (3,) normal and to each other."""
    return np.asarray(np.linalg.svd(normal[None])[2][1:])


def nearest_on_lines(
    origins_a: FloatArray, a: FloatArray, origins_b: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Nearest points of (n,) pairs of lines: (n, 3) on the first and on the second.

    Args:
        origins_a: (n, 3) points of the first lines.
        a: (n, 3) their unit directions.
        origins_b: (n, 3) points of the second lines.
        b: (n, 3) their unit directions.
    """
    offset, cosine = origins_b - origins_a, np.einsum("ij,ij->i", a, b)
    on_a, on_b = (np.einsum("ij,ij->i", offset, way) for way in (a, b))
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    near_a = origins_a + ((on_a - cosine * on_b) / sine2)[:, None] * a
    near_b = origins_b + ((cosine * on_a - on_b) / sine2)[:, None] * b
    return near_a, near_b
