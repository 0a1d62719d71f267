"""The curves of sharp edges, and their kinds: lines, arcs, circles, ellipses and others.

The vertices of the meshes lie on the true curves, but for those that Boolean operations put on
facets, which are within the height of a facet's arc (1.4e-4 of the radius for 192 segments).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from zoo.geometry import Array, dot, unit

CORNER_DEG = 30.0  # largest turn inside one curve
# Turn above which it is cut into kinds; a circle of 128 segments turns by 2.8 degrees.
MAX_TURN = np.radians(10)
LINE, ARC, CIRCLE, ELLIPTIC_ARC, ELLIPSE, SPLINE = range(6)  # core.curves3d.KINDS
STRAIGHT = 1e-6  # maximum deviation of a line's points, relative to its length
ROUND = 5e-4  # maximum deviation from circles and ellipses, relative to the radius
MIN_VERTICES = 5  # minimum number of vertices of a bent curve


def chain_edges(vertices: Array, edges: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """(E,) numbers of curves: edges joined at vertices of two edges, without corner or new kind."""
    ends = np.argsort(edges.ravel(), kind="stable")
    vertex = edges.ravel()
    _, first, count = np.unique(vertex[ends], return_index=True, return_counts=True)
    touching = ends[first[count == 2][:, None] + (0, 1)]
    near, far = vertices[vertex[touching[:, 0]]], vertices[vertex[touching ^ 1]]
    cosine = dot(unit(near - far[:, 0]), unit(far[:, 1] - near))
    joined = touching // 2
    joined = joined[(cosine > np.cos(np.radians(CORNER_DEG))) & (np.ptp(kind[joined], axis=1) == 0)]
    parent = list(range(len(edges)))

    def root(i: int) -> int:
        while parent[i] != i:
            i = parent[i] = parent[parent[i]]
        return i

    for i, j in joined.tolist():
        parent[root(i)] = root(j)
    roots = [root(i) for i in range(len(edges))]
    return np.unique(roots, return_inverse=True)[1].astype(np.int32)


def subdivide(
    vertices: Array, edges: np.ndarray, spacing: float
) -> tuple[Array, np.ndarray, np.ndarray]:
    """Edges cut into segments of at most `spacing`, which share points at the vertices.

    Returns:
        (P, 3) points, (S, 2) int32 segments, and (S,) the edge that each is part of.
    """
    used, ends = np.unique(edges, return_inverse=True)
    ends = ends.reshape(edges.shape)
    lengths = np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
    pieces = np.maximum(1, np.ceil(lengths / spacing)).astype(int)
    own = np.repeat(np.arange(len(edges)), pieces)
    rank = np.arange(len(own)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    inner, final = rank > 0, rank == pieces[own] - 1
    t = (rank / pieces[own])[inner, None]
    start, end = vertices[edges[own[inner]]].swapaxes(0, 1)
    first = ends[own, 0]
    first[inner] = len(used) + np.arange(len(t))
    last = np.where(final, ends[own, 1], np.roll(first, -1))
    points = np.vstack([vertices[used], (1 - t) * start + t * end])
    return points, np.column_stack([first, last]).astype(np.int32), own


def curves_by_kind(points: Array, edges: np.ndarray) -> tuple[np.ndarray, ...]:
    """The curves of the (E, 2) edges between (P, 3) points, with kinds and radii.

    Returns:
        (E,) curve of each edge; (C,) kind of each curve; (C, 2) its radii, NaN where none.
    """
    curve_of = np.full(len(edges), -1)
    kinds, radii = [], []
    for chain, members in chains(points, edges):
        for first, last in pieces(points[chain]):
            kind, size = kind_of(points[chain[first : last + 1]])
            curve_of[members[first:last]] = len(kinds)
            kinds.append(kind)
            radii.append(size)
    return curve_of, np.array(kinds), np.array(radii).reshape(-1, 2)


def chains(points: Array, edges: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Vertices and edges of each chain between junctions; closed chains repeat the first vertex."""
    steps: dict[int, list[tuple[int, int]]] = defaultdict(list)  # from a vertex: the next, and edge
    for index, (a, b) in enumerate(edges.tolist()):
        steps[a].append((b, index))
        steps[b].append((a, index))
    passed = {v for v, near in steps.items() if is_smooth(points, v, near)}
    used = np.zeros(len(edges), bool)
    for start in [*sorted(set(steps) - passed), *sorted(passed)]:
        for step in steps[start]:
            chain, members, onward = [start], [], [step]
            while onward and not used[onward[0][1]]:
                vertex, edge = onward[0]
                used[edge] = True
                chain.append(vertex)
                members.append(edge)
                further = vertex != start and vertex in passed
                onward = [s for s in steps[vertex] if further and not used[s[1]]]
            if members:
                yield np.array(chain), np.array(members)


