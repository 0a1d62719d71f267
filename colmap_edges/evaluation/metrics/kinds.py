"""Errors of the kinds and radii of fitted curves, against true curves of known kinds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.curves3d import ARC, ELLIPTIC_ARC, LINE, SPLINE, Curves3D
from colmap_edges.evaluation.metrics.curves import sample_segments
from colmap_edges.evaluation.metrics.statistics import Record
from colmap_edges.evaluation.readers.arrays import read_arrays
from colmap_edges.evaluation.readers.curves import Curves

# An arc is right if the true curve is a circle: gaps are not errors of kind.
FAMILIES = np.array([LINE, ARC, ARC, ELLIPTIC_ARC, ELLIPTIC_ARC, SPLINE])


@dataclass(frozen=True, kw_only=True)
class TrueCurves:
    """True curves by kind.

    Attributes:
        points: (N, 3) samples.
        curves: (N,) curve of each.
        kinds: (C,) index into `KINDS`.
        radii: (C, 2) larger and smaller radius; NaN for lines and splines.
    """

    points: FloatArray
    curves: IntArray
    kinds: IntArray
    radii: FloatArray


def true_curves(path: Path, spacing: float) -> TrueCurves | None:
    """Read true curves of an .npz with `points`, `edges`, `curves`, `kinds` and `radii`.

    Args:
        path: the file, as scripts/make_scene.py writes it.
        spacing: largest distance between samples along a curve.

    Returns:
        The curves; None if the file holds none, or not their kinds.
    """
    data = read_arrays(path) if path.suffix == ".npz" else {}
    if not {"points", "edges", "curves", "kinds", "radii"} <= set(data):
        return None
    samples = sample_segments(Curves(points=data["points"], segments=data["edges"]), spacing)
    if not len(samples.points):
        return None
    return TrueCurves(
        points=samples.points,
        curves=data["curves"][samples.segments],
        kinds=data["kinds"],
        radii=data["radii"],
    )


def compare_kinds(result: Curves3D, true: TrueCurves, threshold: float) -> Record:
    """Compare kinds and radii of curves with the true curves nearest to their samples.

    Args:
        result: Curves as fitted.
        true: Samples of the true curves, at least one, closer than the threshold.
        threshold: Distance within which a sample lies on a true curve, world units; there are five
            samples of the result in it.

    Returns:
        The number `num_true` of true curves with at least one sample of the result on them; that
        of the result's curves on true ones, `num_found` (arcs that are stated to be one curve
        count once), and their ratio `times_found`. The share `on_true` of the result's length
        within the threshold of a true curve; the share of that length whose kind is that of the
        true curve (`right_kind`; arcs count for circles). The share of the length of round curves
        of the right kind whose radii are within 1 % (`right_radius`), and the median by length of
        their relative errors of the radius (`median_radius_error`).
    """
    points, owners = result.sampled(threshold / 5)
    counts = np.bincount(owners, minlength=result.num_curves)
    weights = result.lengths()[owners] / counts[owners]
    distances, nearest = cKDTree(true.points).query(points)
    near = distances < threshold
    of = true.curves[nearest]
    right = FAMILIES[result.kinds[owners]] == FAMILIES[true.kinds[of]]
    errors, lengths = radius_errors(result, true, owners[near], of[near], weights[near])
    num_true = len(np.unique(of[near]))
    on_true = np.bincount(owners[near], minlength=result.num_curves) > counts / 2
    num_found = len(np.unique(result.arc_groups[on_true]))
    total = max(float(weights[near].sum()), 1e-300)
    return {
        "num_true": num_true,
        "num_found": num_found,
        "times_found": num_found / max(num_true, 1),
        "right_kind": float((weights * right)[near].sum() / total),
        "right_radius": float(lengths[errors <= 0.01].sum() / max(lengths.sum(), 1e-300)),
        "median_radius_error": weighted_median(errors, lengths),
        "on_true": float(total / max(weights.sum(), 1e-300)),
    }


def radius_errors(
    result: Curves3D, true: TrueCurves, owners: IntArray, of: IntArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Largest relative errors of the radii of round curves of the right kind, and their lengths.

    Samples belong to the (n,) curves `owners`, lie on the true curves `of`, and represent lengths.
    Curves with less than half of their samples on the true curve are left out.
    """
    lengths = np.bincount(owners, weights, result.num_curves)
    errors, kept = [], []
    round_ = np.isfinite(result.radii[:, 0]) & (lengths > 0)
    for curve in np.flatnonzero(round_).tolist():
        rows = owners == curve
        shares = np.bincount(of[rows], weights[rows])
        best = int(np.argmax(shares))
        same = FAMILIES[result.kinds[curve]] == FAMILIES[true.kinds[best]]
        if same and shares[best] >= 0.5 * lengths[curve]:
            errors.append(np.abs(result.radii[curve] / true.radii[best] - 1).max())
            kept.append(lengths[curve])
    return np.array(errors), np.array(kept)


def weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """The value below which half of the weight is; NaN without values."""
    if not len(values):
        return float("nan")
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, below[-1] / 2)])
