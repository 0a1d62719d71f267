"""Places where straight pieces of chains, which no 3D edge observes yet, meet 3D edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    Table,
    entries_of,
    joined_tables,
    ranges_of,
    row_numbers,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import curve_tangents, unit
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_index import IndexedGraphs
from colmap_edges.edges2d.straight_pieces import near_observations, straight_pieces
from colmap_edges.edges3d.linking.corners import fit_end_lines
from colmap_edges.edges3d.linking.ends import MIN_ANGLE_DEG
from colmap_edges.runtime.executors import in_threads

STRAIGHT_PX = 1.0  # maximum distance of a piece's points from its chord
MAX_OBSERVED = 0.5  # maximum share of a piece that 3D edges observe
NUM_NEAR = 32  # maximum number of edge points, and of ends of edges, next to an end of a piece
END_PX = 5.0  # maximum distance of an end of a piece from where it meets an edge
REACH_SPACINGS = 2.0  # maximum distance along an edge from its points to where a piece meets it


@dataclass(frozen=True, kw_only=True)
class Anchors(Table):
    """Places where ends of the pieces of one view meet edges: one for each end and edge.

    Attributes:
        pieces: (n,) int64 piece, ascending.
        sides: (n,) int64 end of the piece, 0 or 1.
        edges: (n,) int64 edge.
        places: (n,) place on the edge: distance along it from its first point, world units.
        points: (n, 3) where the plane through view and piece meets the edge.
        scales: (n,) pixels per world unit there.
    """

    pieces: IntArray
    sides: IntArray
    edges: IntArray
    places: FloatArray
    points: FloatArray
    scales: FloatArray


@dataclass(frozen=True, kw_only=True)
class AnchoredPieces(Table):
    """Pieces of all views both of whose ends meet edges, each with every pair of these.

    Attributes:
        views: (n,) int32.
        normals: (n, 3) unit normals of the planes through view and piece.
        edges: (n, 2) int64 edges, in ascending order of edge and place.
        places: (n, 2) as in `Anchors`.
        points: (n, 2, 3).
        scales: (n, 2).
    """

    views: Int32Array
    normals: FloatArray
    edges: IntArray
    places: FloatArray
    points: FloatArray
    scales: FloatArray


@dataclass(frozen=True, kw_only=True)
class EdgeLines(Table):
    """Straight lines along edges at their points; at the ends of open edges, the lines of the ends.

    Attributes:
        points: (N, 3) the edge points.
        edges: (N,) int64 their edges.
        places: (N,) distances along the edges from their first points.
        centers: (N, 3) a point of each line.
        directions: (N, 3) unit; along the edge.
        least: (N,) how far the line reaches backwards from the edge point, in spacings.
        most: (N,) how far forwards.
        spacings: (N,) distance between edge points.
    """

    points: FloatArray
    edges: IntArray
    places: FloatArray
    centers: FloatArray
    directions: FloatArray
    least: FloatArray
    most: FloatArray
    spacings: FloatArray


def find_anchored_pieces(
    edges: Edges3D,
    views: Sequence[View] | Mapping[int, View],
    given: IndexedGraphs,
    max_extension: float,
    num_threads: int,
) -> AnchoredPieces:
    """The straight pieces that no edge observes, and both of whose ends meet edges.

    Args:
        edges: edges, which may meet pieces in the views that observe them.
        views: the views.
        given: their edge graphs.
        max_extension: maximum extension of ends of edges, in spacings.
        num_threads: threads to use; the result does not depend on it.
    """
    lines = edge_lines(edges, max_extension)
    observed = edges.observations
    edges_seen = edges.edge_ids[observed.points]
    none = with_both_ends(NO_ANCHORS, np.zeros((0, 3)), 0)

    def pieces_of(number: int, rows: IntArray) -> AnchoredPieces:
        view, graph = views[number], given.graph(number)
        known = near_observations(len(graph.undistorted), observed.positions[rows])
        pieces = straight_pieces(graph, known, STRAIGHT_PX)
        ends = pieces.ends[pieces.observed <= MAX_OBSERVED]
        if not len(ends):
            return none
        rays = view.rays_of_undistorted(ends)
        normals = unit(np.cross(rays[:, 0], rays[:, 1]))
        seen = entries_of(edges.edge_offsets, np.unique(edges_seen[rows]))
        anchors = find_anchors(lines.select(seen), ends, normals, view)
        return with_both_ends(anchors, normals, number)

    found = in_threads(lambda of: pieces_of(*of), observed.by_view(), num_threads)
    return joined_tables([none, *found])


NO_ANCHORS = Anchors(
    pieces=np.zeros(0, np.int64),
    sides=np.zeros(0, np.int64),
    edges=np.zeros(0, np.int64),
    places=np.zeros(0),
    points=np.zeros((0, 3)),
    scales=np.zeros(0),
)


def edge_lines(edges: Edges3D, max_extension: float) -> EdgeLines:
    """The lines along edges, which are extended by at most `max_extension` spacings."""
    steps = np.zeros(edges.num_points)
    steps[1:] = np.linalg.norm(np.diff(edges.points, axis=0), axis=1)
    ways = np.cumsum(steps)
    places = ways - ways[edges.edge_offsets[:-1]][edges.edge_ids]
    sizes = np.diff(edges.edge_offsets)
    lengths = places[edges.edge_offsets[1:] - 1]
    lines = EdgeLines(
        points=edges.points,
        edges=edges.edge_ids.astype(np.int64),
        places=places,
        centers=edges.points.copy(),
        directions=unit(curve_tangents(edges.points, edges.edge_offsets)),
        least=np.full(edges.num_points, -REACH_SPACINGS),
        most=np.full(edges.num_points, REACH_SPACINGS),
        spacings=(lengths / np.maximum(sizes - 1, 1))[edges.edge_ids],
    )
    ends = fit_end_lines(edges)
    for side, tips in enumerate((edges.edge_offsets[:-1], edges.edge_offsets[1:] - 1)):
        tips, of = tips[~edges.closed], 2 * np.flatnonzero(~edges.closed) + side
        lines.centers[tips] = ends.centers[of]
        lines.directions[tips] = ends.outward[of] * (2 * side - 1)
        (lines.most if side else lines.least)[tips] = max_extension * (2 * side - 1)
    return lines


def near_points(lines: EdgeLines, pixels: FloatArray, view: View) -> tuple[IntArray, IntArray]:
    """Pairs of (n,) undistorted pixels and (N,) lines that may pass there, as their indices."""
    at, depths = view.project_undistorted(lines.points)
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = lines.spacings * view.focal_px / depths
    reach = END_PX + np.maximum(-lines.least, lines.most) * steps
    front = (depths > 0) & np.isfinite(at).all(axis=1)
    inside = np.maximum(-lines.least, lines.most) <= REACH_SPACINGS
    found = []
    for rows in (np.flatnonzero(front & inside), np.flatnonzero(front & ~inside)):
        if len(rows):
            tree, most = cKDTree(at[rows]), float(reach[rows].max())
            off, index = tree.query(pixels, k=[*range(1, NUM_NEAR + 1)], distance_upper_bound=most)
            index = np.where(np.isfinite(off), index, 0)
            which, rank = np.nonzero(off <= reach[rows][index])
            found.append((which, rows[index[which, rank]]))
    none = np.zeros(0, np.int64)
    hits, near = (np.concatenate([none, *(of[i] for of in found)]) for i in range(2))
    return hits, near


def find_anchors(lines: EdgeLines, ends: FloatArray, normals: FloatArray, view: View) -> Anchors:
    """Places where (L, 2, 2) ends of pieces, in planes with (L, 3) normals, meet edges."""
    hit, near = near_points(lines, ends.reshape(-1, 2), view)
    if not len(hit):
        return NO_ANCHORS
    own = lines.select(near)
    sines = np.einsum("ij,ij->i", normals[hit // 2], own.directions)
    way = np.einsum("ij,ij->i", normals[hit // 2], view.center - own.centers)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = own.centers + (way / sines)[:, None] * own.directions
        along = np.einsum("ij,ij->i", points - own.points, own.directions)
        pixels, depths = view.project_undistorted(points)
        meet = np.abs(sines) >= np.sin(np.radians(MIN_ANGLE_DEG))
        meet &= (along >= own.least * own.spacings) & (along <= own.most * own.spacings)
        meet &= np.linalg.norm(pixels - ends.reshape(-1, 2)[hit], axis=1) <= END_PX
    # Of each edge the place nearest to one of its points.
    order = np.lexsort((np.abs(along), own.edges, hit))
    order = order[meet[order]]
    keys = row_numbers(np.column_stack([hit, own.edges])[order])
    chosen = order[np.unique(keys, return_index=True)[1]]
    return Anchors(
        pieces=hit[chosen] // 2,
        sides=hit[chosen] % 2,
        edges=own.edges[chosen],
        places=own.places[chosen] + along[chosen],
        points=points[chosen],
        scales=view.focal_px / depths[chosen],
    )


def with_both_ends(anchors: Anchors, normals: FloatArray, view: int) -> AnchoredPieces:
    """All pairs of a place at one end of a piece and a place at its other end."""
    left, right = np.flatnonzero(anchors.sides == 0), np.flatnonzero(anchors.sides == 1)
    pieces = anchors.pieces[right]
    low = np.searchsorted(pieces, anchors.pieces[left])
    high = np.searchsorted(pieces, anchors.pieces[left], side="right")
    pairs = np.column_stack([np.repeat(left, high - low), right[ranges_of(low, high)]])
    edges, places = anchors.edges[pairs], anchors.places[pairs]
    turned = (edges[:, 0] > edges[:, 1]) | (
        (edges[:, 0] == edges[:, 1]) & (places[:, 0] > places[:, 1])
    )
    pairs[turned] = pairs[turned, ::-1]
    return AnchoredPieces(
        views=np.full(len(pairs), view, np.int32),
        normals=normals[anchors.pieces[pairs[:, 0]]],
        edges=anchors.edges[pairs],
        places=anchors.places[pairs],
        points=anchors.points[pairs],
        scales=anchors.scales[pairs],
    )
