"""Errors of curves by visibility, with thresholds in pixels at the scene's depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.view import View
from colmap_edges.evaluation.metrics.clouds import (
    cloud_to_cloud,
    cloud_to_mesh,
    score,
    shares_below,
)
from colmap_edges.evaluation.metrics.curves import sample
from colmap_edges.evaluation.metrics.raycasting import RayCaster, seen_in
from colmap_edges.evaluation.metrics.statistics import Record, mean
from colmap_edges.evaluation.readers.curves import Curves


def visibility(
    points: FloatArray, views: Sequence[View], caster: RayCaster | None
) -> tuple[IntArray, FloatArray]:
    """Visibility of `points` (N, 3) in views: inside the image and not occluded by the surface.

    Returns:
        (N,) number of views that see each; (N,) length of one pixel at its depth, in world units,
        in the nearest view that sees it (or, seen by none, in the nearest view).
    """
    count = np.zeros(len(points), dtype=np.int64)
    nearest, nearest_seen = np.full((2, len(points)), np.inf)
    for view in views:
        _, depths, seen = seen_in(view, points, caster)
        sizes = np.where(depths > 0, depths / view.focal_px, np.inf)
        count += seen
        np.minimum(nearest, sizes, out=nearest)
        np.minimum(nearest_seen, sizes, out=nearest_seen, where=seen)
    return count, np.where(np.isfinite(nearest_seen), nearest_seen, nearest)


def compare_visible_curves(
    result: Curves,
    reference: Curves,
    views: Sequence[View],
    surface: Any = None,
    *,
    thresholds_px: Sequence[float] = (1.0, 2.0),
    min_views: int = 3,
) -> Record:
    """Precision against all true curves, recall against those at least `min_views` views see.

    Thresholds are pixels at the scene's depth: each true sample's own distance is the length of a
    pixel there (see `visibility`) times the threshold, and a sample of the result has that of the
    nearest true sample. Both are sampled at a fifth of the median of the smallest threshold.

    Args:
        result: Reconstructed curves.
        reference: True curves, or samples of them; at least one.
        views: The posed images.
        surface: True surface, a mesh with `vertices` and `faces`; None for no occlusion.
        thresholds_px: Distances in pixels.
        min_views: Minimum number of views that see a curve counted in recall.

    Returns:
        The figures of `curves.compare_curves` in world units, with the visible true curves as
        reference; `recall_by_views`; and the share `on_surface` of the result within each
        threshold of the surface, including painted edges that are no true curves.
    """
    caster = None if surface is None else RayCaster(surface.vertices, surface.faces)
    coarse = visibility(reference.points, views, None)[1]
    spacing = float(np.median(coarse)) * min(thresholds_px) / 5
    found, true = sample(result, spacing), sample(reference, spacing)
    count, sizes = visibility(true, views, caster)
    to_reference, nearest = cKDTree(true).query(found, workers=2)
    precision = shares_below(to_reference / sizes[nearest], thresholds_px)
    to_result, visible = cloud_to_cloud(true, found), count >= min_views
    recall = shares_below((to_result / sizes)[visible], thresholds_px)
    return {
        "scores": [score(*row) for row in zip(thresholds_px, precision, recall, strict=True)],
        "accuracy": mean(to_reference),
        "completeness": mean(to_result[visible]),
        "recall_by_views": recall_by_views(to_result / sizes, count, thresholds_px, spacing),
        "on_surface": on_surface(found, views, surface, thresholds_px),
        "result_samples": len(found),
        "reference_samples": int(visible.sum()),
        "spacing": spacing,
        "unit": 1.0,
    }


def recall_by_views(
    distances_px: FloatArray, counts: IntArray, thresholds_px: Sequence[float], spacing: float
) -> list[Record]:
    """Recall of samples (N,) seen by no view, one, two, 3 to 4, 5 to 8 and so on.

    Args:
        distances_px: Distance from each true sample to the result in pixels.
        counts: Number of views that see each.
        thresholds_px: Distances in pixels.
        spacing: Length that a sample stands for.

    Returns:
        For each range `min_views` to `max_views`, the `length` of the curves in it, and their
        `recall` at each threshold.
    """
    rows: list[Record] = []
    low, high = 0, 0
    while low <= counts.max(initial=-1):
        chosen = (counts >= low) & (counts <= high)
        if chosen.any():
            recall = shares_below(distances_px[chosen], thresholds_px)
            row = {"min_views": low, "max_views": high, "recall": recall}
            rows.append(row | {"length": float(chosen.sum()) * spacing})
        low, high = high + 1, max(1, 2 * high)
    return rows


def on_surface(
    points: FloatArray, views: Sequence[View], surface: Any, thresholds_px: Sequence[float]
) -> list[float]:
    """Share of `points` (N, 3) within each threshold of the surface; none without a surface.

    A pixel is as long as at the point's depth in the nearest view.
    """
    if surface is None:
        return []
    distances = cloud_to_mesh(points, surface.vertices, surface.faces)
    size = visibility(points, views, None)[1]
    return shares_below(distances / size, thresholds_px)
