"""2D edge graph of chains: joining, smoothing, regular-length filter (paper: 2D Edge-Graphs)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
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
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import EdgeGraphOptions

NODE_RADIUS_PX = 2.0  # distance at which an end touches another edge (8-neighbours, sub-pixel)
DIRECTION_STEP = 5  # points over which the direction of a chain's end is measured


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
        end_nodes: (P, 2) int32 node of the first and last point; polylines that share a node
            meet there; a closed polyline has its one node twice.
        node_polylines: (K,) int32 polyline that passes through a node (T junction), -1 if none.
        smoothed: (S,) int64 indices into `points` that Douglas-Peucker keeps.
        smoothed_offsets: (P + 1,) int64 CSR of `smoothed` by polyline.
    """

    points: Float32Array
    undistorted: Float32Array
    normals: Float32Array
    sides: ByteArray
    colors: ByteArray
    polyline_offsets: IntArray
    closed: BoolArray
    end_nodes: Int32Array
    node_polylines: Int32Array
    smoothed: IntArray
    smoothed_offsets: IntArray

    @classmethod
    def none(cls) -> EdgeGraph:
        """A graph without polylines."""
        pairs = np.zeros((0, 2), np.float32)
        return cls(
            points=pairs,
            undistorted=pairs,
            normals=pairs,
            sides=np.zeros((0, 2), np.uint8),
            colors=np.zeros((0, 3), np.uint8),
            polyline_offsets=np.zeros(1, np.int64),
            closed=np.zeros(0, bool),
            end_nodes=np.zeros((0, 2), np.int32),
            node_polylines=np.zeros(0, np.int32),
            smoothed=np.zeros(0, np.int64),
            smoothed_offsets=np.zeros(1, np.int64),
        )

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
        options: joining, corners, smoothing and filter.

    Returns:
        The edge graph, filtered by regular length if the options say so, and the (K, 2) points of
        dropped chains, both in pixels of the given image.
    """
    finite = np.isfinite(view.undistorted_from_image(chains.points / view.scale))
    chains, dropped = drop_chains(chains, finite[:, 0] & finite[:, 1])
    joined, closed = join_chains(chains, options.max_gap_points, options.max_join_angle_deg)
    pieces, closed = cut_at_corners(joined, closed, options.min_corner_angle_deg)
    graph = assemble(pieces, closed, view, options)
    dropped = dropped / view.scale
    if options.filter_regular_length:
        kept = regular_polylines(graph, options)
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
    return chains.select(np.flatnonzero(keep), lengths), chains.points[~keep]


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
    return chains.select(order, lengths), np.array([closed for _, closed in paths], bool)


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
    tips, inner = end_points(chains.offsets, DIRECTION_STEP)
    outward = chains.points[tips] - chains.points[inner]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True) + 1e-12
    normals = chains.normals[inner]
    cross = outward[:, 0] * normals[:, 1] - outward[:, 1] * normals[:, 0]
    return chains.points[tips], outward, np.where(cross >= 0, 1, -1)


def assemble(chains: Chains, closed: BoolArray, view: View, options: EdgeGraphOptions) -> EdgeGraph:
    """Undistort and smooth joined chains and find their nodes."""
    points = chains.points / view.scale
    undistorted = view.undistorted_from_image(points)
    across = view.undistorted_from_image(points + 0.5 * chains.normals) - undistorted
    size = np.ceil(np.array([view.width, view.height]) * view.scale).astype(int)
    end_nodes, node_polylines = find_nodes(chains, closed, *size.tolist())
    smoothed, smoothed_offsets = _kernels.douglas_peucker(
        chains.points, chains.offsets, options.max_smoothing_distance_px
    )
    return EdgeGraph(
        points=points.astype(np.float32),
        undistorted=undistorted.astype(np.float32),
        normals=unit(across).astype(np.float32),
        sides=chains.sides,
        colors=np.zeros((len(undistorted), 3), np.uint8),
        polyline_offsets=chains.offsets,
        closed=closed,
        end_nodes=end_nodes,
        node_polylines=node_polylines,
        smoothed=smoothed,
        smoothed_offsets=smoothed_offsets,
    )


def find_nodes(
    chains: Chains, closed: BoolArray, width: int, height: int
) -> tuple[Int32Array, Int32Array]:
    """Nodes of the polyline ends; ends that touch share a node.

    An end that touches the inside of another polyline makes a T junction.

    Returns:
        (P, 2) int32 nodes of the ends, (K,) int32 polyline through each node or -1.
    """
    count = len(closed)
    if count == 0:
        return np.zeros((0, 2), np.int32), np.zeros(0, np.int32)
    positions, _, _ = chain_ends(chains)
    pairs = cKDTree(positions).query_pairs(NODE_RADIUS_PX, output_type="ndarray")
    own = 2 * np.flatnonzero(closed)
    rows, columns = np.concatenate([pairs[:, 0], own]), np.concatenate([pairs[:, 1], own + 1])
    links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * count, 2 * count))
    num_nodes, nodes = connected_components(links, directed=False)
    through = np.full(num_nodes, -1, np.int32)
    touched = _kernels.touched_chains(chains.points, chains.offsets, width, height)
    np.maximum.at(through, nodes, touched)
    return nodes.reshape(-1, 2).astype(np.int32), through


def regular_lengths(graph: EdgeGraph, max_angle_deg: float) -> FloatArray:
    """(P,) regular length of each smoothed polyline in pixels.

    The length of the longest run of connected segments whose consecutive angles are not greater
    than `max_angle_deg` (paper: definition of regular length).
    """
    vertices = graph.points[graph.smoothed]
    ids = owners_of(graph.smoothed_offsets)
    within = ids[1:] == ids[:-1]
    segments = np.diff(vertices, axis=0)[within]
    polyline = ids[1:][within]
    result = np.zeros(graph.num_polylines)
    if len(segments) == 0:
        return result
    lengths = np.linalg.norm(segments, axis=1)
    directions = segments / (lengths[:, None] + 1e-12)
    cosines = np.einsum("ij,ij->i", directions[1:], directions[:-1])
    breaks = (cosines < np.cos(np.radians(max_angle_deg))) | (polyline[1:] != polyline[:-1])
    run = np.concatenate([[0], np.cumsum(breaks)])
    run_lengths = np.bincount(run, weights=lengths)
    run_polylines = polyline[np.concatenate([[0], np.flatnonzero(breaks) + 1])]
    np.maximum.at(result, run_polylines, run_lengths)
    return result


def regular_polylines(graph: EdgeGraph, options: EdgeGraphOptions) -> BoolArray:
    """(P,) whether a polyline's component has one of at least the threshold's regular length.

    The threshold is the shortest regular length among the top share of polylines (paper: l_R*).
    """
    if graph.num_polylines == 0:
        return np.zeros(0, bool)
    lengths = regular_lengths(graph, options.max_regular_angle_deg)
    top = max(1, int(np.ceil(options.top_regular_length_ratio * len(lengths))))
    threshold = np.sort(lengths)[-top]
    component = component_labels(graph)
    longest = np.zeros(component.max() + 1)
    np.maximum.at(longest, component, lengths)
    kept: BoolArray = longest[component] >= threshold
    return kept


def component_labels(graph: EdgeGraph) -> IntArray:
    """(P,) connected component of each polyline, through shared nodes and T junctions."""
    count, num_nodes = graph.num_polylines, len(graph.node_polylines)
    through = np.flatnonzero(graph.node_polylines >= 0)
    polylines = np.concatenate([np.repeat(np.arange(count), 2), graph.node_polylines[through]])
    nodes = np.concatenate([graph.end_nodes.ravel(), through]) + count
    size = count + num_nodes
    links = coo_array((np.ones(len(nodes)), (polylines, nodes)), shape=(size, size))
    labels: IntArray = connected_components(links, directed=False)[1][:count].astype(np.int64)
    return labels


def keep_polylines(graph: EdgeGraph, keep: BoolArray) -> EdgeGraph:
    """The graph with only the polylines where `keep` (P,) is true; node ids stay."""
    ids = graph.polyline_ids
    points = keep[ids]
    moved = np.cumsum(points) - 1
    smoothed_ids = owners_of(graph.smoothed_offsets)
    renumbered = np.where(keep, np.cumsum(keep) - 1, -1).astype(np.int32)
    through = graph.node_polylines
    return EdgeGraph(
        points=graph.points[points],
        undistorted=graph.undistorted[points],
        normals=graph.normals[points],
        sides=graph.sides[points],
        colors=graph.colors[points],
        polyline_offsets=offsets_of(np.diff(graph.polyline_offsets)[keep]),
        closed=graph.closed[keep],
        end_nodes=graph.end_nodes[keep],
        node_polylines=np.where(through >= 0, renumbered[through], -1).astype(np.int32),
        smoothed=moved[graph.smoothed[keep[smoothed_ids]]],
        smoothed_offsets=offsets_of(np.diff(graph.smoothed_offsets)[keep]),
    )


def keep_points(graph: EdgeGraph, keep: BoolArray) -> EdgeGraph:
    """The graph of the points where `keep` (N,) is true; polylines are cut at dropped points.

    The pieces share no nodes: each end is a node of its own.
    """
    kept = np.flatnonzero(keep)
    ids = graph.polyline_ids[kept]
    first = np.ones(len(kept), bool)
    first[1:] = (np.diff(kept) > 1) | (np.diff(ids) != 0)
    starts = np.flatnonzero(first)
    lengths = np.diff(np.append(starts, len(kept)))
    last = starts + lengths - 1
    whole = lengths == np.diff(graph.polyline_offsets)[ids[starts]]
    is_smoothed = np.zeros(len(keep), bool)
    is_smoothed[graph.smoothed] = True
    vertices = first | is_smoothed[kept]
    vertices[last] = True
    smoothed = np.flatnonzero(vertices)
    pieces = np.cumsum(first) - 1
    count = len(starts)
    return EdgeGraph(
        points=graph.points.take(kept, axis=0),
        undistorted=graph.undistorted.take(kept, axis=0),
        normals=graph.normals.take(kept, axis=0),
        sides=graph.sides.take(kept, axis=0),
        colors=graph.colors.take(kept, axis=0),
        polyline_offsets=offsets_of(lengths),
        closed=graph.closed[ids[starts]] & whole,
        end_nodes=np.arange(2 * count, dtype=np.int32).reshape(-1, 2),
        node_polylines=np.full(2 * count, -1, np.int32),
        smoothed=smoothed,
        smoothed_offsets=offsets_of(np.bincount(pieces[smoothed], minlength=count)),
    )
