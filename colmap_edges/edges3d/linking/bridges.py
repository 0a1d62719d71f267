"""Straight edges between two places of other edges: bridges.

Where an edge runs along the motion of the cameras, views see the same line wherever on it a point
is, and tracing finds no depths. But where both its ends lie on other edges, these tell them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    entries_of,
    offsets_of,
    owners_of,
    ranks_of,
    row_numbers,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_index import IndexedGraphs, positions_near
from colmap_edges.edges3d.linking.anchors import AnchoredPieces, find_anchored_pieces
from colmap_edges.edges3d.linking.joining import with_more
from colmap_edges.options import PipelineOptions

SAME_PX = 1.5  # maximum distance of the places where the pieces of two views meet an edge
# Minimum change of the direction from views to a bridge, in pixels: with less, a line behind two
# edges meets them in the same places in all views.
MIN_TURN_PX = 15.0
OBSERVED_SHARE = 0.8  # minimum share of a bridge that views observe
APART_SPACINGS = 1.5  # minimum distance between the ends of two bridges


def with_bridges(
    edges: Edges3D,
    views: Sequence[View] | Mapping[int, View],
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> tuple[Edges3D, int]:
    """Add straight edges between places of others.

    Args:
        edges: linked edges, which do not meet at nodes yet.
        views: the views.
        given: their edge graphs.
        options: maximum extension of ends, limits of observations, minimum number of views.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The edges with bridges, and the number of these.
    """
    if not edges.num_edges:
        return edges, 0
    reach = options.linking.max_corner_spacings
    pieces = find_anchored_pieces(edges, views, given, reach, num_threads)
    # One more than for edge points, since no depths along it agree.
    groups = agreeing(pieces, options.tracing.min_observations + 1)
    groups = [rows for rows in groups if turn_px(pieces.select(rows), views) >= MIN_TURN_PX]
    if not groups:
        return edges, 0
    ends = np.array([np.median(pieces.points[rows], axis=0) for rows in groups])
    between = np.array([pieces.edges[rows[0]] for rows in groups])
    longer = with_observed(edges, ends, between, given, options, num_threads)
    return longer, longer.num_edges - edges.num_edges


def agreeing(pieces: AnchoredPieces, least: int) -> list[IntArray]:
    """Groups of pieces of `least` views or more that meet edges in the same places.

    Those of most views come first.
    """
    pairs = row_numbers(pieces.edges)
    order = np.argsort(pairs, kind="stable")
    groups = []
    for rows in np.split(order, np.flatnonzero(np.diff(pairs[order])) + 1):
        while len(rows) >= least:
            places, views = pieces.places[rows], pieces.views[rows]
            off = np.abs(places[:, None] - places) * pieces.scales[rows]
            same: BoolArray = np.asarray((off <= SAME_PX).all(axis=2))
            counts = [len(np.unique(views[near])) for near in same]
            best = int(np.argmax(counts))
            if counts[best] < least:
                break
            groups.append((counts[best], rows[same[best]]))
            rows = rows[~same[best]]
    groups.sort(key=lambda group: -group[0])
    return [rows for _, rows in groups]


def turn_px(pieces: AnchoredPieces, views: Sequence[View] | Mapping[int, View]) -> float:
    """How far the planes through views and pieces of a group turn, in pixels of the first."""
    turns = np.linalg.norm(np.cross(pieces.normals[0], pieces.normals), axis=1)
    return float(turns.max()) * views[int(pieces.views[0])].focal_px


def with_observed(
    edges: Edges3D,
    ends: FloatArray,
    between: IntArray,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> Edges3D:
    """Add those of B bridges that enough views observe, each once.

    Args:
        edges: the edges.
        ends: (B, 2, 3) ends of the bridges, those first that are to be kept of several.
        between: (B, 2) edges that they lie on.
        given: the edge graphs of all views.
        options: limits of observations, minimum number of views.
        num_threads: threads to use.
    """
    spacings, sigmas = (each[between] for each in of_edges(edges))
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    counts = np.maximum(np.ceil(lengths / spacings.mean(axis=1)).astype(np.int64) + 1, 3)
    offsets = offsets_of(counts)
    owners = owners_of(offsets)
    ways = (ranks_of(counts) / (counts[owners] - 1))[:, None]
    points = (1 - ways) * ends[owners, 0] + ways * ends[owners, 1]
    observed = observe(
        points,
        (ends[:, 1] - ends[:, 0])[owners],
        offsets,
        views_of_both(edges, between, given.num_views),
        given,
        options,
        num_threads,
    )
    enough = observed.counts >= options.tracing.min_observations
    seen = np.bincount(owners, enough, len(counts)) >= OBSERVED_SHARE * counts
    chosen = each_once(ends, np.flatnonzero(seen), APART_SPACINGS * spacings.min(axis=1))
    rows = entries_of(offsets, chosen)
    rows = rows[enough[rows]]
    return with_more(
        edges,
        points[rows],
        np.bincount(owners[rows], minlength=len(counts))[chosen],
        Observations.of_positions(observed.select(rows)),
        sigmas.max(axis=1)[owners[rows]],
    )


def of_edges(edges: Edges3D) -> tuple[FloatArray, FloatArray]:
    """(E,) mean distances between points of edges, and mean standard deviations of the points."""
    sizes = np.diff(edges.edge_offsets)
    known = np.where(np.isfinite(edges.sigmas), edges.sigmas, 0.0)
    sigmas = np.bincount(edges.edge_ids, known, edges.num_edges) / sizes
    return edges.lengths() / np.maximum(sizes - 1, 1), sigmas


def views_of_both(edges: Edges3D, between: IntArray, num_views: int) -> csr_array:
    """(B, V) sparse: whether a view observes both of (B, 2) edges."""
    observed = edges.observations
    where = (edges.edge_ids[observed.points], observed.views)
    seen = csr_array((np.ones(len(observed.views)), where), shape=(edges.num_edges, num_views))
    return csr_array(seen[between[:, 0]].multiply(seen[between[:, 1]]))


def observe(
    points: FloatArray,
    directions: FloatArray,
    offsets: IntArray,
    asked: csr_array,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> ChainObservations:
    """Observations of points of bridges in views that observe most of these.

    Args:
        points: (N, 3) points.
        directions: (N, 3) directions of their bridges.
        offsets: (B + 1,) of the points of each bridge.
        asked: (B, V) sparse; the views that may observe a bridge.
        given: the edge graphs of all views.
        options: search radius and angle.
        num_threads: threads to use.
    """
    cosine = float(np.cos(np.radians(options.refinement.max_tangent_angle_deg)))
    owners, counts = owners_of(offsets), np.diff(offsets)
    by_view = asked.tocsc()
    found = [(np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0))]
    for view in np.flatnonzero(np.diff(by_view.indptr)).tolist():
        bridges = np.sort(by_view.indices[by_view.indptr[view] : by_view.indptr[view + 1]])
        rows = entries_of(offsets, bridges.astype(np.int64))
        index, radius = given.index(view), options.refinement.max_residual_px
        near = positions_near(
            index, radius, num_threads, points[rows, None], directions[rows, None], cosine
        )[:, 0]
        most = np.bincount(owners[rows], near >= 0, len(counts)) >= OBSERVED_SHARE * counts
        kept = (near >= 0) & most[owners[rows]]
        found.append((rows[kept], np.full(kept.sum(), view, np.int32), near[kept]))
    rows, views, positions = (np.concatenate(of) for of in zip(*found, strict=True))
    order = np.argsort(rows, kind="stable")
    return ChainObservations(
        offsets=offsets_of(np.bincount(rows, minlength=len(points))),
        views=views[order],
        positions=positions[order],
    )


def each_once(ends: FloatArray, rows: IntArray, limits: FloatArray) -> IntArray:
    """Those of (n,) rows of bridges whose (B, 2, 3) ends are not those of an earlier one."""
    middles = ends.mean(axis=1)
    tree = cKDTree(middles[rows])
    free: BoolArray = np.ones(len(rows), bool)
    for i, row in enumerate(rows.tolist()):
        near = np.array(tree.query_ball_point(middles[row], limits[row]))
        later = near[near > i] if free[i] else near[:0]
        others = ends[rows[later]]
        off = np.stack([others - ends[row], others[:, ::-1] - ends[row]])
        same = (np.linalg.norm(off, axis=3).max(axis=2) <= limits[row]).any(axis=0)
        free[later[same]] = False
    return rows[free]
