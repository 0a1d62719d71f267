"""Search for further views of 3D edges, outlier filter, sampling (paper: Visibility refinement)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    entries_of,
    medians_of,
    offsets_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import rows_by_view
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges3d.paper.observations import (
    ObservedPoints,
    edge_neighbours,
    merge,
    observations_at,
    observations_of,
    reprojection_errors,
    track_offsets,
    triangulate_observations,
    with_observations,
)
from colmap_edges.edges3d.paper.places import IndexedViews, Places, join_places
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import VisibilityOptions

MIN_POINT_VIEWS = 3  # minimum number of views of an edge point (paper: PEPC-selection)


def expand_visibility(
    edges: Edges3D, chains: IndexedViews, options: VisibilityOptions, num_threads: int = 1
) -> tuple[Edges3D, dict[str, int]]:
    """Add observations of edge points in further views.

    A point is observed at the nearest position on a polyline if this is the only polyline within
    d_v of its projection, is parallel to the projected edge with its bright side on the same side
    as in the point's other views, and also observes the neighbouring points of the 3D edge. All
    observations together must triangulate within the error; they give the new position.

    Returns:
        The edges with longer tracks, and counts of candidates and added observations.
    """
    observed = observations_of(edges, chains)
    candidates = further_observations(edges, chains, observed, options, num_threads)
    accepted = compatible(observed, candidates, chains, options.max_error_px, num_threads)
    merged, points = merge_consistent(
        edges, observed, candidates.select(accepted), chains, options.max_error_px, num_threads
    )
    stats = {
        "observations_before": len(observed.points),
        "candidates": len(candidates.points),
        "observations_after": len(merged.points),
    }
    return with_observations(edges, points, merged), stats


def further_observations(
    edges: Edges3D,
    chains: IndexedViews,
    observed: ObservedPoints,
    options: VisibilityOptions,
    num_threads: int,
) -> ObservedPoints:
    """Observations on an only near polyline that agree in direction and with the neighbours."""
    tangents = edge_tangents(edges)
    neighbours = edge_neighbours(edges)
    sides = sides_of_points(edges, tangents, observed, chains)
    found, places = [np.zeros(0, np.int64)], []
    for index in range(len(chains.views)):
        seen = np.zeros(edges.num_points, bool)
        seen[observed.points[observed.views == index]] = True
        if seen.all():
            continue
        points, of_points = near_in_view(
            edges.points, tangents, neighbours, index, chains, options, num_threads
        )
        along = projected_directions(edges.points[points], tangents[points], chains.views[index])
        fresh = ~seen[points]
        fresh &= bright_sides(along, of_points.positions, chains.graph(index)) == sides[points]
        found.append(points[fresh])
        places.append(of_points.select(fresh))
    return observations_at(np.concatenate(found), join_places(places), chains)


def edge_tangents(edges: Edges3D) -> FloatArray:
    """(N, 3) direction of the 3D edge at each point, by its neighbours; not normalised."""
    before, after = edge_neighbours(edges)
    index = np.arange(edges.num_points)
    start, end = np.where(before >= 0, before, index), np.where(after >= 0, after, index)
    tangents: FloatArray = edges.points[end] - edges.points[start]
    return tangents


def bright_sides(directions: FloatArray, positions: FloatArray, graph: EdgeGraph) -> IntArray:
    """(N,) +1 if the chain at (N,) positions is brighter to the left of (N, 2) directions, else -1.

    Left is the direction rotated by 90 degrees from x towards y.
    """
    normals = graph.normals[positions.astype(np.int64)]
    turns = directions[:, 0] * normals[:, 1] - directions[:, 1] * normals[:, 0]
    return np.where(turns >= 0, 1, -1)


def sides_of_points(
    edges: Edges3D, tangents: FloatArray, observed: ObservedPoints, chains: IndexedViews
) -> IntArray:
    """(N,) bright side of the 3D edge at each point in most of its views, 0 for a tie."""
    votes = np.zeros(edges.num_points, np.int64)
    for index, rows in enumerate(rows_by_view(observed.views, len(chains.views))):
        points = observed.points[rows]
        along = projected_directions(edges.points[points], tangents[points], chains.views[index])
        np.add.at(votes, points, bright_sides(along, observed.positions[rows], chains.graph(index)))
    sides: IntArray = np.sign(votes)
    return sides


def near_in_view(
    points: FloatArray,
    tangents: FloatArray,
    neighbours: tuple[IntArray, IntArray],
    view_index: int,
    chains: IndexedViews,
    options: VisibilityOptions,
    num_threads: int,
) -> tuple[IntArray, Places]:
    """Points with a candidate observation in one view, ascending, and its positions."""
    view = chains.views[view_index]
    pixels, _ = view.project_undistorted(points)
    near = chains.find_near(
        np.full(len(points), view_index, np.int32),
        pixels,
        np.full(len(points), options.max_distance_px),
        num_threads,
    )
    single = np.flatnonzero(np.diff(near.offsets) == 1)
    rows = near.offsets[single]
    polylines = np.full(len(points) + 1, -1, np.int64)  # the last stands for "no neighbour"
    polylines[single] = near.polylines[rows]
    agrees = [
        (neighbour[single] < 0) | (polylines[neighbour[single]] == polylines[single])
        for neighbour in neighbours
    ]
    alone = (neighbours[0][single] < 0) & (neighbours[1][single] < 0)
    keep = agrees[0] & agrees[1] & ~alone
    single, places = single[keep], near.places.select(rows[keep])
    directions = projected_directions(points[single], tangents[single], view)
    along = _kernels.chain_points(chains.indexes[view_index], places.positions)[1]
    cosines = np.abs(np.einsum("ij,ij->i", directions, along))
    fits = cosines >= np.cos(np.radians(options.max_tangent_angle_deg))
    return single[fits], places.select(fits)


def projected_directions(points: FloatArray, tangents: FloatArray, view: object) -> FloatArray:
    """(N, 2) unit image directions of 3D directions at 3D points; 0 along the viewing ray."""
    local = view.cam_from_world(points)  # type: ignore[attr-defined]
    turned = tangents @ view.rotation.T  # type: ignore[attr-defined]
    directions = turned[:, :2] * local[:, 2:] - local[:, :2] * turned[:, 2:]
    norms = np.linalg.norm(directions, axis=1, keepdims=True)
    result: FloatArray = directions / np.where(norms > 0, norms, 1)
    return result


def compatible(
    observed: ObservedPoints,
    candidates: ObservedPoints,
    chains: IndexedViews,
    max_error_px: float,
    num_threads: int,
) -> BoolArray:
    """(C,) whether each candidate alone triangulates with its point's track within the error."""
    num_points = int(observed.points.max(initial=-1)) + 1
    offsets = track_offsets(observed.points, num_points)
    counts = np.diff(offsets)[candidates.points]
    tracks = observed.select(entries_of(offsets, candidates.points))
    trials = np.arange(len(candidates.points))
    trial_tracks = merge(
        replace(tracks, points=np.repeat(trials, counts)), replace(candidates, points=trials)
    )
    errors = triangulate_observations(trial_tracks, len(trials), chains, num_threads)[1]
    fits: BoolArray = errors <= max_error_px
    return fits