def is_smooth(points: Array, vertex: int, near: list[tuple[int, int]]) -> bool:
    """Whether a curve runs through a vertex without a corner."""
    if len(near) != 2:
        return False
    ways = points[[near[0][0], near[1][0]]] - points[vertex]
    turn = -np.prod(1 / np.linalg.norm(ways, axis=1)) * (ways[0] @ ways[1])
    return bool(turn > np.cos(MAX_TURN))


def pieces(points: Array) -> list[tuple[int, int]]:
    """First and last points of the entirely bent or entirely straight stretches of a chain (n, 3).

    A straight stretch within a curve is one edge of the mesh that is much longer than its
    neighbours, or successive edges on one line.
    """
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    turns = np.linalg.norm(np.cross(units[:-1], units[1:]), axis=1)
    long = np.flatnonzero((turns > STRAIGHT).any() & (lengths > 4 * np.median(lengths)))
    return list(pairwise(sorted({0, len(steps), *long.tolist(), *(long + 1).tolist()})))


def kind_of(points: Array) -> tuple[int, tuple[float, float]]:
    """Kind and radii of the curve through (n, 3) points, the last of which may be the first."""
    closed = bool(np.array_equal(points[0], points[-1]))
    distinct = points[:-1] if closed else points
    middle = distinct.mean(axis=0)
    spread, axes = np.linalg.svd(distinct - middle, full_matrices=False)[1:]
    if len(distinct) < 3 or spread[1] < STRAIGHT * spread[0]:
        return LINE, (np.nan, np.nan)
    flat = len(distinct) >= MIN_VERTICES and spread[2] <= ROUND * spread[0]
    radii = conic_radii((distinct - middle) @ axes[:2].T) if flat else None
    if radii is None:
        return SPLINE, (np.nan, np.nan)
    if np.ptp(radii) < ROUND * 4 * radii[0]:
        return (CIRCLE if closed else ARC), radii
    return (ELLIPSE if closed else ELLIPTIC_ARC), radii


def conic_radii(plane: Array) -> tuple[float, float] | None:
    """Radii, larger first, of the circle or ellipse through (n, 2) points; None if neither fits."""
    rows = np.column_stack([2 * plane, np.ones(len(plane))])
    found = np.linalg.lstsq(rows, (plane**2).sum(axis=1), rcond=None)[0]
    radius = np.sqrt(found[2] + found[:2] @ found[:2])
    if np.abs(np.linalg.norm(plane - found[:2], axis=1) - radius).max() < ROUND * radius:
        return float(radius), float(radius)
    x, y = (plane / np.abs(plane).max()).T
    rows = np.column_stack([x * x, x * y, y * y, x, y])
    a, b, c, d, e = np.linalg.lstsq(rows, np.ones(len(x)), rcond=None)[0]
    form = np.array([[a, b / 2], [b / 2, c]])
    if np.linalg.det(form) <= 0 or np.abs(rows @ (a, b, c, d, e) - 1).max() > ROUND:
        return None
    center = -np.linalg.solve(2 * form, (d, e))
    level = 1 + center @ form @ center
    sizes = np.sqrt(level / np.linalg.eigvalsh(form)) * np.abs(plane).max()
    return float(sizes.max()), float(sizes.min())
