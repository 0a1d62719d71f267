"""Find further views of 3D edges, drop outliers, sample finely (paper: Visibility refinement)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.array_types import BoolArray, FloatArray, Int32Array, IntArray
from colmap_edges.csr import entries_of, offsets_of, owners_of, ranks_of
from colmap_edges.edge_field import ChainPositions, EdgeField, pose_arrays
from colmap_edges.edges import Edges3D, mean_colors
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.model import views_with_rows
from colmap_edges.options import SamplingOptions, VisibilityOptions


@dataclass(frozen=True, kw_only=True)
class Observations:
    """Observations of 3D points, sorted by point and then view.

    Attributes:
        points: (T,) int64 index of the 3D point.
        views: (T,) int32.
        pixels: (T, 2) float64 image pixels, COLMAP's origin.
        ideal: (T, 2) float64 the same in ideal pixels.
        colors: (T, 3) float64 RGB.
    """

    points: IntArray
    views: Int32Array
    pixels: FloatArray
    ideal: FloatArray
    colors: FloatArray

    def select(self, index: BoolArray | IntArray) -> Observations:
        """The observations at a numpy index."""
        return Observations(
            points=self.points[index],
            views=self.views[index],
            pixels=self.pixels[index],
            ideal=self.ideal[index],
            colors=self.colors[index],
        )


def observations_of(edges: Edges3D, field: EdgeField) -> Observations:
    """The tracks of all edge points as one list."""
    points = edges.track_points
    ideal = np.empty((len(points), 2))
    for view, rows in views_with_rows(field.views, edges.track_views):
        if len(rows):
            ideal[rows] = view.ideal_from_image(edges.track_points2D[rows])
    return Observations(
        points=points,
        views=edges.track_views,
        pixels=edges.track_points2D,
        ideal=ideal,
        colors=edges.colors[points].astype(np.float64),
    )


def merge(*parts: Observations) -> Observations:
    """All lists in one, sorted by point and view."""
    points = np.concatenate([part.points for part in parts])
    views = np.concatenate([part.views for part in parts])
    order = np.lexsort((views, points))
    return Observations(
        points=points[order],
        views=views[order],
        pixels=np.concatenate([part.pixels for part in parts])[order],
        ideal=np.concatenate([part.ideal for part in parts])[order],
        colors=np.concatenate([part.colors for part in parts])[order],
    )


def track_offsets(points: IntArray, num_points: int) -> IntArray:
    """(num_points + 1,) CSR offsets of ascending point indices."""
    return offsets_of(np.bincount(points, minlength=num_points))


def triangulate_observations(
    observed: Observations, num_points: int, field: EdgeField, num_threads: int
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) least-squares points and (N,) largest errors in pixels; NaN and inf where none."""
    points, errors = _kernels.triangulate_tracks(
        *pose_arrays(field.views),
        track_offsets(observed.points, num_points),
        np.ascontiguousarray(observed.views, np.int32),
        np.ascontiguousarray(observed.ideal),
        num_threads,
    )
    return points, errors


def edge_neighbours(edges: Edges3D) -> tuple[IntArray, IntArray]:
    """(N,) index of the point before and after each point on its 3D edge, -1 where none."""
    index = np.arange(edges.num_points, dtype=np.int64)
    before, after = index - 1, index + 1
    filled = np.diff(edges.edge_offsets) > 0
    first, last = edges.edge_offsets[:-1][filled], edges.edge_offsets[1:][filled] - 1
    loops = edges.closed[filled] & (last - first > 1)
    before[first] = np.where(loops, last, -1)
    after[last] = np.where(loops, first, -1)
    return before, after


def expand_visibility(
    edges: Edges3D, field: EdgeField, options: VisibilityOptions, num_threads: int = 1
) -> tuple[Edges3D, dict[str, int]]:
    """Add observations of edge points in views where they were not found so far.

    A point gains the nearest place of a polyline when that is the only polyline within d_v of its
    projection, runs along the projected edge, is also the one its neighbours on the 3D edge come
    to lie on, and all observations together still triangulate within the error. Points are
    triangulated anew from all their observations.

    Returns:
        The edges with longer tracks, and counts of candidates and of those added.
    """
    observed = observations_of(edges, field)
    candidates = further_observations(edges, field, observed, options, num_threads)
    accepted = compatible(observed, candidates, field, options.max_error_px, num_threads)
    merged, points = merge_consistent(
        edges, observed, candidates.select(accepted), field, options.max_error_px, num_threads
    )
    stats = {
        "observations_before": len(observed.points),
        "candidates": len(candidates.points),
        "observations_after": len(merged.points),
    }
    return with_observations(edges, points, merged), stats


