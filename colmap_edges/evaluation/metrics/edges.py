"""Metrics of 3D edges: errors against reference depth, reprojection errors, lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Float32Array, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import track_residuals
from colmap_edges.evaluation.metrics.depth import ReferenceDepth
from colmap_edges.evaluation.metrics.statistics import ErrorStatistics, summarize
from colmap_edges.evaluation.readers.curves import Curves

GROSS_SEGMENT_RATIO = 20.0


@dataclass(frozen=True, kw_only=True)
class PointDepthErrors:
    """Depth errors of 3D points relative to the reference, in the views that observe them.

    Attributes:
        relative: Statistics of |depth - reference| / reference, the smallest in a 5x5 window.
        within_0_2_percent: Share of errors below 0.002.
        within_1_percent: Share of errors below 0.01.
    """

    relative: ErrorStatistics
    within_0_2_percent: float
    within_1_percent: float


@dataclass(frozen=True, kw_only=True)
class ReprojectionErrors:
    """Distances in pixels from projected points to their own observations (in-sample).

    Attributes:
        distance_px: Statistics over observations.
        within_1_px: Share of observations within one pixel.
        points: Number of points.
        observations_mean: Mean number of observations per point.
        observations_median: Median of the same.
    """

    distance_px: ErrorStatistics
    within_1_px: float
    points: int
    observations_mean: float
    observations_median: float


@dataclass(frozen=True, kw_only=True)
class SegmentLengths:
    """Lengths of the segments of an edge graph, in world units.

    Attributes:
        count: Number of segments.
        total: Sum of all lengths.
        median: Median length.
        p95: 95th percentile of the lengths.
        longest: Largest length.
        gross: Number of segments longer than 20 medians.
        gross_total: Sum of their lengths.
    """

    count: int
    total: float
    median: float
    p95: float
    longest: float
    gross: int
    gross_total: float


def depth_window_errors(
    model: Model,
    references: Sequence[ReferenceDepth],
    window: int = 5,
    *,
    relative: bool = True,
) -> FloatArray:
    """Depth errors of a model's points in each reference view that observes them.

    The error is the smallest |depth - reference| / reference in a `window` x `window` block of the
    depth map around the point's projection, since edges sit on depth steps. Points without any
    reference there, or that project off the map, are left out.

    Returns:
        (N,) errors, one for each pair of point and reference view, relative to the reference or
        (not `relative`) in world units.
    """
    index = {view.name: number for number, view in enumerate(model.views)}
    points = model.points3D_xyz[model.track_points]
    errors = []
    for reference in references:
        seen = model.track_views == index.get(reference.view.name, -1)
        errors.append(view_window_errors(points[seen], reference, window, relative=relative))
    pooled = np.concatenate(errors) if errors else np.empty(0)
    return pooled[np.isfinite(pooled)]


def view_window_errors(
    points: FloatArray, reference: ReferenceDepth, window: int = 5, *, relative: bool = True
) -> FloatArray:
    """`depth_window_errors` of `points` (N, 3) in one view: (N,), infinite without a reference."""
    pixels, depth = reference.view.project(points)
    pixels = pixels * reference.scale
    inside = (depth > 0) & np.isfinite(pixels).all(axis=1)
    cells = np.floor(pixels[inside]).astype(np.int64)
    smallest = _smallest_error(reference.depth, cells, depth[inside], window)
    errors = np.full(len(points), np.inf)
    errors[inside] = smallest[:, 0] / smallest[:, 1] if relative else smallest[:, 0]
    return errors


def _smallest_error(
    reference: Float32Array, cells: IntArray, depth: FloatArray, window: int
) -> FloatArray:
    """Smallest |depth - reference| and the reference there, (N, 2); infinite, 1 without any."""
    height, width = reference.shape
    best = np.column_stack([np.full(len(cells), np.inf), np.ones(len(cells))])
    offsets = range(-(window // 2), window // 2 + 1)
    for row, column in product(offsets, offsets):
        x, y = cells[:, 0] + column, cells[:, 1] + row
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        value = np.zeros(len(cells))
        value[inside] = reference[y[inside], x[inside]]
        error = np.abs(depth - value)
        better = (value > 0) & (error < best[:, 0])
        best[better] = np.column_stack([error, value])[better]
    return best


def summarize_depth(errors: FloatArray) -> PointDepthErrors:
    """Statistics and shares of the errors of `depth_window_errors`."""
    nan = float("nan")
    return PointDepthErrors(
        relative=summarize(errors),
        within_0_2_percent=float(np.mean(errors < 0.002)) if len(errors) else nan,
        within_1_percent=float(np.mean(errors < 0.01)) if len(errors) else nan,
    )


def reprojection_errors(model: Model) -> ReprojectionErrors:
    """Distances of a model's points to their observations, and how many those are.

    Points behind a camera that observes them have an infinite distance.
    """
    points = model.points3D_xyz[model.track_points]
    residuals = track_residuals(model.views, points, model.track_views, model.track_points2D)
    distance = np.nan_to_num(residuals, nan=np.inf)
    counts = np.diff(model.track_offsets)
    nan = float("nan")
    return ReprojectionErrors(
        distance_px=summarize(distance[np.isfinite(distance)]),
        within_1_px=float(np.mean(distance < 1)) if len(distance) else nan,
        points=len(model.points3D_xyz),
        observations_mean=float(counts.mean()) if len(counts) else nan,
        observations_median=float(np.median(counts)) if len(counts) else nan,
    )


def segment_lengths(curves: Curves) -> SegmentLengths:
    """Lengths of the segments of `curves`; gross ones are longer than 20 medians."""
    lengths = curves.lengths()
    if not len(lengths):
        return SegmentLengths(
            count=0, total=0.0, median=0.0, p95=0.0, longest=0.0, gross=0, gross_total=0.0
        )
    median, p95 = (float(q) for q in np.percentile(lengths, (50, 95)))
    gross = lengths > GROSS_SEGMENT_RATIO * median
    return SegmentLengths(
        count=len(lengths),
        total=float(lengths.sum()),
        median=median,
        p95=p95,
        longest=float(lengths.max()),
        gross=int(gross.sum()),
        gross_total=float(lengths[gross].sum()),
    )


def edge_points(model: Model, input_model: Model) -> Model:
    """The points of `model` whose ids are not in `input_model`."""
    return model.selected(~np.isin(model.point3D_ids, input_model.point3D_ids))


def points_of_edges(found: Edges3D, model: Model) -> Model:
    """Edge points as the points of a model with the same views."""
    return replace(
        model,
        points3D_xyz=found.points,
        point3D_ids=np.arange(found.num_points, dtype=np.int64),
        points3D_rgb=np.zeros((found.num_points, 3), dtype=np.uint8),
        track_offsets=found.observations.offsets,
        track_views=found.observations.views,
        track_points2D=found.observations.pixels,
    )
