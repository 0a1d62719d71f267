"""Corners of chains: sharpened, and the chains cut there.

Blur rounds a corner off: a chain passes it on the inside, by a pixel or more. Where the lines
through a chain before and after a bend meet within the blur's reach, the chain is led through
their crossing and ends there, and another begins. So directions, depths and 3D edges are not
smoothed across corners.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, owners_of, ranks_of
from colmap_edges.edges2d.detection import Chains
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

ROUNDED = 3  # points to each side of a corner that blur may have moved
ARM = 6  # points beyond these that tell the direction
NOISE_DEG = 10.0  # by which the chord of an arm may differ from the line through it
MAX_SCATTER_PX = 0.35  # root mean square of an arm's points around its line
MAX_RADIUS_PX = 4.0  # of the arc that blur makes of a corner; a larger one is a bend of the edge
SLACK_PX = 0.5  # of the distance between the chain and the corner
MAX_CUT_PX = 5.0  # that blur may have cut off, however sharp the corner


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
    corners, crossings = _kernels.find_corners(
        chains.points,
        chains.offsets,
        closed,
        ROUNDED,
        ARM,
        np.cos(np.radians(min_angle_deg - NOISE_DEG)),
        np.cos(np.radians(min_angle_deg)),
        MAX_SCATTER_PX,
        SLACK_PX,
        MAX_RADIUS_PX,
        MAX_CUT_PX,
    )
    return corners, crossings


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
