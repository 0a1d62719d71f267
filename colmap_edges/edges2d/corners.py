"""Sharpening of corners of chains, where chains are then cut.

Blur rounds corners: a chain passes inside of a corner by a pixel or more. If the lines through a
chain before and after a bend intersect within the reach of the blur, the chain is moved to the
intersection and cut there. Directions, depths and 3D edges are therefore not smoothed across
corners.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, owners_of, ranks_of
from colmap_edges.edges2d.detection import Chains
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

ROUNDED = 3  # points on each side of a corner that may be displaced by blur
NOISE_DEG = 10.0  # tolerance between the chord of an arm and the line fitted to it


def cut_at_corners(
    chains: Chains, closed: BoolArray, min_angle_deg: float
) -> tuple[Chains, BoolArray]:
    """Move chains to their corners and cut them there.

    Args:
        chains: C chains with points about 1 px apart.
        closed: (C,) whether the last point of each connects to its first.
        min_angle_deg: minimum turn of a corner.

    Returns:
        The pieces in the order of the chains, and whether each piece is closed. Pieces share the
        point at a corner; a closed chain with corners begins and ends at its first corner.
    """
    corners, crossings = find_corners(chains, closed, min_angle_deg)
    if len(corners) == 0:
        return chains, closed
    return cut(sharpened(chains, corners, crossings), closed, corners)


def find_corners(
    chains: Chains, closed: BoolArray, min_angle_deg: float
) -> tuple[IntArray, FloatArray]:
    """(K,) indices of corner points, ascending, and (K, 2) intersections of the fitted lines."""
    corners, crossings = _kernels.find_corners(
        chains.points,
        chains.offsets,
        closed,
        ROUNDED,
        6,  # points beyond these to which a line is fitted
        np.cos(np.radians(min_angle_deg - NOISE_DEG)),
        np.cos(np.radians(min_angle_deg)),
        0.35,  # maximum root mean square distance of an arm's points to its line
        0.5,  # tolerance of the distance between a chain and its corner
        4.0,  # maximum radius of a blurred corner; larger arcs are bends of the edge
        5.0,  # maximum distance between a chain and its corner
    )
    return corners, crossings


def sharpened(chains: Chains, corners: IntArray, crossings: FloatArray) -> Chains:
    """The chains with points near corners moved to the lines through the corner."""
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
    """Cut chains at some of their points, which then belong to both pieces."""
    ids, starts, lengths = owners_of(chains.offsets), chains.offsets[:-1], np.diff(chains.offsets)
    first = chains.offsets[1:].copy()  # first corner of each chain, or its end
    np.minimum.at(first, ids[corners], corners)
    opened = closed & (first < chains.offsets[1:])
    begins = np.sort(np.concatenate([starts[~opened], corners]))
    own = ids[begins]
    # The last piece ends where the chain ends; for an opened closed chain, at its first corner.
    ends = np.where(opened, first + lengths + 1, chains.offsets[1:])[own]
    goes_on = np.flatnonzero(own[1:] == own[:-1])
    ends[goes_on] = begins[goes_on + 1] + 1
    counts = ends - begins
    ranks = np.repeat(begins - starts[own], counts) + ranks_of(counts)
    order = np.repeat(starts[own], counts) + ranks % np.repeat(lengths[own], counts)
    pieces = chains.cut(order, counts)
    # A corner has the normal and sides of the piece before it; the next piece has its own.
    new = pieces.offsets[:-1][np.isin(begins, corners)]
    pieces.normals[new], pieces.sides[new] = pieces.normals[new + 1], pieces.sides[new + 1]
    return pieces, (closed & ~opened)[own]
