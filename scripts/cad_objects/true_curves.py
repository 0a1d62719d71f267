"""The sharp curves of a solid's mesh by kind: lines, arcs, circles, ellipses and others.

The vertices of the meshes lie on the true curves, but for those that Boolean operations put on
facets, which are within the height of a facet's arc (1.4e-4 of the radius for 192 segments).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

# Turn at a vertex above which curves end there; a circle of 128 segments turns by 2.8 degrees.
MAX_TURN = np.radians(10)
LINE, ARC, CIRCLE, ELLIPTIC_ARC, ELLIPSE, SPLINE = range(6)  # core.curves3d.KINDS
STRAIGHT = 1e-6  # maximum deviation of a line's points, relative to its length
ROUND = 5e-4  # maximum deviation from circles and ellipses, relative to the radius
MIN_VERTICES = 5  # minimum number of vertices of a bent curve


def curves_by_kind(points: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, ...]:
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


def chains(points: np.ndarray, edges: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices and edges of each chain between junctions; closed chains repeat the first vertex."""
    neighbors: dict[int, list[tuple[int, int]]] = {}
    for index, (a, b) in enumerate(edges.tolist()):
        neighbors.setdefault(a, []).append((b, index))
        neighbors.setdefault(b, []).append((a, index))
    passed = {v for v, near in neighbors.items() if is_smooth(points, v, near)}
    used = np.zeros(len(edges), bool)
    found = []
    for start in [*sorted(set(neighbors) - passed), *sorted(passed)]:
        for step in neighbors[start]:
            if not used[step[1]]:
                found.append(walk(start, step, neighbors, passed, used))
    return found


def is_smooth(points: np.ndarray, vertex: int, near: list[tuple[int, int]]) -> bool:
    """Whether a curve runs through a vertex without a corner."""
    if len(near) != 2:
        return False
    ways = points[[near[0][0], near[1][0]]] - points[vertex]
    turn = -np.prod(1 / np.linalg.norm(ways, axis=1)) * (ways[0] @ ways[1])
    return bool(turn > np.cos(MAX_TURN))


def walk(
    start: int,
    step: tuple[int, int],
    neighbors: dict[int, list[tuple[int, int]]],
    passed: set[int],
    used: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Follow edges from a vertex to the next junction, or around a closed curve."""
    chain, members = [start], []
    while True:
        vertex, edge = step
        used[edge] = True
        chain.append(vertex)
        members.append(edge)
        onward = [s for s in neighbors[vertex] if not used[s[1]]]
        if vertex == start or vertex not in passed or not onward:
            return np.array(chain), np.array(members)
        step = onward[0]


def pieces(points: np.ndarray) -> list[tuple[int, int]]:
    """First and last points of the entirely bent or entirely straight stretches of a chain (n, 3).

    A straight stretch within a curve is one edge of the mesh that is much longer than its
    neighbours, or successive edges on one line.
    """
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    turns = np.linalg.norm(np.cross(units[:-1], units[1:]), axis=1)
    long = lengths > 4 * np.median(lengths)
    ends = [0, len(steps)]
    for edge in np.flatnonzero(long) if (turns > STRAIGHT).any() else []:
        ends += [int(edge), int(edge) + 1]
    ends = sorted(set(ends))
    return list(pairwise(ends))


def kind_of(points: np.ndarray) -> tuple[int, tuple[float, float]]:
    """Kind and radii of the curve through (n, 3) points, the last of which may be the first."""
    closed = bool(np.array_equal(points[0], points[-1]))
    distinct = points[:-1] if closed else points
    middle = distinct.mean(axis=0)
    spread, axes = np.linalg.svd(distinct - middle, full_matrices=False)[1:]
    if len(distinct) < 3 or spread[1] < STRAIGHT * spread[0]:
        return LINE, (np.nan, np.nan)
    if len(distinct) < MIN_VERTICES or spread[2] > ROUND * spread[0]:
        return SPLINE, (np.nan, np.nan)
    radii = conic_radii((distinct - middle) @ axes[:2].T)
    if radii is None:
        return SPLINE, (np.nan, np.nan)
    if np.ptp(radii) < ROUND * 4 * radii[0]:
        return (CIRCLE if closed else ARC), radii
    return (ELLIPSE if closed else ELLIPTIC_ARC), radii


def conic_radii(plane: np.ndarray) -> tuple[float, float] | None:
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
