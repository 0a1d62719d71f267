"""Dense sampling of 3D edges to edge points with tracks (paper: sampling)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, ranks_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges3d.paper.observations import (
    ObservedPoints,
    edge_neighbours,
    merge,
    observations_at,
    observations_of,
    track_offsets,
    triangulate_observations,
    with_observations,
)
from colmap_edges.edges3d.paper.places import IndexedViews, join_places
from colmap_edges.options import SamplingOptions


def sample_edges(
    edges: Edges3D,
    chains: IndexedViews,
    options: SamplingOptions,
    max_error_px: float,
    num_threads: int = 1,
) -> Edges3D:
    """Sample 3D edges densely to edge points, each with its own track.

    Samples are placed evenly between two consecutive edge points. They are observed by the views
    that observe both points, at the nearest position on the polyline of both, and triangulated
    from these observations, so that they follow the curve and not the chord. Samples with fewer
    than three views or too large an error are dropped; the given edge points are kept.
    """
    segment_starts, segment_ends, counts = subdivisions(edges, chains, options.spacing_px)
    samples = np.repeat(np.arange(len(counts)), counts)
    rank = ranks_of(counts) + 1
    share = (rank / (counts[samples] + 1))[:, None]
    start, end = edges.points[segment_starts[samples]], edges.points[segment_ends[samples]]
    chords = start + share * (end - start)
    observed = observe_samples(
        edges, segment_starts, segment_ends, samples, chords, chains, max_error_px, num_threads
    )
    points, errors = triangulate_observations(observed, len(samples), chains, num_threads)
    views = np.bincount(observed.points, minlength=len(samples))
    good = (errors <= max_error_px) & (views >= 3)
    positions = segment_starts[samples] + share[:, 0]
    observed = observed.select(good[observed.points])
    return insert_points(edges, chains, positions, points, observed, good)


def subdivisions(
    edges: Edges3D, chains: IndexedViews, spacing_px: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Start and end points (S,) of the segments of the 3D edges, numbers of samples inside (S,)."""
    _, after = edge_neighbours(edges)
    starts = np.flatnonzero(after >= 0)
    ends = after[starts]
    sharpness = np.zeros(edges.num_points)  # pixels per world unit in the view where it is largest
    for index, of_view in edges.observations.by_view():
        view, rows = chains.views[index], edges.observations.points[of_view]
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
    chains: IndexedViews,
    max_distance_px: float,
    num_threads: int,
) -> ObservedPoints:
    """Nearest positions to samples ((N,) segments, (N, 3) points) on the polylines of both ends."""
    points, places = [np.zeros(0, np.int64)], []
    for index, of_view in edges.observations.by_view():
        polylines = np.full(edges.num_points, -1, np.int64)
        polylines[edges.observations.points[of_view]] = edges.observations.chains[of_view]
        shared = np.where(polylines[starts] == polylines[ends], polylines[starts], -1)[samples]
        rows = np.flatnonzero(shared >= 0)
        near = chains.find_near(
            np.full(len(rows), index, np.int32),
            chains.views[index].project_undistorted(chords[rows])[0],
            np.full(len(rows), max_distance_px),
            num_threads,
        )
        wanted = chains.polyline_offsets[index] + shared[rows][near.queries]
        chosen = np.flatnonzero(near.polylines == wanted)
        points.append(rows[near.queries[chosen]])
        places.append(near.places.select(chosen))
    found, joined = np.concatenate(points), join_places(places)
    order = np.lexsort((joined.views, found))
    return observations_at(found[order], joined.select(order), chains)


def insert_points(
    edges: Edges3D,
    chains: IndexedViews,
    positions: FloatArray,
    points: FloatArray,
    observed: ObservedPoints,
    good: BoolArray,
) -> Edges3D:
    """Insert the accepted samples at fractional indices of the points of the edges.

    `observed` contains the observations of accepted samples only.
    """
    given = observations_of(edges, chains)
    kept = np.flatnonzero(good)
    renumbered = np.cumsum(good) - 1 + edges.num_points
    order = np.argsort(
        np.concatenate([np.arange(edges.num_points), positions[kept]]), kind="stable"
    )
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    merged = merge(
        replace(given, points=place[given.points]),
        replace(observed, points=place[renumbered[observed.points]]),
    )
    edge_ids = edges.edge_ids
    all_edges = np.concatenate([edge_ids, edge_ids[np.floor(positions[kept]).astype(np.int64)]])
    enlarged = replace(
        edges,
        edge_offsets=track_offsets(all_edges, edges.num_edges),
        sigmas=np.concatenate([edges.sigmas, np.full(len(kept), np.nan)])[order],
    )
    return with_observations(enlarged, np.concatenate([edges.points, points[kept]])[order], merged)
