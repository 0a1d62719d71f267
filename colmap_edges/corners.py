"""Corners of chains: sharpened, and the chains cut there.

Blur rounds a corner off: a chain passes it on the inside, by a pixel or more. Where the lines
through a chain before and after a bend meet within the blur's reach, the chain is led through
their crossing and ends there, and another begins. So directions, depths and 3D edges are not
smoothed across corners.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.array_types import BoolArray, FloatArray, IntArray
from colmap_edges.csr import owners_of, ranks_of
from colmap_edges.detection import Chains

ROUNDED = 3  # points to each side of a corner that blur may have moved
ARM = 6  # points beyond these that tell the direction
REACH = ROUNDED + ARM - 1
NOISE_DEG = 10.0  # by which the chord of an arm may differ from the line through it
MAX_SCATTER_PX = 0.35  # root mean square of an arm's points around its line
MAX_RADIUS_PX = 4.0  # of the arc that blur makes of a corner; a larger one is a bend of the edge
SLACK_PX = 0.5  # of the distance between the chain and the corner
MAX_CUT_PX = 5.0  # that blur may have cut off, however sharp the corner


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Lines fitted to points.

    Attributes:
        centers: (n, 2) means of the points.
        directions: (n, 2) unit directions, forward along the chain.
        scatters: (n,) root mean square distance of the points from their line.
    """

    centers: FloatArray
    directions: FloatArray
    scatters: FloatArray


def cut_at_corners(
    chains: Chains, closed: BoolArray, min_angle_deg: float
) -> tuple[Chains, BoolArray]:
    """Lead chains through their corners and cut them there.

    Args:
        chains: of C chains with points about 1 px apart.
        closed: (C,) whether the last point of each connects to its first.
        min_angle_deg: smallest turn of a corner.

    Returns:
        The pieces, which share the point at a corner, in the order of the chains; a closed chain
        with corners begins and ends at its first one. And whether each piece is closed.
    """
    corners, crossings = find_corners(chains, closed, min_angle_deg)
    if len(corners) == 0:
        return chains, closed
    return cut(sharpened(chains, corners, crossings), closed, corners)


def find_corners(
    chains: Chains, closed: BoolArray, min_angle_deg: float
) -> tuple[IntArray, FloatArray]:
    """(K,) points at corners, ascending, and (K, 2) where the lines along them cross."""
    around, inner = with_wrapped_ends(chains.offsets, closed)
    points = chains.points.take(around, axis=0)
    bent = np.flatnonzero(inner & is_bent(points, min_angle_deg - NOISE_DEG))
    steps = np.arange(ROUNDED, REACH + 1)[:, None]
    before, after = (fit_lines(points.take(bent + s, axis=0)) for s in (-steps[::-1], steps))
    cosines = np.einsum("ij,ij->i", before.directions, after.directions)
    crossings = cross(before, after)
    distances = np.linalg.norm(crossings - points[bent], axis=1)
    half_cosines = np.sqrt(np.clip((1 + cosines) / 2, 1e-6, 1))
    limits = np.minimum(SLACK_PX + MAX_RADIUS_PX * (1 / half_cosines - 1), MAX_CUT_PX)
    good = cosines <= np.cos(np.radians(min_angle_deg))
    good &= (before.scatters <= MAX_SCATTER_PX) & (after.scatters <= MAX_SCATTER_PX)
    good &= distances <= limits
    # Both lines lead to the crossing, past the points that are trusted.
    reached, left = crossings - points[bent - ROUNDED], points[bent + ROUNDED] - crossings
    good &= np.einsum("ij,ij->i", reached, before.directions) > 0
    good &= np.einsum("ij,ij->i", left, after.directions) > 0
    windows = around[bent[good, None] + np.arange(-2 * ROUNDED, 2 * ROUNDED + 1)]
    best = np.flatnonzero(good)[nearest_first(windows, distances[good])]
    return around[bent[best]], crossings[best]


def with_wrapped_ends(offsets: IntArray, closed: BoolArray) -> tuple[IntArray, BoolArray]:
    """Indices of all points, those of closed chains with `REACH` points more at both ends.

    Returns:
        (n,) indices, (n,) whether `REACH` points of the same chain are on both sides.
    """
    lengths = np.diff(offsets)
    wraps = np.where(closed & (lengths > 2 * REACH), REACH, 0)
    counts = lengths + 2 * wraps
    ids = np.repeat(np.arange(len(lengths)), counts)
    ranks = ranks_of(counts)
    indices = offsets[ids] + (ranks - wraps[ids]) % lengths[ids]
    return indices, (ranks >= REACH) & (ranks < counts[ids] - REACH)


