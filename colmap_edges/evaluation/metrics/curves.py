"""3D edges as sampled curves: precision and recall, of all curves or of visible ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, ranks_of
from colmap_edges.core.view import View
from colmap_edges.evaluation.metrics.clouds import (
    cloud_to_cloud,
    cloud_to_mesh,
    scores,
    shares_below,
)
from colmap_edges.evaluation.metrics.raycasting import RayCaster, seen_in
from colmap_edges.evaluation.metrics.statistics import Record, mean
from colmap_edges.evaluation.readers.curves import Curves


class Samples(NamedTuple):
    """Samples of segments.

    Attributes:
        points: (N, 3) positions.
        segments: (N,) segment of each.
        lengths: (N,) length represented by each.
    """

    points: FloatArray
    segments: IntArray
    lengths: FloatArray


def sample_segments(curves: Curves, spacing: FloatArray | float) -> Samples:
    """Samples at most `spacing` apart along every segment, at the middles of equal parts.

    A segment gives ceil(length / spacing) samples, so every sample stands for nearly the same
    length and shares of samples are shares of length; segments of length 0 give none.
    """
    lengths = curves.lengths()
    counts = np.ceil(lengths / spacing).astype(np.int64)
    segment = np.repeat(np.arange(len(counts)), counts)
    part = (ranks_of(counts) + 0.5) / counts[segment]
    start, end = (curves.points[curves.segments[segment, side]] for side in (0, 1))
    return Samples(
        start + part[:, None] * (end - start), segment, (lengths[segment] / counts[segment])
    )


def sample(curves: Curves, spacing: float) -> FloatArray:
    """Points (N, 3) of `sample_segments`; curves without segments give their points."""
    return sample_segments(curves, spacing).points if len(curves.segments) else curves.points


def compare_curves(
    result: Curves,
    reference: Curves,
    thresholds: Sequence[float],
    *,
    unit_size: bool = False,
    crop: bool = False,
) -> Record:
    """Precision, recall, accuracy and completeness of `result` against `reference`.

    Both are sampled every fifth of the smallest threshold, so a nearest sample is at most a tenth
    of it off along the curve.

    Args:
        result: Reconstructed curves.
        reference: True curves, or samples of them; at least one.
        thresholds: Distances, in units of the comparison.
        unit_size: Scale both so that the longest side of the reference's box is 1 (the protocol
            of ABC-NEF's tables).
        crop: Count only samples of the result in the reference's box, for references that cover
            a part of the scene.

    Returns:
        See `errors_of`, with `spacing` and `unit` (world units per unit of these figures).
    """
    unit = float(np.ptp(reference.points, axis=0).max()) if unit_size else 1.0
    spacing = min(thresholds) / 5
    found, true = (
        sample(Curves(points=each.points / unit, segments=each.segments), spacing)
        for each in (result, reference)
    )
    if crop:
        low, high = true.min(axis=0) - max(thresholds), true.max(axis=0) + max(thresholds)
        found = found[((found >= low) & (found <= high)).all(axis=1)]
    record, _ = errors_of(found, true, np.ones(len(true)), np.ones(len(true), bool), thresholds)
    return record | {"spacing": spacing, "unit": unit}


def errors_of(
    found: FloatArray,
    true: FloatArray,
    sizes: FloatArray,
    wanted: BoolArray,
    thresholds: Sequence[float],
) -> tuple[Record, FloatArray]:
    """Errors of samples (N, 3) of a result against true ones (M, 3).

    Args:
        found: Samples of the result.
        true: Samples of the true curves.
        sizes: (M,) unit of the thresholds at each; a sample of the result has that of the nearest.
        wanted: (M,) which of them are counted in recall and completeness.
        thresholds: Distances, in these units.

    Returns:
        `accuracy` and `completeness` (mean distances from the result to the truth and back),
        `scores` at every threshold, `result_samples`, `reference_samples`; and (M,) distances from
        all true samples to the result.
    """
    to_true, nearest = cKDTree(true).query(found, workers=2)
    to_found = cloud_to_cloud(true, found)
    record = {
        "accuracy": mean(to_true),
        "completeness": mean(to_found[wanted]),
        "scores": scores(to_true / sizes[nearest], (to_found / sizes)[wanted], thresholds),
        "result_samples": len(found),
        "reference_samples": int(wanted.sum()),
    }
    return record, to_found


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
) -> Record:
    """Precision against all true curves, recall against those that at least three views see.

    Thresholds are pixels at the scene's depth: each true sample's own distance is the length of a
    pixel there (see `visibility`) times the threshold, and a sample of the result has that of the
    nearest true sample. Both are sampled at a fifth of the median of the smallest threshold.

    Args:
        result: Reconstructed curves.
        reference: True curves, or samples of them; at least one.
        views: The posed images.
        surface: True surface, a mesh with `vertices` and `faces`; None for no occlusion.
        thresholds_px: Distances in pixels.

    Returns:
        See `errors_of`, in world units; `recall_by_views`; and the share `on_surface` of the result
        within each threshold of the surface, including painted edges that are no true curves.
    """
    caster = None if surface is None else RayCaster(surface.vertices, surface.faces)
    coarse = visibility(reference.points, views, None)[1]
    spacing = float(np.median(coarse)) * min(thresholds_px) / 5
    found, true = sample(result, spacing), sample(reference, spacing)
    count, sizes = visibility(true, views, caster)
    record, to_result = errors_of(found, true, sizes, count >= 3, thresholds_px)
    return record | {
        "recall_by_views": recall_by_views(to_result / sizes, count, thresholds_px, spacing),
        "on_surface": on_surface(found, views, surface, thresholds_px),
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
