"""Observations of the points of 3D edges: lists of them, and points triangulated from them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, offsets_of
from colmap_edges.core.edges3d import Edges3D, mean_colors
from colmap_edges.core.view import views_with_rows
from colmap_edges.edges3d.paper.edge_field import EdgeField, pose_arrays
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


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


def reprojection_errors(observed: Observations, points: FloatArray, field: EdgeField) -> FloatArray:
    """(T,) distance in pixels between each observation and its projected point; NaN behind."""
    errors = np.full(len(observed.points), np.nan)
    for index, view in enumerate(field.views):
        rows = np.flatnonzero(observed.views == index)
        projected, _ = view.project_ideal(points[observed.points[rows]])
        errors[rows] = np.linalg.norm(projected - observed.ideal[rows], axis=1)
    return errors