def is_bent(points: FloatArray, min_angle_deg: float) -> BoolArray:
    """(n,) whether the chords of the arms before and after each of (n, 2) points turn so much.

    Of points that have `REACH` others on both sides; false for the first and last ones.
    """
    bent = np.zeros(len(points), bool)
    if len(points) > 2 * REACH:
        x, y = (points[ARM - 1 :] - points[: 1 - ARM]).T
        (ax, bx), (ay, by) = ((c[: -REACH - ROUNDED], c[REACH + ROUNDED :]) for c in (x, y))
        limit = np.cos(np.radians(min_angle_deg)) * np.sqrt((ax**2 + ay**2) * (bx**2 + by**2))
        bent[REACH:-REACH] = ax * bx + ay * by <= limit
    return bent


def fit_lines(points: FloatArray) -> Lines:
    """Lines through n times k points, (k, n, 2)."""
    centers = points.mean(axis=0)
    x, y = np.moveaxis(points - centers, 2, 0)
    xx, xy, yy = ((a * b).mean(axis=0) for a, b in ((x, x), (x, y), (y, y)))
    angles = np.arctan2(2 * xy, xx - yy) / 2
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    backward = np.einsum("ij,ij->i", directions, points[-1] - points[0]) < 0
    across = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    return Lines(
        centers=centers,
        directions=np.where(backward[:, None], -directions, directions),
        scatters=np.sqrt(np.maximum(across, 0)),
    )


def cross(a: Lines, b: Lines) -> FloatArray:
    """(n, 2) where lines cross, of which no two are parallel."""
    (ax, ay), (bx, by), (gap_x, gap_y) = a.directions.T, b.directions.T, (b.centers - a.centers).T
    sines = ax * by - ay * bx
    along = (gap_x * by - gap_y * bx) / np.where(np.abs(sines) < 1e-9, 1e-9, sines)
    found: FloatArray = a.centers + along[:, None] * a.directions
    return found


def nearest_first(windows: IntArray, distances: FloatArray) -> IntArray:
    """Which of n corners stay, those nearest to the chain first.

    Args:
        windows: (n, k) points around each corner, itself in the middle, that allow no other.
        distances: (n,) from the chain to the corner.
    """
    taken: set[int] = set()
    kept = []
    for row in np.argsort(distances, kind="stable").tolist():
        if int(windows[row, windows.shape[1] // 2]) not in taken:
            kept.append(row)
            taken.update(windows[row].tolist())
    return np.sort(np.array(kept, np.int64))


def sharpened(chains: Chains, corners: IntArray, crossings: FloatArray) -> Chains:
    """The chains led straight to their corners."""
    ids = np.searchsorted(chains.offsets, corners, "right") - 1
    starts, lengths = chains.offsets[ids], np.diff(chains.offsets)[ids]

    def moved(steps: int) -> IntArray:
        return np.asarray(starts + (corners - starts + steps) % lengths)

    points, normals, sides = chains.points.copy(), chains.normals.copy(), chains.sides.copy()
    for steps in range(1 - ROUNDED, ROUNDED):
        here, trusted = moved(steps), moved(ROUNDED if steps > 0 else -ROUNDED)
        share = abs(steps) / ROUNDED
        points[here] = (1 - share) * crossings + share * chains.points[trusted]
        normals[here], sides[here] = chains.normals[trusted], chains.sides[trusted]
    return replace(chains, points=points, normals=normals, sides=sides)


def cut(chains: Chains, closed: BoolArray, corners: IntArray) -> tuple[Chains, BoolArray]:
    """Cut chains at some of their points, which are then in both pieces."""
    ids, starts, lengths = owners_of(chains.offsets), chains.offsets[:-1], np.diff(chains.offsets)
    first = chains.offsets[1:].copy()  # corner of each chain; its end when it has none
    np.minimum.at(first, ids[corners], corners)
    opened = closed & (first < chains.offsets[1:])
    begins = np.sort(np.concatenate([starts[~opened], corners]))
    own = ids[begins]
    # The last piece of a chain ends with it, that of an opened one with the corner it begins with.
    ends = np.where(opened, first + lengths + 1, chains.offsets[1:])[own]
    goes_on = np.flatnonzero(own[1:] == own[:-1])
    ends[goes_on] = begins[goes_on + 1] + 1
    counts = ends - begins
    ranks = np.repeat(begins - starts[own], counts) + ranks_of(counts)
    order = np.repeat(starts[own], counts) + ranks % np.repeat(lengths[own], counts)
    pieces = chains.select(order, counts)
    # The corner's normal and sides are those of the piece before it; the next has its own.
    new = pieces.offsets[:-1][np.isin(begins, corners)]
    pieces.normals[new], pieces.sides[new] = pieces.normals[new + 1], pieces.sides[new + 1]
    return pieces, (closed & ~opened)[own]
