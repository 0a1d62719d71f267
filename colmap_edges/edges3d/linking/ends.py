"""Ends of edges: their positions, directions and neighbours, and the views that observe them.

Lengths are in spacings, the local distance between edge points, and so independent of the unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray, IntArray, joined_lists, ranges_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import end_points, unit

REACH = 4  # points from an end over which its direction and spacing are measured
SHORT_GAP = 2.0  # length of gaps and overlaps, in spacings, that need not be observed
MAX_MISS_SPACINGS = 0.5  # maximum distance of the line of an end to the point where it meets others
MIN_ANGLE_DEG = 20.0  # minimum angle between lines; nearly parallel ones have no defined corner


@dataclass(frozen=True, kw_only=True)
class Ends:
    """The 2E ends of E edges; end 2e is the first point of edge e, end 2e + 1 its last.

    Attributes:
        positions: (2E, 3) world points.
        outward: (2E, 3) unit directions, outwards from the edge.
        spacings: (2E,) distance between edge points at the end.
    """

    positions: FloatArray
    outward: FloatArray
    spacings: FloatArray


def find_ends(edges: Edges3D) -> Ends:
    """The ends of all edges with their directions and spacings.

    Directions are tangents of parabolas through the last points, since the chord of an arc of a
    small circle deviates from its tangent; chords for pieces too short for a parabola.
    """
    tips, inner = end_points(edges.edge_offsets, REACH)
    points, counts = edges.points, np.abs(tips - inner)
    weights = np.where((counts == REACH)[:, None], (3.0, -4.0, 1.0), (1.0, 0.0, -1.0))
    parts = np.stack([points[tips], points[(tips + inner) // 2], points[inner]], axis=1)
    return Ends(
        positions=points[tips],
        outward=unit(np.einsum("nk,nki->ni", weights, parts)),
        spacings=np.linalg.norm(points[tips] - points[inner], axis=1) / np.maximum(counts, 1),
    )


def near_pairs(ends: Ends, radius: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of ends within `radius` of the smaller spacing of the two, a < b, and their gaps."""
    tree = cKDTree(ends.positions)
    found = tree.query_ball_point(ends.positions, radius * ends.spacings, return_sorted=True)
    a, b = joined_lists(found)
    gap = ends.positions[b] - ends.positions[a]
    near = np.linalg.norm(gap, axis=1) <= radius * np.minimum(ends.spacings[a], ends.spacings[b])
    keep = near & (a < b)
    return a[keep], b[keep], gap[keep]


def num_behind(
    edges: Edges3D, of: IntArray, origins: FloatArray, directions: FloatArray, limits: FloatArray
) -> IntArray:
    """Number of points at the ends of edges that lie behind the new beginnings of the edges.

    Args:
        edges: the edges; at least two points of each remain.
        of: (n,) ends.
        origins: (n, 3) new beginnings of the edges at these ends.
        directions: (n, 3) unit directions from there into the edges.
        limits: (n,) minimum distance of points along `directions`, in world units.

    Returns:
        (2E,) number of points at each end, at most `REACH`.
    """
    sizes = np.diff(edges.edge_offsets)[of // 2]
    skip = np.zeros(2 * edges.num_edges, np.int64)
    for step in range(REACH):
        ahead = edges.points[points_inward(edges, of, step)] - origins
        behind = (np.einsum("ij,ij->i", ahead, directions) < limits) & (skip[of] == step)
        behind &= sizes > skip[of] + skip[of ^ 1] + 2  # at least two points of every edge remain
        skip[of[behind]] += 1
    return skip


def views_near(edges: Edges3D, ends: IntArray, num_views: int) -> csc_array:
    """(n, V) sparse: view v observes an edge point near one of (n, k) ends."""
    tips, inner = end_points(edges.edge_offsets, REACH)
    of = ends.ravel()
    observed = edges.observations
    first = observed.offsets[np.minimum(tips, inner)[of]]
    last = observed.offsets[np.maximum(tips, inner)[of] + 1]
    views = observed.views[ranges_of(first, last)]
    rows = np.repeat(np.repeat(np.arange(len(ends)), ends.shape[1]), last - first)
    return csc_array((np.ones(len(views), bool), (rows, views)), shape=(len(ends), num_views))


def points_inward(edges: Edges3D, of: IntArray, steps: IntArray | int) -> IntArray:
    """(n,) points `steps` inward of the tips of ends, at most as far as the opposite tips."""
    first, last = edges.edge_offsets[of // 2], edges.edge_offsets[of // 2 + 1] - 1
    return np.clip(np.where(of % 2 == 0, first + steps, last - steps), first, last)
