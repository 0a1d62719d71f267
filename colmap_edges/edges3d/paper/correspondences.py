"""Potential edge-point correspondences from epipolar intersections (paper: PEPC generation)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    ranks_of,
)
from colmap_edges.core.view import rows_by_view, views_with_rows
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.edge_index import next_points
from colmap_edges.edges3d.paper.matching import project_tracks
from colmap_edges.edges3d.paper.places import IndexedViews, Places, join_places
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import CorrespondenceOptions


@dataclass(frozen=True, kw_only=True)
class Pepcs:
    """Potential edge-point correspondences: starting points with candidates in other views.

    Attributes:
        starts: (S) positions on chains.
        candidate_offsets: (S + 1,) int64 CSR of candidates by start.
        candidates: (C) positions on chains of other views, grouped by view within a start.
    """

    starts: Places
    candidate_offsets: IntArray
    candidates: Places

    def __len__(self) -> int:
        """Number of PEPCs."""
        return len(self.starts)


@dataclass(frozen=True, kw_only=True)
class PepcSource:
    """PEPCs whose candidates are computed on demand, since most starts are then covered by edges.

    Attributes:
        starts: (S) positions on chains.
        find_candidates: maps (n,) indices of starts to their candidates: (n + 1,) offsets, (C,)
            views and (C,) positions.
    """

    starts: Places
    find_candidates: Callable[[IntArray], tuple[IntArray, Int32Array, FloatArray]]

    def __len__(self) -> int:
        """Number of PEPCs."""
        return len(self.starts)

    def pepcs(self, rows: IntArray) -> Pepcs:
        """The PEPCs with these (n,) indices."""
        offsets, views, positions = self.find_candidates(rows)
        candidates = Places(views=views, positions=positions)
        return Pepcs(
            starts=self.starts.select(rows), candidate_offsets=offsets, candidates=candidates
        )

    def shuffled(self, random_seed: int) -> PepcSource:
        """The PEPCs in random order, so that neighbours on an edge are not tried consecutively."""
        order = np.random.default_rng(random_seed).permutation(len(self))
        return PepcSource(
            starts=self.starts.select(order),
            find_candidates=lambda rows: self.find_candidates(order[rows]),
        )


def pepcs_from_sfm_points(
    model: Model, chains: IndexedViews, options: CorrespondenceOptions, num_threads: int
) -> PepcSource:
    """PEPCs near SfM points.

    Each SfM point is the centre of two spheres. In every view of the point, the nearest position on
    each polyline within the projected inner sphere is a start. Its candidates are the intersections
    of its epipolar lines with polylines within the projected outer sphere in the other views of
    the point. Radii are given in pixels of the view with the highest resolution at the point; a
    sphere of radius r projects to a circle of radius r * focal / depth.
    """
    point_ids = model.track_points
    sizes = pixel_sizes(model, point_ids)
    finest = np.full(len(model.points3D_xyz), np.inf)
    np.minimum.at(finest, point_ids, sizes)
    usable = np.isfinite(finest)
    finest[~usable] = 0
    with np.errstate(invalid="ignore"):
        circles = np.where(
            usable[point_ids], options.inner_radius_px * finest[point_ids] / sizes, 0
        )
    near = chains.find_near(
        model.track_views, project_tracks(model, point_ids), circles, num_threads
    )
    centers = np.ascontiguousarray(model.points3D_xyz)
    radii, spheres = options.outer_radius_px * finest, point_ids[near.queries]

    def find_candidates(rows: IntArray) -> tuple[IntArray, Int32Array, FloatArray]:
        offsets, views, positions = _kernels.candidates_in_spheres(
            chains.indexes,
            near.places.views[rows],
            near.places.positions[rows],
            spheres[rows],
            centers,
            radii,
            model.track_offsets,
            model.track_views,
            num_threads,
        )
        return offsets, views, positions

    return PepcSource(starts=near.places, find_candidates=find_candidates)


def pixel_sizes(model: Model, point_ids: IntArray) -> FloatArray:
    """(T,) size of a pixel at the depth of each tracked point, world units; inf behind a view."""
    sizes = np.full(len(point_ids), np.inf)
    for view, rows in views_with_rows(model.views, model.track_views):
        depths = view.cam_from_world(model.points3D_xyz[point_ids[rows]])[:, 2]
        sizes[rows] = np.where(depths > 0, depths / view.focal_px, np.inf)
    return sizes


def pepcs_from_pecs(
    model: Model,
    chains: IndexedViews,
    pecs: Int32Array,
    options: CorrespondenceOptions,
    num_threads: int,
) -> PepcSource:
    """PEPCs of matched polylines.

    Every polyline of a PEC is sampled at fixed intervals. The candidates of a sample are the
    intersections of its epipolar lines with the polylines of the same PEC in other views.

    Args:
        model: the model; its SfM points bound the depths.
        chains: edge graphs of all views.
        pecs: (P,) PEC of each polyline, -1 for none.
        options: the sampling interval.
        num_threads: threads to use; the result does not depend on it.
    """
    starts = sample_polylines(chains, pecs >= 0, options.sample_spacing_px)
    depths = depth_bounds(model)

    def find_candidates(rows: IntArray) -> tuple[IntArray, Int32Array, FloatArray]:
        offsets, views, positions = _kernels.candidates_in_pecs(
            chains.indexes, starts.views[rows], starts.positions[rows], pecs, depths, num_threads
        )
        return offsets, views, positions

    return PepcSource(starts=starts, find_candidates=find_candidates)


def depth_bounds(model: Model) -> FloatArray:
    """(V, 2) minimum and maximum depth of edges in each view: of its SfM points with a margin.

    (0, inf) for views without SfM points.
    """
    point_ids = model.track_points
    ranges = np.tile([0.0, np.inf], (len(model.views), 1))
    for index, rows in enumerate(rows_by_view(model.track_views, len(model.views))):
        points = model.points3D_xyz[point_ids[rows]]
        depths = model.views[index].cam_from_world(points)[:, 2]
        depths = depths[depths > 0]
        if len(depths):
            near, far = np.percentile(depths, (1.0, 99.0))  # without outliers
            ranges[index] = near / 2.0, far * 2.0
    return ranges


def sample_polylines(chains: IndexedViews, wanted: BoolArray, spacing_px: float) -> Places:
    """Positions at even intervals of about `spacing_px` on the wanted polylines ((P,) bool)."""
    found = []
    for view, graph in enumerate(chains.graphs):
        first, last = chains.polyline_offsets[view : view + 2]
        positions = sample_graph(graph, wanted[first:last], spacing_px)
        found.append(Places(views=np.full(len(positions), view, np.int32), positions=positions))
    return join_places(found)


def sample_graph(graph: EdgeGraph, wanted: BoolArray, spacing_px: float) -> FloatArray:
    """Positions at even intervals on the wanted polylines ((P,) bool) of one view.

    The intervals are centred on the polyline; polylines shorter than the spacing have one position.
    """
    following = next_points(graph, np.arange(len(graph.undistorted)))
    steps = np.linalg.norm(graph.undistorted[following] - graph.undistorted, axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    offsets = graph.polyline_offsets
    begin = arc[offsets[:-1]]
    lengths = arc[offsets[1:]] - begin
    usable = wanted & (lengths > 0)
    counts = np.where(usable, np.maximum(1, np.round(lengths / spacing_px)), 0).astype(np.int64)
    polylines = np.repeat(np.arange(graph.num_polylines), counts)
    shares = (ranks_of(counts) + 0.5) / counts[polylines]
    places = begin[polylines] + shares * lengths[polylines]
    before = np.searchsorted(arc, places, "right") - 1
    before = np.clip(before, offsets[polylines], offsets[polylines + 1] - 1)
    fractions = (places - arc[before]) / np.where(steps[before] > 0, steps[before], 1)
    # Never quite the next point: the last may connect to the first.
    positions: FloatArray = before + np.clip(fractions, 0, 1 - 1e-9)
    return positions
