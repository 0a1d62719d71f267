"""Filtering of the traced curves of all views: uncertain, accidental and occluded ones, contours.

(paper: Visibility refinement and outliers filtering)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    offsets_of,
    owners_of,
    runs_of,
)
from colmap_edges.core.observations import ChainObservations
from colmap_edges.edges3d.chains.contours import Seen, are_fixed, scatter_of
from colmap_edges.edges3d.chains.occlusion import find_hidden
from colmap_edges.edges3d.chains.traced_curves import TracedCurves
from colmap_edges.options import TracingOptions


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Maximum uncertainty, residuals and probability of accidental observations of a curve.

    Attributes:
        uncertainty_px: a point's standard deviation along the reference view's ray, in pixels.
        residual_px: mean residual of the observations of a piece.
        log_chance: log10 of the probability of a piece with accidental observations only.
    """

    uncertainty_px: float
    residual_px: float
    log_chance: float


@dataclass(frozen=True, kw_only=True)
class FilteredCurves:
    """The kept curves, separated into edges and contours.

    Attributes:
        edges: by reference view, pieces whose observations fit one fixed 3D curve.
        contours: by reference view, pieces whose observations fit no fixed 3D curve.
        limits: the limits of this decision.
    """

    edges: list[TracedCurves]
    contours: list[TracedCurves]
    limits: Limits


def filter_curves(
    model: Model,
    traced: list[TracedCurves],
    options: TracingOptions,
    num_threads: int,
    limits: Limits | None = None,
) -> tuple[FilteredCurves, dict[str, Any]]:
    """Filter observations, points and pieces, and separate edges from contours.

    Args:
        model: the views and the SfM points; SfM and edge points occlude edge points.
        traced: the curves of every reference view.
        options: ratios of the limits to the scene's medians.
        num_threads: threads to use; the result does not depend on it.
        limits: limits to use instead of those of the scene.

    Returns:
        The kept pieces, and counts of dropped ones by reason.
    """
    traced, hidden = without_hidden(model, traced, options, num_threads)
    limits = limits or find_limits(traced, options)
    sure, stats = sure_points(traced, limits, options)
    kept, start = FilteredCurves(edges=[], contours=[], limits=limits), 0
    for each in traced:
        end = start + len(each.points)
        fixed, moving = filter_pieces(each, sure[start:end], limits, options)
        kept.edges.append(fixed)
        kept.contours.append(moving)
        start = end
    num_points, num_contour_points = (
        sum(len(t.points) for t in of) for of in (kept.edges, kept.contours)
    )
    stats |= {
        "observations_hidden": hidden,
        "points_dropped_chance": int(sure.sum()) - num_points - num_contour_points,
        "points_of_curves": num_points + num_contour_points,
    }
    return kept, stats


def without_hidden(
    model: Model, traced: list[TracedCurves], options: TracingOptions, num_threads: int
) -> tuple[list[TracedCurves], int]:
    """The curves without observations of occluded points, and how many were removed."""
    if not traced or options.occlusion_radius_px == 0:
        return traced, 0
    observed = ChainObservations.concatenated([t.observations for t in traced])
    curves = offsets_of(np.array([len(t.offsets) - 1 for t in traced]))
    hidden = find_hidden(
        model,
        np.concatenate([t.points for t in traced]),
        np.concatenate([t.sigmas for t in traced]),
        np.concatenate([owners_of(t.offsets) + curves[i] for i, t in enumerate(traced)]),
        observed.points,
        observed.views,
        options.occlusion_radius_px,
        num_threads,
    )
    parts = np.split(~hidden, np.cumsum([len(t.observations.views) for t in traced])[:-1])
    kept = [
        replace(t, observations=t.observations.keep(seen))
        for t, seen in zip(traced, parts, strict=True)
    ]
    return kept, int(hidden.sum())


def find_limits(traced: list[TracedCurves], options: TracingOptions) -> Limits:
    """Compute the limits from the medians over all points with enough observations.

    The median residual is taken over observations, not points: scenes of smooth bodies may have as
    many points on contours as on edges, but more views observe edges.
    """
    enough, uncertain = measures_of(traced, options)
    uncertainty_px = options.max_sigma_ratio * median_of(uncertain[enough])
    sure = enough & (uncertain <= uncertainty_px)
    scatter, spare = scatter_of_points(traced)
    typical = median_of(np.repeat(scatter[sure], spare[sure]))
    return Limits(
        uncertainty_px=uncertainty_px,
        residual_px=max(options.min_residual_px, options.max_residual_ratio * typical),
        log_chance=chance_limit(traced, options),
    )


def chance_limit(traced: list[TracedCurves], options: TracingOptions) -> float:
    """log10 of the threshold of the a-contrario test, for `max_false_edges` false pieces."""
    # A chain has about 30 independent depths, the tests of the a-contrario model.
    tests = 30 * sum(len(t.offsets) - 1 for t in traced)
    return float(np.log10(options.max_false_edges / max(tests, 1)))


