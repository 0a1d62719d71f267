"""Polyline similarity graph and its communities (paper: Edge Matching and PEC generation)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, owners_of
from colmap_edges.core.view import views_with_rows
from colmap_edges.edges3d.paper.places import IndexedViews
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import MatchingOptions


@dataclass(frozen=True, kw_only=True)
class SimilarityGraph:
    """Undirected weighted graph of polylines; each link is stored once, with first < second.

    Attributes:
        num_polylines: number of nodes.
        links: (L, 2) int64 polylines over all views, of different views.
        similarities: (L,) float64 in (0, 1].
    """

    num_polylines: int
    links: IntArray
    similarities: FloatArray


def match_polylines(
    model: Model, chains: IndexedViews, options: MatchingOptions, random_seed: int, num_threads: int
) -> Int32Array:
    """Find the PEC of each polyline of all views.

    Returns:
        (P,) int32 PEC of each polyline, from 0; -1 for polylines not matched with another view.
    """
    incidence, weights = close_points(model, chains, options.max_point_distance_px, num_threads)
    polyline_views = owners_of(chains.polyline_offsets)
    graph = similarity_graph(incidence, weights, polyline_views, options.min_similarity)
    return find_pecs(graph, options.resolution, random_seed)


def close_points(
    model: Model, chains: IndexedViews, max_distance_px: float, num_threads: int
) -> tuple[csr_array, FloatArray]:
    """Incidence of visible SfM points and close polylines, and weights of the points.

    Returns:
        (P, N) sparse matrix, 1 if SfM point n is visible in the view of polyline p and projects
        within the distance of p; (N,) weights, the inverse of the mean number of polylines close to
        the projections of a point (0 for points close to none).
    """
    num_points = len(model.points3D_xyz)
    point_ids = model.track_points
    pixels = project_tracks(model, point_ids)
    near = chains.find_near(
        model.track_views, pixels, np.full(len(pixels), max_distance_px), num_threads
    )
    columns = point_ids[near.queries]
    ones = np.ones(len(columns))
    num_polylines = int(chains.polyline_offsets[-1])
    incidence = csr_array((ones, (near.polylines, columns)), (num_polylines, num_points))
    incidence.data[:] = 1  # a view with two observations of a point counts once
    close_counts = np.bincount(columns, minlength=num_points)
    visible_counts = np.diff(model.track_offsets)
    weights = np.zeros(num_points)
    np.divide(visible_counts, close_counts, out=weights, where=close_counts > 0)
    return incidence, weights


def project_tracks(model: Model, point_ids: IntArray) -> FloatArray:
    """(T, 2) projections of points into the views of their tracks, undistorted pixels."""
    pixels = np.full((len(point_ids), 2), np.nan)
    for view, rows in views_with_rows(model.views, model.track_views):
        pixels[rows] = view.project_undistorted(model.points3D_xyz[point_ids[rows]])[0]
    return pixels


def similarity_graph(
    incidence: csr_array,
    weights: FloatArray,
    polyline_views: IntArray,
    min_similarity: float,
) -> SimilarityGraph:
    """Similarities of all pairs of polylines of different images (paper: equation 1).

    The similarity is the weight of the shared close points divided by the weight of all close
    points of either polyline. The numerators of all pairs are one sparse product A diag(w) A'.

    Args:
        incidence: (P, N) 1 where a point is close to a polyline.
        weights: (N,) weights of the points.
        polyline_views: (P,) view of each polyline.
        min_similarity: minimum similarity of linked pairs.
    """
    weighted = incidence * weights[None, :]
    shared = (csr_array(weighted) @ incidence.T).tocoo()
    totals = np.asarray(weighted.sum(axis=1)).ravel()
    first, second = shared.coords
    keep = (first < second) & (polyline_views[first] != polyline_views[second])
    keep &= shared.data > 0
    first, second, common = first[keep], second[keep], shared.data[keep]
    similarities = np.minimum(common / (totals[first] + totals[second] - common), 1.0)
    linked = similarities >= min_similarity
    links = np.column_stack([first, second])[linked].astype(np.int64)
    order = np.lexsort((links[:, 1], links[:, 0]))
    return SimilarityGraph(
        num_polylines=incidence.shape[0],
        links=links[order],
        similarities=similarities[linked][order],
    )


def find_pecs(graph: SimilarityGraph, resolution: float, random_seed: int) -> Int32Array:
    """(P,) int32 Louvain community (Blondel et al. 2008) of each polyline, -1 for unlinked ones."""
    communities = _kernels.louvain_communities(
        graph.num_polylines,
        np.ascontiguousarray(graph.links[:, 0], np.int32),
        np.ascontiguousarray(graph.links[:, 1], np.int32),
        graph.similarities,
        resolution,
        random_seed,
    )
    matched = np.bincount(communities, minlength=1) > 1
    numbers = np.where(matched, np.cumsum(matched) - 1, -1).astype(np.int32)
    labels: Int32Array = numbers[communities]
    return labels