def with_observations(edges: Edges3D, points: FloatArray, observed: Observations) -> Edges3D:
    """The same edges with new points and tracks."""
    offsets = track_offsets(observed.points, len(points))
    return replace(
        edges,
        points=points,
        track_offsets=offsets,
        track_views=observed.views.astype(np.int32),
        track_points2D=observed.pixels,
        colors=mean_colors(observed.colors, offsets),
    )


def further_observations(
    edges: Edges3D,
    field: EdgeField,
    observed: Observations,
    options: VisibilityOptions,
    num_threads: int,
) -> Observations:
    """Places on single near polylines that agree in direction and with the neighbours."""
    tangents = edge_tangents(edges)
    neighbours = edge_neighbours(edges)
    found = []
    for index in range(len(field.views)):
        seen = np.zeros(edges.num_points, bool)
        seen[observed.points[observed.views == index]] = True
        if seen.all():
            continue
        points, positions = near_in_view(
            edges.points, tangents, neighbours, index, field, options, num_threads
        )
        fresh = ~seen[points]
        found.append((points[fresh], index, positions.select(fresh)))
    positions = ChainPositions(
        segments=np.concatenate([np.zeros(0, np.int64), *(f[2].segments for f in found)]),
        fractions=np.concatenate([np.zeros(0), *(f[2].fractions for f in found)]),
    )
    return Observations(
        points=np.concatenate([np.zeros(0, np.int64), *(f[0] for f in found)]),
        views=np.repeat(np.array([f[1] for f in found], np.int32), [len(f[0]) for f in found]),
        pixels=field.image_points(positions),
        ideal=field.ideal_points(positions),
        colors=field.colors_at(positions),
    )


def edge_tangents(edges: Edges3D) -> FloatArray:
    """(N, 3) direction of the 3D edge at each point, between its neighbours; not normalised."""
    before, after = edge_neighbours(edges)
    index = np.arange(edges.num_points)
    start, end = np.where(before >= 0, before, index), np.where(after >= 0, after, index)
    tangents: FloatArray = edges.points[end] - edges.points[start]
    return tangents