def merge_consistent(
    edges: Edges3D,
    observed: ObservedPoints,
    added: ObservedPoints,
    chains: IndexedViews,
    max_error_px: float,
    num_threads: int,
) -> tuple[ObservedPoints, FloatArray]:
    """Add observations to tracks, dropping the worst until all triangulate within the error.

    Returns:
        The tracks and the (N, 3) points triangulated from them; unchanged without new observations.
    """
    points = edges.points.copy()
    accepted = [observed]
    while len(added.points):
        active = np.zeros(edges.num_points, bool)
        active[added.points] = True
        tracks = merge(observed.select(active[observed.points]), added)
        moved, errors = triangulate_observations(tracks, edges.num_points, chains, num_threads)
        failing = active & (errors > max_error_px)
        done = active & ~failing
        points[done] = moved[done]
        accepted.append(added.select(done[added.points]))
        estimates = np.where(np.isfinite(moved), moved, edges.points)
        added = drop_worst(added.select(failing[added.points]), estimates, chains)
    return merge(*accepted), points


def drop_worst(added: ObservedPoints, points: FloatArray, chains: IndexedViews) -> ObservedPoints:
    """Drop, for each of (N, 3) points, the observation farthest from its projection."""
    errors = reprojection_errors(added, points, chains)
    order = np.lexsort((np.where(np.isfinite(errors), errors, np.inf), added.points))
    last = np.append(added.points[order][1:] != added.points[order][:-1], True)[: len(order)]
    keep = np.ones(len(added.points), bool)
    keep[order[last]] = False
    return added.select(keep)


def min_inlier_views(view_counts: IntArray, min_views: int) -> float:
    """k_v = max(min_views, median / 2 + 1) of the numbers of views of all edge points."""
    if len(view_counts) == 0:
        return float(min_views)
    return max(float(min_views), float(np.median(view_counts)) / 2 + 1)


