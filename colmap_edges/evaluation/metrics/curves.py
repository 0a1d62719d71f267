"""3D edges as sampled curves: sampling by length, precision and recall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, ranks_of
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.clouds import Score, cloud_to_cloud, scores
from colmap_edges.evaluation.readers.curves import Curves


@dataclass(frozen=True, kw_only=True)
class CurveErrors:
    """Errors of reconstructed curves against true ones.

    Attributes:
        accuracy: Mean distance from samples of the result to the reference.
        completeness: Mean distance from samples of the reference to the result.
        scores: Precision, recall and F at every threshold.
        result_samples: Number of samples of the result.
        reference_samples: Number of samples of the reference.
        spacing: Distance between samples along the curves.
        unit: World units per unit of these figures (1 without scaling).
    """

    accuracy: float
    completeness: float
    scores: list[Score]
    result_samples: int
    reference_samples: int
    spacing: float
    unit: float


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


def inside_box(points: FloatArray, reference: FloatArray, margin: float) -> BoolArray:
    """Which of `points` (N, 3) lie in the bounding box of `reference`, grown by `margin`."""
    low, high = reference.min(axis=0) - margin, reference.max(axis=0) + margin
    return np.asarray(((points >= low) & (points <= high)).all(axis=1))


def compare_curves(
    result: Curves,
    reference: Curves,
    thresholds: Sequence[float],
    *,
    spacing: float = 0.0,
    unit_size: bool = False,
    crop: bool = False,
) -> CurveErrors:
    """Precision, recall, accuracy and completeness of `result` against `reference`.

    Both are sampled every `spacing` (0: a fifth of the smallest threshold), so a nearest sample
    is at most half a spacing off along the curve.

    Args:
        result: Reconstructed curves.
        reference: True curves, or samples of them.
        thresholds: Distances, in units of the comparison.
        spacing: Sampling distance in the same unit.
        unit_size: Scale both so that the longest side of the reference's box is 1 (the protocol
            of ABC-NEF's tables).
        crop: Count only samples of the result in the reference's box, for references that cover
            a part of the scene.

    Raises:
        ColmapEdgesError: The reference is empty.
    """
    if not len(reference.points):
        raise ColmapEdgesError("the reference holds no curve")
    unit = float(np.ptp(reference.points, axis=0).max()) if unit_size else 1.0
    spacing = spacing or min(thresholds) / 5
    found = sample(_scaled(result, unit), spacing)
    true = sample(_scaled(reference, unit), spacing)
    if crop:
        found = found[inside_box(found, true, max(thresholds))]
    to_reference, to_result = cloud_to_cloud(found, true), cloud_to_cloud(true, found)
    return CurveErrors(
        accuracy=float(to_reference.mean()) if len(found) else float("nan"),
        completeness=float(to_result.mean()),
        scores=scores(to_reference, to_result, thresholds),
        result_samples=len(found),
        reference_samples=len(true),
        spacing=spacing,
        unit=unit,
    )


def _scaled(curves: Curves, unit: float) -> Curves:
    return Curves(points=curves.points / unit, segments=curves.segments)
