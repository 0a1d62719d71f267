"""Joining of 3D edge pieces to whole edges, closed or with nodes (paper: future work).

A chain that ends in one view often continues in another view, which traced the rest of the edge.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.core.polylines import match_best_first, points_along, unit, walk_joined
from colmap_edges.edges3d.linking.bends import go_on_smoothly
from colmap_edges.edges3d.linking.ends import (
    REACH,
    SHORT_GAP,
    Ends,
    find_ends,
    near_pairs,
    num_behind,
)
from colmap_edges.options import LinkingOptions

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


def with_more(
    edges: Edges3D,
    points: FloatArray,
    sizes: IntArray,
    observations: Observations,
    sigmas: FloatArray,
) -> Edges3D:
    """Add open edges to edges that do not meet at nodes yet.

    Args:
        edges: edges without nodes.
        points: (M, 3) points of the added edges, one edge after the other; without colours.
        sizes: (n,) numbers of points of the added edges.
        observations: tracks of the M points.
        sigmas: (M,) standard deviations of the M points, world units.
    """
    return Edges3D(
        points=np.concatenate([edges.points, points]),
        edge_offsets=offsets_of(np.concatenate([np.diff(edges.edge_offsets), sizes])),
        closed=np.concatenate([edges.closed, np.zeros(len(sizes), bool)]),
        observations=Observations.concatenated([edges.observations, observations]),
        sigmas=np.concatenate([edges.sigmas, sigmas]),
        end_nodes=np.full((edges.num_edges + len(sizes), 2), -1, np.int32),
        colors=np.concatenate([edges.colors, np.zeros(points.shape, np.uint8)]),
    )


def match_ends(edges: Edges3D, ends: Ends, options: LinkingOptions, goes_on: GoesOn) -> IntArray:
    """(2E,) the end that continues each end, best pairs first, or -1."""
    a, b, gap = near_pairs(ends, options.max_gap_spacings)
    sizes = np.diff(edges.edge_offsets)
    spacing = np.minimum(ends.spacings[a], ends.spacings[b])
    lengths = np.linalg.norm(gap, axis=1)
    turn = -np.einsum("ij,ij->i", ends.outward[a], ends.outward[b])
    direction = unit(ends.outward[a] - ends.outward[b])
    along = np.einsum("ij,ij->i", direction, gap)
    across = np.linalg.norm(gap - along[:, None] * direction, axis=1)
    facing, bent = (
        (turn >= np.cos(angle)) & (across <= np.tan(angle) * np.maximum(along, spacing))
        for angle in (np.radians(options.max_join_angle_deg), np.radians(60.0))
    )
    rows = np.flatnonzero(bent & ~facing & (along > 0))
    facing[rows] = go_on_smoothly(edges, a[rows], b[rows])
    # One piece later loses the overlap, so it must be longer than it.
    allowed = facing & (along >= -(REACH - 1) * spacing)
    # A closed edge has at least eight points.
    allowed &= (a // 2 != b // 2) | (sizes[a // 2] >= 8)
    rows = np.flatnonzero(allowed & (lengths > SHORT_GAP * spacing))
    allowed[rows] = goes_on(ends, a[rows], b[rows])
    cost = lengths / spacing + 2 * across / spacing
    return match_best_first(len(ends.positions), a, b, allowed, cost)


def overlaps(edges: Edges3D, ends: Ends, partner: IntArray) -> IntArray:
    """(2E,) number of points to drop at each end because the joined piece overlaps them."""
    joined = np.flatnonzero((partner >= 0) & (np.arange(len(partner)) < partner))
    positions, outward = ends.positions[joined], ends.outward[joined]
    return num_behind(edges, partner[joined], positions, outward, 0.3 * ends.spacings[joined])
