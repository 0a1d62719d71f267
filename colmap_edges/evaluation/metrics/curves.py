"""3D edges as sampled curves: sampling by length, precision and recall."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, ranks_of
from colmap_edges.evaluation.metrics.clouds import cloud_to_cloud, scores
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
    spacing: float = 0.0,
    unit_size: bool = False,
    crop: bool = False,
) -> Record:
    """Precision, recall, accuracy and completeness of `result` against `reference`.

    Both are sampled every `spacing` (0: a fifth of the smallest threshold), so a nearest sample
    is at most half a spacing off along the curve.

    Args:
        result: Reconstructed curves.
        reference: True curves, or samples of them; at least one.
        thresholds: Distances, in units of the comparison.
        spacing: Sampling distance in the same unit.
        unit_size: Scale both so that the longest side of the reference's box is 1 (the protocol
            of ABC-NEF's tables).
        crop: Count only samples of the result in the reference's box, for references that cover
            a part of the scene.

    Returns:
        `accuracy` and `completeness` (mean distances from samples of the result to the reference
        and back), `scores` at every threshold, `result_samples`, `reference_samples`, `spacing`,
        and `unit` (world units per unit of these figures).
    """
    unit = float(np.ptp(reference.points, axis=0).max()) if unit_size else 1.0
    spacing = spacing or min(thresholds) / 5
    found, true = (
        sample(Curves(points=each.points / unit, segments=each.segments), spacing)
        for each in (result, reference)
    )
    if crop:
        low, high = true.min(axis=0) - max(thresholds), true.max(axis=0) + max(thresholds)
        found = found[((found >= low) & (found <= high)).all(axis=1)]
    to_reference, to_result = cloud_to_cloud(found, true), cloud_to_cloud(true, found)
    return {
        "accuracy": mean(to_reference),
        "completeness": mean(to_result),
        "scores": scores(to_reference, to_result, thresholds),
        "result_samples": len(found),
        "reference_samples": len(true),
        "spacing": spacing,
        "unit": unit,
    }