def filter_outliers(edges: Edges3D, options: VisibilityOptions) -> tuple[Edges3D, dict[str, float]]:
    """Drop 3D edges whose points have fewer than k_v views in the median.

    Points with fewer than three views are also dropped, and edges are cut there.
    """
    views = edges.observations.counts
    threshold = min_inlier_views(views, options.min_views)
    seen = medians_of(views, edges.edge_ids, edges.num_edges) >= threshold
    kept = keep_points(edges, seen[edges.edge_ids] & (views >= MIN_POINT_VIEWS))
    return kept, {
        "min_views": threshold,
        "points_before": edges.num_points,
        "points_after": kept.num_points,
        "edges_before": edges.num_edges,
        "edges_after": kept.num_edges,
    }


def rms_of_groups(errors: FloatArray, groups: IntArray, num_groups: int) -> FloatArray:
    """(num_groups,) root mean square of (T,) errors per group; 0 for empty groups."""
    counts = np.bincount(groups, minlength=num_groups)
    sums = np.bincount(groups, weights=errors**2, minlength=num_groups)
    rms: FloatArray = np.sqrt(sums / np.maximum(counts, 1))
    return rms


def errors_across(edges: Edges3D, chains: IndexedViews) -> FloatArray:
    """(T,) distances of points from their observations across the chains, in pixels; NaN behind.

    Distances along a chain are not errors, since a point can slide along its edge.
    """
    observed = edges.observations
    errors = np.full(len(observed.views), np.nan)
    for index, rows in observed.by_view():
        view, points = chains.views[index], edges.points[observed.points[rows]]
        offsets = view.project_undistorted(points)[0] - view.undistorted_from_image(
            observed.pixels[rows]
        )
        errors[rows] = np.einsum("ij,ij->i", offsets, observed.normals[rows])
    return errors


def drop_doubtful_views(
    edges: Edges3D, chains: IndexedViews, options: VisibilityOptions, num_threads: int = 1
) -> tuple[Edges3D, dict[str, int]]:
    """Remove views from 3D edges that observe them by accident, for example where occluded.

    Accidental chains are near the projection of an edge for a short stretch only. A view is kept if
    it observes at least three points and a third of the points of an edge, with a root mean square
    error of at most `max_rms_ratio` times the tolerance. Points are triangulated from the rest.
    """
    observed = edges.observations
    ids = edges.edge_ids[observed.points]
    pairs, inverse = np.unique(ids * len(chains.views) + observed.views, return_inverse=True)
    counts = np.bincount(inverse, minlength=len(pairs))
    lengths = np.diff(edges.edge_offsets)[pairs // len(chains.views)]
    rms = rms_of_groups(errors_across(edges, chains), inverse, len(pairs))
    sure = rms <= options.max_rms_ratio * options.max_error_px
    # A view that observes an edge observes a point and its neighbours.
    sure &= counts >= np.minimum(3, lengths)
    sure &= counts >= (1 / 3) * lengths  # set by trial
    kept = replace(edges, observations=observed.keep(sure[inverse]))
    anew, _ = triangulate_observations(
        observations_of(kept, chains), kept.num_points, chains, num_threads
    )
    known = (kept.observations.counts >= MIN_POINT_VIEWS) & np.isfinite(anew).all(axis=1)
    kept = replace(kept, points=np.where(known[:, None], anew, kept.points))
    return kept, {
        "views_of_edges": len(pairs),
        "views_of_edges_kept": int(np.count_nonzero(sure)),
        "observations_kept": len(kept.observations.views),
    }


def keep_points(edges: Edges3D, keep: BoolArray) -> Edges3D:
    """Keep points of edges ((N,) bool), cut edges where points are missing, drop single points.

    A closed edge that loses a point becomes open there.
    """
    edge_ids = edges.edge_ids
    order = np.arange(edges.num_points)
    whole = np.ones(edges.num_edges, bool)
    np.logical_and.at(whole, edge_ids, keep)
    for edge in np.flatnonzero(edges.closed & ~whole):
        begin, end = edges.edge_offsets[edge], edges.edge_offsets[edge + 1]
        order[begin:end] = np.roll(order[begin:end], -int(np.argmin(keep[begin:end])))
    kept = keep[order]
    starts = kept.copy()  # kept points whose predecessor is missing or of another edge
    starts[1:] &= ~kept[:-1] | (edge_ids[1:] != edge_ids[:-1])
    piece = np.cumsum(starts) - 1
    lengths = np.bincount(piece[kept], minlength=int(starts.sum()))
    long_enough = lengths > 1
    chosen = order[kept][long_enough[piece[kept]]]
    source = edge_ids[np.flatnonzero(starts)][long_enough]
    offsets = offsets_of(lengths[long_enough])
    end_nodes = edges.end_nodes[source].copy()
    end_nodes[chosen[offsets[:-1]] != edges.edge_offsets[source], 0] = -1
    end_nodes[chosen[offsets[1:] - 1] != edges.edge_offsets[source + 1] - 1, 1] = -1
    return edges.reordered(chosen, offsets, edges.closed[source] & whole[source], end_nodes)
