"""Errors of curves by visibility, with thresholds in pixels at the scene's depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.clouds import (
    Score,
    cloud_to_cloud,
    cloud_to_mesh,
    score,
    shares_below,
)
from colmap_edges.evaluation.metrics.curves import sample
from colmap_edges.evaluation.metrics.raycasting import RayCaster
from colmap_edges.evaluation.readers.curves import Curves


@dataclass(frozen=True, kw_only=True)
class Visibility:
    """Visibility of samples of curves.

    Attributes:
        count: (N,) number of views that see each.
        pixel_size: (N,) length of one pixel at its depth in the nearest view that sees it (or,
            seen by none, in the nearest view): depth / focal length, in world units.
    """

    count: IntArray
    pixel_size: FloatArray


def visibility(points: FloatArray, views: Sequence[View], caster: RayCaster | None) -> Visibility:
    """Visibility of `points` (N, 3) in views: inside the image and not occluded by the surface.

    A point is occluded if the surface is hit more than three pixels' length (at the point's depth)
    in front of it; the tolerance allows for the surface's own triangles.
    """
    count = np.zeros(len(points), dtype=np.int64)
    nearest_seen = np.full(len(points), np.inf)
    nearest = np.full(len(points), np.inf)
    for view in views:
        pixels, depth = view.project(points)
        size = np.where(depth > 0, depth / view.focal_px, np.inf)
        seen = view.holds(pixels, depth)
        nearest = np.minimum(nearest, size)
        inside = np.flatnonzero(seen)
        if caster is not None and len(inside):
            along = caster.cast(view.center, points[inside] - view.center)
            hidden = along * depth[inside] < depth[inside] - 3 * size[inside]
            seen[inside[hidden]] = False
        count += seen
        nearest_seen = np.where(seen, np.minimum(nearest_seen, size), nearest_seen)
    size = np.where(np.isfinite(nearest_seen), nearest_seen, nearest)
    return Visibility(count=count, pixel_size=size)


@dataclass(frozen=True, kw_only=True)
class ViewRecall:
    """Recall of those true curves that a certain number of views sees.

    Attributes:
        min_views: Least number of views.
        max_views: Largest number of views.
        length: Length of these curves in world units.
        recall: Share of it within each threshold of the result.
    """

    min_views: int
    max_views: int
    length: float
    recall: list[float]


@dataclass(frozen=True, kw_only=True)
class VisibleCurveErrors:
    """Errors of reconstructed curves against true curves, by visibility in the images.

    Thresholds are pixels at the scene's depth: each sample's own distance is its
    `Visibility.pixel_size` times the threshold.

    Attributes:
        scores: Precision against all true curves, recall of those that enough views see.
        accuracy: Mean distance from samples of the result to the true curves, world units.
        completeness: Mean distance from samples of the visible true curves to the result.
        recall_by_views: The recall by the number of views, each range twice the one before.
        on_surface: Share of the result within each threshold of the true surface, including
            painted edges that are no true curves. Empty without a surface.
        result_samples: Number of samples of the result.
        reference_samples: Number of samples of the visible true curves.
        spacing: Distance between samples along the curves, world units.
        unit: World units per unit of these figures: 1.
    """

    scores: list[Score]
    accuracy: float
    completeness: float
    recall_by_views: list[ViewRecall]
    on_surface: list[float]
    result_samples: int
    reference_samples: int
    spacing: float
    unit: float = 1.0


def compare_visible_curves(
    result: Curves,
    reference: Curves,
    views: Sequence[View],
    surface: Any = None,
    *,
    thresholds_px: Sequence[float] = (1.0, 2.0),
    min_views: int = 3,
) -> VisibleCurveErrors:
    """Precision against all true curves, recall against those at least `min_views` views see.

    A sample of the result has the threshold of the nearest true sample. Both are sampled at a fifth
    of the median of the smallest threshold.

    Args:
        result: Reconstructed curves.
        reference: True curves, or samples of them.
        views: The posed images.
        surface: True surface, a mesh with `vertices` and `faces`; None for no occlusion.
        thresholds_px: Distances in pixels.
        min_views: Minimum number of views that see a curve counted in recall.

    Raises:
        ColmapEdgesError: The reference is empty.
    """
    if not len(reference.points):
        raise ColmapEdgesError("the reference holds no curve")
    caster = None if surface is None else RayCaster(surface.vertices, surface.faces)
    coarse = visibility(reference.points, views, None).pixel_size
    spacing = float(np.median(coarse)) * min(thresholds_px) / 5
    found, true = sample(result, spacing), sample(reference, spacing)
    seen = visibility(true, views, caster)
    to_reference, nearest = cKDTree(true).query(found, workers=2) if len(found) else ([], [])
    limit = seen.pixel_size[np.asarray(nearest, dtype=np.int64)]
    precision = shares_below(np.asarray(to_reference, dtype=np.float64) / limit, thresholds_px)
    to_result = cloud_to_cloud(true, found)
    visible = seen.count >= min_views
    recall = shares_below((to_result / seen.pixel_size)[visible], thresholds_px)
    return VisibleCurveErrors(
        scores=[score(*row) for row in zip(thresholds_px, precision, recall, strict=True)],
        accuracy=float(np.mean(to_reference)) if len(found) else float("nan"),
        completeness=float(to_result[visible].mean()) if visible.any() else float("nan"),
        recall_by_views=recall_by_views(
            to_result / seen.pixel_size, seen.count, thresholds_px, spacing
        ),
        on_surface=on_surface(found, views, surface, thresholds_px),
        result_samples=len(found),
        reference_samples=int(visible.sum()),
        spacing=spacing,
    )


def recall_by_views(
    distances_px: FloatArray, counts: IntArray, thresholds_px: Sequence[float], spacing: float
) -> list[ViewRecall]:
    """Recall of samples (N,) seen by no view, one, two, 3 to 4, 5 to 8 and so on.

    Args:
        distances_px: Distance from each true sample to the result in pixels.
        counts: Number of views that see each.
        thresholds_px: Distances in pixels.
        spacing: Length that a sample stands for.
    """
    rows = []
    low, high = 0, 0
    while low <= counts.max(initial=-1):
        chosen = (counts >= low) & (counts <= high)
        if chosen.any():
            rows.append(
                ViewRecall(
                    min_views=low,
                    max_views=high,
                    length=float(chosen.sum()) * spacing,
                    recall=shares_below(distances_px[chosen], thresholds_px),
                )
            )
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
    size = visibility(points, views, None).pixel_size
    return shares_below(distances / size, thresholds_px)
