"""Joining of 3D edge pieces to whole edges, closed or with nodes (paper: future work).

A chain that ends in one view often continues in another view, which traced the rest of the edge.
Lengths are in spacings, the local distance between edge points, and so independent of the unit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.sparse import csc_array
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of, ranges_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import end_points, match_best_first, points_along, walk_joined
from colmap_edges.edges3d.linking.bends import go_on_smoothly
from colmap_edges.options import LinkingOptions

REACH = 4  # points from an end over which its direction and spacing are measured
MAX_TURN = np.radians(60.0)  # maximum turn across a gap in a curve
MIN_LOOP_POINTS = 8  # minimum number of points of a closed edge
SHORT_GAP = 2.0  # gap, in spacings, below which pieces are joined without a test


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


# From (n,) ends a and (n,) ends b: (n,) whether an edge connects each a to its b.
GoesOn = Callable[[Ends, IntArray, IntArray], BoolArray]


def link_edges(edges: Edges3D, options: LinkingOptions, goes_on: GoesOn) -> Edges3D:
    """Join edges whose ends face each other, and close loops.

    Args:
        edges: pieces; where ends overlap by a few points, these are left out.
        options: maximum gap and angle between ends.
        goes_on: decides whether an edge continues through gaps longer than `SHORT_GAP` spacings.

    Returns:
        The linked edges; tracks are in the order of their points.
    """
    if edges.num_edges == 0:
        return edges
    ends = find_ends(edges)
    return joined(edges, ends, match_ends(edges, ends, options, goes_on))


def joined(edges: Edges3D, ends: Ends, partner: IntArray) -> Edges3D:
    """Join each of 2E ends to its partner, -1 for none; where they overlap, points are left out."""
    skip = overlaps(edges, ends, partner)
    begin, stop = edges.edge_offsets[:-1] + skip[::2], edges.edge_offsets[1:] - skip[1::2]
    paths = walk_joined(partner)
    order, lengths = points_along(paths, begin, stop)
    loops = np.array([closed for _, closed in paths], bool)
    return edges.reordered(order, offsets_of(lengths), loops)


def find_ends(edges: Edges3D) -> Ends:
    """The ends of all edges with their directions and spacings."""
    tips, inner = end_points(edges.edge_offsets, REACH)
    chords = edges.points[tips] - edges.points[inner]
    lengths = np.linalg.norm(chords, axis=1)
    outward = end_directions(edges, tips, inner)
    return Ends(
        positions=edges.points[tips],
        outward=outward / (np.linalg.norm(outward, axis=1, keepdims=True) + 1e-300),
        spacings=lengths / np.maximum(np.abs(tips - inner), 1),
    )


def end_directions(edges: Edges3D, tips: IntArray, inner: IntArray) -> FloatArray:
    """(2E, 3) directions out of the edges at their ends, of any length.

    Tangents of parabolas through the last points, since the chord of an arc of a small circle
    deviates from its tangent. For pieces too short for a parabola, the chord.
    """
    points, middle = edges.points, (tips + inner) // 2
    curved = np.abs(tips - inner) == REACH
    weights = np.where(curved[:, None], (3.0, -4.0, 1.0), (1.0, 0.0, -1.0))
    parts = np.stack([points[tips], points[middle], points[inner]], axis=1)
    return np.asarray(np.einsum("nk,nki->ni", weights, parts), np.float64)


def near_pairs(ends: Ends, radius: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of ends within `radius` of the smaller spacing of the two, a < b, and their gaps."""
    tree = cKDTree(ends.positions)
    found = tree.query_ball_point(ends.positions, radius * ends.spacings, return_sorted=True)
    a = np.repeat(np.arange(len(found)), [len(row) for row in found])
    b = np.fromiter(chain.from_iterable(found), np.int64, len(a))
    gap = ends.positions[b] - ends.positions[a]
    near = np.linalg.norm(gap, axis=1) <= radius * np.minimum(ends.spacings[a], ends.spacings[b])
    keep = near & (a < b)
    return a[keep], b[keep], gap[keep]


def match_ends(edges: Edges3D, ends: Ends, options: LinkingOptions, goes_on: GoesOn) -> IntArray:
    """(2E,) the end that continues each end, best pairs first, or -1."""
    a, b, gap = near_pairs(ends, options.max_gap_spacings)
    sizes = np.diff(edges.edge_offsets)
    spacing = np.minimum(ends.spacings[a], ends.spacings[b])
    lengths = np.linalg.norm(gap, axis=1)
    turn = -np.einsum("ij,ij->i", ends.outward[a], ends.outward[b])
    direction = ends.outward[a] - ends.outward[b]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True) + 1e-300
    along = np.einsum("ij,ij->i", direction, gap)
    across = np.linalg.norm(gap - along[:, None] * direction, axis=1)
    facing, bent = (
        (turn >= np.cos(angle)) & (across <= np.tan(angle) * np.maximum(along, spacing))
        for angle in (np.radians(options.max_join_angle_deg), MAX_TURN)
    )
    rows = np.flatnonzero(bent & ~facing & (along > 0))
    facing[rows] = go_on_smoothly(edges, a[rows], b[rows])
    # One piece later loses the overlap, so it must be longer than it.
    allowed = facing & (along >= -(REACH - 1) * spacing)
    allowed &= (a // 2 != b // 2) | (sizes[a // 2] >= MIN_LOOP_POINTS)
    rows = np.flatnonzero(allowed & (lengths > SHORT_GAP * spacing))
    allowed[rows] = goes_on(ends, a[rows], b[rows])
    cost = lengths / spacing + 2 * across / spacing
    return match_best_first(len(ends.positions), a, b, allowed, cost)


def overlaps(edges: Edges3D, ends: Ends, partner: IntArray) -> IntArray:
    """(2E,) number of points to drop at each end because the joined piece overlaps them."""
    joined = np.flatnonzero((partner >= 0) & (np.arange(len(partner)) < partner))
    positions, outward = ends.positions[joined], ends.outward[joined]
    return num_behind(edges, partner[joined], positions, outward, 0.3 * ends.spacings[joined])


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
    tips = end_points(edges.edge_offsets, 0)[0][of]
    skip = np.zeros(2 * edges.num_edges, np.int64)
    for step in range(REACH):
        place = tips + np.where(of % 2 == 0, 1, -1) * np.minimum(step, sizes - 1)
        ahead = np.einsum("ij,ij->i", edges.points[place] - origins, directions)
        behind = (ahead < limits) & (skip[of] == step)
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