def near_in_view(
    points: FloatArray,
    tangents: FloatArray,
    neighbours: tuple[IntArray, IntArray],
    view_index: int,
    field: EdgeField,
    options: VisibilityOptions,
    num_threads: int,
) -> tuple[IntArray, ChainPositions]:
    """Of one view: points with a fitting place on a chain, ascending, and the places."""
    view = field.views[view_index]
    pixels, _ = view.project_ideal(points)
    near = field.find_near(
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
    single, places = single[keep], near.positions.select(rows[keep])
    directions = projected_directions(points[single], tangents[single], view)
    cosines = np.abs(np.einsum("ij,ij->i", directions, field.tangents(places)))
    along = cosines >= np.cos(np.radians(options.max_tangent_angle_deg))
    return single[along], places.select(along)


def projected_directions(points: FloatArray, tangents: FloatArray, view: object) -> FloatArray:
    """(N, 2) unit image directions of 3D directions at 3D points; 0 where seen end on."""
    local = view.cam_from_world(points)  # type: ignore[attr-defined]
    turned = tangents @ view.rotation.T  # type: ignore[attr-defined]
    directions = turned[:, :2] * local[:, 2:] - local[:, :2] * turned[:, 2:]
    norms = np.linalg.norm(directions, axis=1, keepdims=True)
    result: FloatArray = directions / np.where(norms > 0, norms, 1)
    return result


def compatible(
    observed: Observations,
    candidates: Observations,
    field: EdgeField,
    max_error_px: float,
    num_threads: int,
) -> BoolArray:
    """(C,) whether each candidate, alone with its point's track, triangulates well enough."""
    num_points = int(observed.points.max(initial=-1)) + 1
    offsets = track_offsets(observed.points, num_points)
    counts = np.diff(offsets)[candidates.points]
    tracks = observed.select(entries_of(offsets, candidates.points))
    trials = np.arange(len(candidates.points))
    trial_tracks = merge(
        replace(tracks, points=np.repeat(trials, counts)), replace(candidates, points=trials)
    )
    errors = triangulate_observations(trial_tracks, len(trials), field, num_threads)[1]
    fits: BoolArray = errors <= max_error_px
    return fits


def merge_consistent(
    edges: Edges3D,
    observed: Observations,
    added: Observations,
    field: EdgeField,
    max_error_px: float,
    num_threads: int,
) -> tuple[Observations, FloatArray]:
    """Tracks with the added observations, the worst left out until all fit together.

    Returns:
        The tracks and the (N, 3) points triangulated from them; a point that gains nothing stays.
    """
    points = edges.points.copy()
    accepted = [observed]
    while len(added.points):
        active = np.zeros(edges.num_points, bool)
        active[added.points] = True
        tracks = merge(observed.select(active[observed.points]), added)
        moved, errors = triangulate_observations(tracks, edges.num_points, field, num_threads)
        failing = active & (errors > max_error_px)
        done = active & ~failing
        points[done] = moved[done]
        accepted.append(added.select(done[added.points]))
        estimates = np.where(np.isfinite(moved), moved, edges.points)
        added = drop_worst(added.select(failing[added.points]), estimates, field)
    return merge(*accepted), points


def drop_worst(added: Observations, points: FloatArray, field: EdgeField) -> Observations:
    """Without, of each point ((N, 3) world), the observation farthest from its projection."""
    errors = reprojection_errors(added, points, field)
    order = np.lexsort((np.where(np.isfinite(errors), errors, np.inf), added.points))
    last = np.append(added.points[order][1:] != added.points[order][:-1], True)[: len(order)]
    keep = np.ones(len(added.points), bool)
    keep[order[last]] = False
    return added.select(keep)


def reprojection_errors(observed: Observations, points: FloatArray, field: EdgeField) -> FloatArray:
    """(T,) distance in pixels between each observation and its projected point; NaN behind."""
    errors = np.full(len(observed.points), np.nan)
    for index, view in enumerate(field.views):
        rows = np.flatnonzero(observed.views == index)
        projected, _ = view.project_ideal(points[observed.points[rows]])
        errors[rows] = np.linalg.norm(projected - observed.ideal[rows], axis=1)
    return errors


def min_inlier_views(view_counts: IntArray, min_views: int) -> float:
    """k_v = max(min_views, median / 2 + 1) of the numbers of views of all edge points."""
    if len(view_counts) == 0:
        return float(min_views)
    return max(float(min_views), float(np.median(view_counts)) / 2 + 1)


def filter_outliers(edges: Edges3D, options: VisibilityOptions) -> tuple[Edges3D, dict[str, float]]:
    """Drop what too few views see: stretches of 3D edges whose points have fewer than k_v.

    An edge is cut where points fall out; single points left over are dropped too.
    """
    views = np.diff(edges.track_offsets)
    threshold = min_inlier_views(views, options.min_views)
    kept = keep_points(edges, views >= threshold)
    return kept, {
        "min_views": threshold,
        "points_before": edges.num_points,
        "points_after": kept.num_points,
        "edges_before": edges.num_edges,
        "edges_after": kept.num_edges,
    }


def keep_points(edges: Edges3D, keep: BoolArray) -> Edges3D:
    """Edges with only the kept points ((N,) bool), cut where some are missing; no lone points.

    A closed edge that loses a point is opened there.
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


def sample_edges(
    edges: Edges3D,
    field: EdgeField,
    options: SamplingOptions,
    max_error_px: float,
    num_threads: int = 1,
) -> Edges3D:
    """Sample 3D edges finely to edge points, each with its own track.

    Between two edge points samples are spread evenly; the views that see both see the samples. A
    sample is observed at the nearest place of the view's polylines, and triangulated from that,
    so it follows the curve and not the chord. Samples left with fewer than three views or a
    larger error are left out; the edge points given stay.
    """
    segment_starts, segment_ends, counts = subdivisions(edges, field, options.spacing_px)
    samples = np.repeat(np.arange(len(counts)), counts)
    rank = ranks_of(counts) + 1
    share = (rank / (counts[samples] + 1))[:, None]
    start, end = edges.points[segment_starts[samples]], edges.points[segment_ends[samples]]
    chords = start + share * (end - start)
    observed = observe_samples(
        edges, segment_starts, segment_ends, samples, chords, field, max_error_px, num_threads
    )
    points, errors = triangulate_observations(observed, len(samples), field, num_threads)
    views = np.bincount(observed.points, minlength=len(samples))
    good = (errors <= max_error_px) & (views >= 3)
    positions = segment_starts[samples] + share[:, 0]
    return insert_points(edges, field, positions, points, observed, good)


def subdivisions(
    edges: Edges3D, field: EdgeField, spacing_px: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Segments of the 3D edges as start and end points (S,), and samples to put inside (S,)."""
    _, after = edge_neighbours(edges)
    starts = np.flatnonzero(after >= 0)
    ends = after[starts]
    sharpness = np.zeros(edges.num_points)  # pixels per world unit in the sharpest view
    track_points = edges.track_points
    for view, of_view in views_with_rows(field.views, edges.track_views):
        rows = track_points[of_view]
        depths = view.cam_from_world(edges.points[rows])[:, 2]
        np.maximum.at(sharpness, rows, view.focal_px / np.where(depths > 0, depths, np.inf))
    lengths = np.linalg.norm(edges.points[ends] - edges.points[starts], axis=1)
    pieces = np.ceil(lengths * sharpness[starts] / spacing_px)
    return starts, ends, np.maximum(pieces - 1, 0).astype(np.int64)


def observe_samples(
    edges: Edges3D,
    starts: IntArray,
    ends: IntArray,
    samples: IntArray,
    chords: FloatArray,
    field: EdgeField,
    max_distance_px: float,
    num_threads: int,
) -> Observations:
    """Nearest places to samples ((N,) segments, (N, 3) points) in the views of both their ends."""
    num_views = len(field.views)
    track_points = edges.track_points
    seen = np.zeros((edges.num_points, num_views), bool)
    seen[track_points, edges.track_views] = True
    both = seen[starts] & seen[ends]
    found_points, found_views, segments, fractions = [], [], [], []
    for index, view in enumerate(field.views):
        rows = np.flatnonzero(both[samples, index])
        near = field.find_near(
            np.full(len(rows), index, np.int32),
            view.project_ideal(chords[rows])[0],
            np.full(len(rows), max_distance_px),
            num_threads,
        )
        nearest = nearest_rows(near.offsets, near.distances)
        found_points.append(rows[np.diff(near.offsets) > 0])
        found_views.append(np.full(len(nearest), index, np.int32))
        segments.append(near.positions.segments[nearest])
        fractions.append(near.positions.fractions[nearest])
    points, views = np.concatenate(found_points), np.concatenate(found_views)
    order = np.lexsort((views, points))
    places = ChainPositions(
        segments=np.concatenate(segments)[order], fractions=np.concatenate(fractions)[order]
    )
    return Observations(
        points=points[order],
        views=views[order],
        pixels=field.image_points(places),
        ideal=field.ideal_points(places),
        colors=field.colors_at(places),
    )


def nearest_rows(offsets: IntArray, distances: FloatArray) -> IntArray:
    """Row of the smallest distance of each query that has any; the first among equals."""
    queries = owners_of(offsets)
    order = np.lexsort((distances, queries))
    first: IntArray = order[offsets[:-1][np.diff(offsets) > 0]]
    return first


def insert_points(
    edges: Edges3D,
    field: EdgeField,
    positions: FloatArray,
    points: FloatArray,
    observed: Observations,
    good: BoolArray,
) -> Edges3D:
    """Edges with the good samples put in at positions (index of the point before + share)."""
    given = observations_of(edges, field)
    kept = np.flatnonzero(good)
    renumbered = np.cumsum(good) - 1 + edges.num_points
    fresh = observed.select(good[observed.points])
    order = np.argsort(
        np.concatenate([np.arange(edges.num_points), positions[kept]]), kind="stable"
    )
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    merged = merge(
        replace(given, points=place[given.points]),
        replace(fresh, points=place[renumbered[fresh.points]]),
    )
    edge_ids = edges.edge_ids
    all_edges = np.concatenate([edge_ids, edge_ids[np.floor(positions[kept]).astype(np.int64)]])
    enlarged = replace(
        edges,
        edge_offsets=track_offsets(all_edges, edges.num_edges),
        sigmas=np.concatenate([edges.sigmas, np.full(len(kept), np.nan)])[order],
    )
    return with_observations(enlarged, np.concatenate([edges.points, points[kept]])[order], merged)
