"""2D edge graph of chains: joining at gaps, cutting at corners (paper: 2D Edge-Graphs)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    owners_of,
)
from colmap_edges.core.polylines import (
    end_points,
    match_best_first,
    points_along,
    unit,
    walk_joined,
)
from colmap_edges.core.view import View
from colmap_edges.edges2d.corners import cut_at_corners
from colmap_edges.edges2d.detection import Chains
from colmap_edges.edges2d.topology import NODE_RADIUS_PX, regular_polylines, topology_of
from colmap_edges.options import EdgeGraphOptions


@dataclass(frozen=True, kw_only=True)
class EdgeGraph:
    """The 2D edge graph of one image: polylines between nodes, dense and sub-pixel.

    Coordinates are in single precision, a thousandth of their noise: graphs are most of a run's
    memory.

    Attributes:
        points: (N, 2) float32 dense chain points, image pixels, COLMAP's origin; those of one
            polyline are contiguous, and about a pixel of the upsampled image apart.
        undistorted: (N, 2) float32 the same points in undistorted pixels.
        normals: (N, 2) float32 unit normals of the edge, dark to bright, in undistorted pixels.
        sides: (N, 2) uint8 intensity on the dark and on the bright side.
        colors: (N, 3) uint8 RGB of the image there; black if not sampled.
        polyline_offsets: (P + 1,) int64; polyline p is points[offsets[p]:offsets[p + 1]].
        closed: (P,) bool; the last point of a closed polyline connects to its first.
    """

    points: Annotated[Float32Array, "N", 2]
    undistorted: Annotated[Float32Array, "N", 2]
    normals: Annotated[Float32Array, "N", 2]
    sides: Annotated[ByteArray, "N", 2]
    colors: Annotated[ByteArray, "N", 3]
    polyline_offsets: Annotated[IntArray, "P+1"]
    closed: Annotated[BoolArray, "P"]

    @property
    def num_polylines(self) -> int:
        """Number of polylines."""
        return len(self.closed)

    @property
    def polyline_ids(self) -> Int32Array:
        """(N,) polyline of each point."""
        lengths = np.diff(self.polyline_offsets)
        return np.repeat(np.arange(self.num_polylines, dtype=np.int32), lengths)


def build_edge_graph(
    chains: Chains, view: View, options: EdgeGraphOptions
) -> tuple[EdgeGraph, FloatArray]:
    """Make the 2D edge graph of a view from its chains.

    Args:
        chains: sub-pixel chains of the view's image, upsampled `view.scale` times.
        view: the view; chains with points that cannot be undistorted are left out.
        options: joining, corners and filter.

    Returns:
        The edge graph, filtered by regular length if the options say so, and the (K, 2) points of
        dropped chains, both in pixels of the given image.
    """
    finite = np.isfinite(view.undistorted_from_image(chains.points / view.scale))
    chains, dropped = drop_chains(chains, finite[:, 0] & finite[:, 1])
    joined, closed = join_chains(chains, options.max_gap_points, options.max_join_angle_deg)
    pieces, closed = cut_at_corners(joined, closed, options.min_corner_angle_deg)
    graph = assemble(pieces, closed, view)
    dropped = dropped / view.scale
    if options.filter_regular_length:
        kept = regular_polylines(graph.points, topology_of(graph, view, options), options)
        dropped = np.concatenate([dropped, graph.points[~kept[graph.polyline_ids]]])
        graph = keep_polylines(graph, kept)
    return graph, dropped


def drop_chains(chains: Chains, usable: BoolArray) -> tuple[Chains, FloatArray]:
    """Drop every chain with an unusable point; also returns the (K, 2) dropped points."""
    if usable.all():
        return chains, np.zeros((0, 2))
    ids = owners_of(chains.offsets)
    bad = np.bincount(ids[~usable], minlength=len(chains.offsets) - 1) > 0
    keep = ~bad[ids]
    lengths = np.diff(chains.offsets)[~bad]
    return chains.cut(np.flatnonzero(keep), lengths), chains.points[~keep]


def join_chains(
    chains: Chains, max_gap_points: float, max_angle_deg: float
) -> tuple[Chains, BoolArray]:
    """Join chains whose ends face each other across a small gap and agree in direction.

    Detected chains are broken at corners, junctions and low contrast. Ends are matched best first;
    a chain matched with itself is closed.

    Returns:
        The joined chains and (C,) whether each is closed.
    """
    partner = match_ends(chains, max_gap_points, max_angle_deg)
    paths = walk_joined(partner)
    order, lengths = points_along(paths, chains.offsets[:-1], chains.offsets[1:])
    return chains.cut(order, lengths), np.array([closed for _, closed in paths], bool)


def match_ends(chains: Chains, max_gap_points: float, max_angle_deg: float) -> IntArray:
    """(2C,) partner of each chain end or -1; end 2c is the first point of chain c, 2c + 1 its last.

    Two ends can be joined if they touch, or if the direction continues across a small gap, and
    the bright side stays on the same side.
    """
    positions, outward, side = chain_ends(chains)
    if len(positions) == 0:
        return np.zeros(0, np.int64)
    pairs = cKDTree(positions).query_pairs(max_gap_points, output_type="ndarray")
    a, b = pairs[:, 0], pairs[:, 1]
    gap = positions[b] - positions[a]
    distance = np.linalg.norm(gap, axis=1)
    turn = -np.einsum("ij,ij->i", outward[a], outward[b])
    along = (np.einsum("ij,ij->i", outward[a], gap) - np.einsum("ij,ij->i", outward[b], gap)) / 2
    cos_limit = np.cos(np.radians(max_angle_deg))
    touching = distance < NODE_RADIUS_PX  # at a corner any turn is allowed
    straight = (turn >= cos_limit) & (along >= cos_limit * distance)
    allowed = (touching | straight) & (side[a] == -side[b])
    cost = distance + (1 - turn) * max_gap_points
    return match_best_first(len(positions), a, b, allowed, cost)


def chain_ends(chains: Chains) -> tuple[FloatArray, FloatArray, IntArray]:
    """Positions (2C, 2), outward directions (2C, 2) and bright sides (2C,) of 2C chain ends.

    The bright side is +1 if the normal is to the left of the outward direction, else -1.
    """
    # Points over which the direction of a chain's end is measured.
    tips, inner = end_points(chains.offsets, 5)
    outward = chains.points[tips] - chains.points[inner]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True) + 1e-12
    normals = chains.normals[inner]
    cross = outward[:, 0] * normals[:, 1] - outward[:, 1] * normals[:, 0]
    return chains.points[tips], outward, np.where(cross >= 0, 1, -1)


def assemble(chains: Chains, closed: BoolArray, view: View) -> EdgeGraph:
    """Undistort joined chains."""
    points = chains.points / view.scale
    undistorted = view.undistorted_from_image(points)
    across = view.undistorted_from_image(points + 0.5 * chains.normals) - undistorted
    return EdgeGraph(
        points=points.astype(np.float32),
        undistorted=undistorted.astype(np.float32),
        normals=unit(across).astype(np.float32),
        sides=chains.sides,
        colors=np.zeros((len(undistorted), 3), np.uint8),
        polyline_offsets=chains.offsets,
        closed=closed,
    )


def keep_polylines(graph: EdgeGraph, keep: BoolArray) -> EdgeGraph:
    """The graph with only the polylines where `keep` (P,) is true."""
    lengths = np.diff(graph.polyline_offsets)[keep]
    return of_points(graph, keep[graph.polyline_ids], lengths, graph.closed[keep])


def keep_points(graph: EdgeGraph, keep: BoolArray) -> EdgeGraph:
    """The graph of the points where `keep` (N,) is true; polylines are cut at dropped points."""
    kept = np.flatnonzero(keep)
    ids = graph.polyline_ids[kept]
    first = np.ones(len(kept), bool)
    first[1:] = (np.diff(kept) > 1) | (np.diff(ids) != 0)
    starts = np.flatnonzero(first)
    lengths = np.diff(np.append(starts, len(kept)))
    whole = lengths == np.diff(graph.polyline_offsets)[ids[starts]]
    return of_points(graph, kept, lengths, graph.closed[ids[starts]] & whole)


def of_points(
    graph: EdgeGraph, points: BoolArray | IntArray, lengths: IntArray, closed: BoolArray
) -> EdgeGraph:
    """The graph of selected points, as polylines of (P,) `lengths`, `closed` or not."""
    return EdgeGraph(
        points=graph.points[points],
        undistorted=graph.undistorted[points],
        normals=graph.normals[points],
        sides=graph.sides[points],
        colors=graph.colors[points],
        polyline_offsets=offsets_of(lengths),
        closed=closed,
    )