def lasting_points(
    traced: TracedCurves, options: TracingOptions, limits: Limits | None
) -> BoolArray:
    """(N,) whether points of one reference view have enough observations and pass the test.

    If `limits` are given, also whether their pieces are edges and not contours.
    """
    enough = traced.observations.counts >= options.min_observations
    log_chance = chance_limit([traced], options)
    pieces, lasting = find_pieces(traced, enough, log_chance, options)
    if limits is not None:
        lasting &= are_fixed(traced, pieces, limits.residual_px, options)
    return enough & lasting[pieces]


def sure_points(
    traced: list[TracedCurves], limits: Limits, options: TracingOptions
) -> tuple[BoolArray, dict[str, Any]]:
    """Select points with enough observations and a small enough standard deviation.

    Returns:
        (N,) whether each point of `traced` is kept, and counts of points in and dropped by reason.
    """
    enough, uncertain = measures_of(traced, options)
    sure = enough & (uncertain <= limits.uncertainty_px)
    return sure, {
        "points_traced": len(enough),
        "points_observed_enough": int(enough.sum()),
        "points_dropped_few_observations": int((~enough).sum()),
        "points_dropped_uncertain": int((enough & ~sure).sum()),
    }


def measures_of(
    traced: list[TracedCurves], options: TracingOptions
) -> tuple[BoolArray, FloatArray]:
    """(N,) whether points have enough observations, (N,) their uncertainties."""
    counts = np.concatenate([np.zeros(0, int), *(t.observations.counts for t in traced)])
    uncertain = np.concatenate([np.zeros(0), *(t.uncertainties for t in traced)])
    return counts >= options.min_observations, uncertain


def median_of(values: FloatArray) -> float:
    """The median; 0 for empty arrays."""
    return float(np.median(values)) if len(values) else 0.0


def scatter_of_points(traced: list[TracedCurves]) -> tuple[FloatArray, IntArray]:
    """(N,) mean residual of all points in pixels, and (N,) its number of observations."""
    scatter = [
        scatter_of(seen, np.abs(seen.residuals))
        for seen in (Seen.of(each, np.arange(len(each.points))) for each in traced)
    ]
    spare = [np.maximum(t.observations.counts - 2, 0) for t in traced]
    return np.concatenate([np.zeros(0), *scatter]), np.concatenate([np.zeros(0, np.int64), *spare])


def filter_pieces(
    traced: TracedCurves, keep: BoolArray, limits: Limits, options: TracingOptions
) -> tuple[TracedCurves, TracedCurves]:
    """Split curves at dropped points; drop short pieces and those that fail the a-contrario test.

    Returns:
        The edges, and the view-dependent contours: pieces whose observations fit no fixed curve,
        such as silhouettes of smooth bodies and reflections.
    """
    pieces, good = find_pieces(traced, keep, limits.log_chance, options)
    return separated(traced, pieces, keep & good[pieces], limits.residual_px, options)


def filter_remains(
    traced: TracedCurves, limits: Limits, options: TracingOptions
) -> tuple[TracedCurves, TracedCurves]:
    """Split the remainders of pieces at points with too few observations.

    The relative standard deviation of the mean residual of n points is taken as 1 / sqrt(n).

    Returns:
        The edges, and the view-dependent contours.
    """
    keep = traced.observations.counts >= options.min_observations
    keep &= traced.uncertainties <= limits.uncertainty_px
    pieces, long = find_pieces(traced, keep, np.inf, options)
    limits_px = limits.residual_px * (1 + 1 / np.sqrt(np.bincount(pieces)))
    return separated(traced, pieces, keep & long[pieces], limits_px, options)


def separated(
    traced: TracedCurves,
    pieces: IntArray,
    keep: BoolArray,
    limits_px: FloatArray | float,
    options: TracingOptions,
) -> tuple[TracedCurves, TracedCurves]:
    """The kept ones of (N,) points as edges and as contours, by what their pieces are."""
    fixed = are_fixed(traced, pieces, limits_px, options)[pieces]
    return chosen(traced, pieces, keep & fixed), chosen(traced, pieces, keep & ~fixed)


def find_pieces(
    traced: TracedCurves, keep: BoolArray, log_chance: float, options: TracingOptions
) -> tuple[IntArray, BoolArray]:
    """Split curves at dropped points.

    Returns:
        (N,) piece of each point, and for each piece whether it is long enough and passes the
        a-contrario test, i.e. its log10 probability is at most `log_chance`.
    """
    pieces = runs_of(owners_of(traced.offsets), keep)
    sizes = np.bincount(pieces)
    # Points less than 16 px apart are not independent evidence.
    share = min(1.0, options.curve_step_points / 16)
    logs = share * np.bincount(pieces, weights=traced.log_chances, minlength=len(sizes))
    return pieces, (sizes >= options.min_curve_points) & (logs <= log_chance)


def chosen(traced: TracedCurves, pieces: IntArray, keep: BoolArray) -> TracedCurves:
    """The points where `keep` is true, as curves of their (N,) pieces."""
    lengths = np.unique(pieces[keep], return_counts=True)[1]
    points = np.flatnonzero(keep)
    return TracedCurves(
        points=traced.points[keep],
        sigmas=traced.sigmas[keep],
        uncertainties=traced.uncertainties[keep],
        log_chances=traced.log_chances[keep],
        offsets=offsets_of(lengths),
        reference=traced.reference,
        observations=traced.observations.select(points),
    )
