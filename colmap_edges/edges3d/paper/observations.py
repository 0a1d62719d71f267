"""Lists of observations of edge points, and triangulation of points from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.core.arrays import (
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
    Table,
    joined_tables,
    offsets_of,
)
from colmap_edges.core.edges3d import Edges3D, mean_colors
from colmap_edges.core.observations import Observations
from colmap_edges.edges3d.paper.places import IndexedViews, Places
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


@dataclass(frozen=True, kw_only=True)
class ObservedPoints(Table):
    """Observations of 3D points as a list, sorted by point and then view.

    Attributes:
        points: (T,) int64 index of the 3D point.
        views: (T,) int32.
        positions: (T,) float64 positions on the view's chains, see `core.observations`.
        chains: (T,) int32 polylines of the view's edge graph.
        pixels: (T, 2) float64 image pixels, COLMAP's origin.
        normals: (T, 2) float32 unit normals of the chains, undistorted pixels.
        undistorted: (T, 2) float64 `pixels` as undistorted pixels.
        colors: (T, 3) float64 RGB.
    """

    points: IntArray
    views: Int32Array
    positions: FloatArray
    chains: Int32Array
    pixels: FloatArray
    normals: Float32Array
    undistorted: FloatArray
    colors: FloatArray

    def by_point(self, num_points: int) -> Observations:
        """The observations in CSR arrays by point."""
        return Observations(
            offsets=track_offsets(self.points, num_points),
            views=self.views,
            positions=self.positions,
            chains=self.chains,
            pixels=self.pixels,
            normals=self.normals,
        )


def observations_at(points: IntArray, places: Places, chains: IndexedViews) -> ObservedPoints:
    """Observations of (T,) points at (T) positions on chains."""
    seen, colors = chains.look_up(places)
    return ObservedPoints(
        points=points,
        views=places.views,
        positions=places.positions,
        chains=seen.chains,
        pixels=seen.pixels,
        normals=seen.normals,
        undistorted=chains.undistorted_points(places),
        colors=colors,
    )


def observations_of(edges: Edges3D, chains: IndexedViews) -> ObservedPoints:
    """The tracks of all edge points as one list."""
    observed = edges.observations
    undistorted = np.empty((len(observed.views), 2))
    for view, rows in observed.by_view():
        undistorted[rows] = chains.views[view].undistorted_from_image(observed.pixels[rows])
    return ObservedPoints(
        points=observed.points,
        views=observed.views,
        positions=observed.positions,
        chains=observed.chains,
        pixels=observed.pixels,
        normals=observed.normals,
        undistorted=undistorted,
        colors=edges.colors[observed.points].astype(np.float64),
    )


def merge(*parts: ObservedPoints) -> ObservedPoints:
    """Merge lists, sorted by point and view."""
    joined = joined_tables(parts)
    return joined.select(np.lexsort((joined.views, joined.points)))


def track_offsets(points: IntArray, num_points: int) -> IntArray:
    """(num_points + 1,) CSR offsets of ascending point indices."""
    return offsets_of(np.bincount(points, minlength=num_points))


def triangulate_observations(
    observed: ObservedPoints, num_points: int, chains: IndexedViews, num_threads: int
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) least-squares points, (N,) largest reprojection errors in pixels; NaN, inf if none."""
    points, errors = _kernels.triangulate_tracks(
        chains.indexes,
        track_offsets(observed.points, num_points),
        np.ascontiguousarray(observed.views, np.int32),
        np.ascontiguousarray(observed.undistorted),
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


def with_observations(edges: Edges3D, points: FloatArray, observed: ObservedPoints) -> Edges3D:
    """The edges with these points and tracks."""
    observations = observed.by_point(len(points))
    colors = mean_colors(observed.colors, observations.offsets)
    return replace(edges, points=points, observations=observations, colors=colors)


def reprojection_errors(
    observed: ObservedPoints, points: FloatArray, chains: IndexedViews
) -> FloatArray:
    """(T,) distance in pixels of each observation to its projected point; NaN behind the camera."""
    errors = np.full(len(observed.points), np.nan)
    for index, view in enumerate(chains.views):
        rows = np.flatnonzero(observed.views == index)
        projected, _ = view.project_undistorted(points[observed.points[rows]])
        errors[rows] = np.linalg.norm(projected - observed.undistorted[rows], axis=1)
    return errors
