"""Metrics of 3D edges: errors against reference depth, reprojection errors, lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Float32Array, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import track_residuals
from colmap_edges.evaluation.metrics.depth import ReferenceDepth
from colmap_edges.evaluation.metrics.statistics import Record, mean, summarize
from colmap_edges.evaluation.readers.curves import Curves


def depth_window_errors(
    model: Model,
    references: Sequence[ReferenceDepth],
    *,
    relative: bool = True,
) -> FloatArray:
    """Depth errors of a model's points in each reference view that observes them.

    The error is the smallest |depth - reference| / reference in a 5 x 5 block of the
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
        errors.append(view_window_errors(points[seen], reference, relative=relative))
    pooled = np.concatenate(errors) if errors else np.empty(0)
    return pooled[np.isfinite(pooled)]


def view_window_errors(
    points: FloatArray, reference: ReferenceDepth, *, relative: bool = True
) -> FloatArray:
    """`depth_window_errors` of `points` (N, 3) in one view: (N,), infinite without a reference."""
    pixels, depth = reference.view.project(points)
    pixels = pixels * reference.scale
    inside = (depth > 0) & np.isfinite(pixels).all(axis=1)
    cells = np.floor(pixels[inside]).astype(np.int64)
    smallest = _smallest_error(reference.depth, cells, depth[inside])
    errors = np.full(len(points), np.inf)
    errors[inside] = smallest[:, 0] / smallest[:, 1] if relative else smallest[:, 0]
    return errors


def _smallest_error(reference: Float32Array, cells: IntArray, depth: FloatArray) -> FloatArray:
    """Smallest |depth - reference| and the reference there, (N, 2); infinite, 1 without any."""
    height, width = reference.shape
    best = np.column_stack([np.full(len(cells), np.inf), np.ones(len(cells))])
    for row, column in product(range(-2, 3), repeat=2):
        x, y = cells[:, 0] + column, cells[:, 1] + row
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        value = np.zeros(len(cells))
        value[inside] = reference[y[inside], x[inside]]
        error = np.abs(depth - value)
        better = (value > 0) & (error < best[:, 0])
        best[better] = np.column_stack([error, value])[better]
    return best


def summarize_depth(errors: FloatArray) -> Record:
    """Statistics of relative errors of `depth_window_errors`, and shares of the small ones."""
    return {
        "relative": summarize(errors),
        "within_0_2_percent": mean(errors < 0.002),
        "within_1_percent": mean(errors < 0.01),
    }


def reprojection_errors(model: Model) -> Record:
    """Distances in pixels of projected points to their own observations (in-sample).

    Points behind a camera that observes them have an infinite distance.

    Returns:
        Statistics `distance_px` over observations, the share of those `within_1_px`, the number of
        `points`, and `observations_mean` and `observations_median` of a point.
    """
    points = model.points3D_xyz[model.track_points]
    residuals = track_residuals(model.views, points, model.track_views, model.track_points2D)
    counts = np.diff(model.track_offsets)
    return {
        "distance_px": summarize(residuals[np.isfinite(residuals)]),
        "within_1_px": mean(residuals < 1),
        "points": len(model.points3D_xyz),
        "observations_mean": mean(counts),
        "observations_median": float(np.median(counts)) if len(counts) else float("nan"),
    }


def segment_lengths(curves: Curves) -> Record:
    """Lengths of the segments of `curves` in world units; `gross` ones are longer than 20 medians.

    Returns:
        Their number `count`, the sum `total`, `median`, 95th percentile `p95` and the `longest`
        length, the number of `gross` ones and the sum `gross_total` of their lengths.
    """
    lengths = curves.lengths()
    median, p95 = (float(q) for q in np.percentile(lengths if len(lengths) else 0.0, (50, 95)))
    gross = lengths > 20 * median
    return {
        "count": len(lengths),
        "total": float(lengths.sum()),
        "median": median,
        "p95": p95,
        "longest": float(lengths.max(initial=0.0)),
        "gross": int(gross.sum()),
        "gross_total": float(lengths[gross].sum()),
    }


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
