"""Separation of the traced curves of all views into edges and view-dependent contours.

(paper: Visibility refinement and outliers filtering)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of, owners_of
from colmap_edges.core.observations import ChainObservations
from colmap_edges.edges3d.chains.occlusion import find_hidden
from colmap_edges.options import TracingOptions

TESTS_PER_CURVE = 30  # number of independent depths of a chain (tests of the a-contrario model)
INDEPENDENT_PX = 16  # distance along a chain beyond which observations are independent


@dataclass(frozen=True, kw_only=True)
class Traced:
    """Curves of one reference with their observations.

    Attributes:
        points: (N, 3) world points.
        sigmas: (N,) standard deviation along the reference view's ray, world units.
        offsets: (E + 1,) CSR of the points by curve.
        reference: the view on whose chains they are.
        observations: where they are observed on the views' chains, the reference view's first.
        uncertainties: (N,) the same standard deviation in pixels of the reference.
        residuals: (N,) mean distance to the other views' chains that observe it, in pixels.
        log_chances: (N,) log10 of the chance of as many observations.
    """

    points: FloatArray
    sigmas: FloatArray
    uncertainties: FloatArray
    residuals: FloatArray
    log_chances: FloatArray
    offsets: IntArray
    reference: int
    observations: ChainObservations


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The largest uncertainty, residual and chance that a curve may have.

    Attributes:
        uncertainty_px: a point's standard deviation along the reference view's ray, in pixels.
        residual_px: the scatter of a piece's observations.
        log_chance: log10 of the chance of a piece.
    """

    uncertainty_px: float
    residual_px: float
    log_chance: float


@dataclass(frozen=True, kw_only=True)
class Sorted:
    """The traced curves that are kept, edges and contours apart.

    Attributes:
        edges: pieces of every reference view's curves that lie still.
        contours: view-dependent contours: those that scatter around any fixed curve.
        limits: what they were judged by.
    """

    edges: list[Traced]
    contours: list[Traced]
    limits: Limits


def sort_out(
    model: Model,
    traced: list[Traced],
    options: TracingOptions,
    num_threads: int,
    limits: Limits | None = None,
) -> tuple[Sorted, dict[str, Any]]:
    """Filter observations, points and pieces, and separate edges from contours.

    Args:
        model: the views, and SfM points, which hide edge points as these hide each other.
        traced: the curves of every reference.
        options: ratios to the scene's own medians, which make the limits.
        num_threads: threads to use; the result does not depend on it.
        limits: those to take instead.

    Returns:
        The pieces that are kept, and counts of what was dropped by reason.
    """
    traced, hidden = without_hidden(model, traced, options, num_threads)
    limits = limits or find_limits(traced, options)
    sure, stats = sure_points(traced, limits, options)
    kept, start = Sorted(edges=[], contours=[], limits=limits), 0
    for each in traced:
        end = start + len(each.points)
        fixed, moving = sort_pieces(each, sure[start:end], limits, options)
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
    model: Model, traced: list[Traced], options: TracingOptions, num_threads: int
) -> tuple[list[Traced], int]:
    """The curves without observations of occluded points, and the number of these."""
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


def find_limits(traced: list[Traced], options: TracingOptions) -> Limits:
    """Compute the limits from the medians over all points with enough observations.

    The median of scatter is that of observations: many views observe edges, few the many places
    of contours, of which scenes of smooth bodies may have as many points.
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


def chance_limit(traced: list[Traced], options: TracingOptions) -> float:
    """log10 of the chance that a piece may have, so that few of these curves are chance's."""
    tests = TESTS_PER_CURVE * sum(len(t.offsets) - 1 for t in traced)
    return float(np.log10(options.max_false_edges / max(tests, 1)))


def lasting_points(traced: Traced, options: TracingOptions, limits: Limits | None) -> BoolArray:
    """(N,) which points of one reference are observed enough, on pieces that chance did not make.

    Where `limits` are known these are pieces of edges, not of contours.
    """
    enough = traced.observations.counts >= options.min_observations
    log_chance = chance_limit([traced], options)
    pieces, lasting = find_pieces(traced, enough, log_chance, options)
    if limits is not None:
        lasting &= scatter_of(traced, pieces) <= limits.residual_px
    return enough & lasting[pieces]


def sure_points(
    traced: list[Traced], limits: Limits, options: TracingOptions
) -> tuple[BoolArray, dict[str, Any]]:
    """Which points, in the order of `traced`, are observed enough and certain enough.

    Returns:
        (N,) whether a point is, and counts of points in and dropped by reason.
    """
    enough, uncertain = measures_of(traced, options)
    sure = enough & (uncertain <= limits.uncertainty_px)
    return sure, {
        "points_traced": len(enough),
        "points_observed_enough": int(enough.sum()),
        "points_dropped_few_observations": int((~enough).sum()),
        "points_dropped_uncertain": int((enough & ~sure).sum()),
    }


def measures_of(traced: list[Traced], options: TracingOptions) -> tuple[BoolArray, FloatArray]:
    """(N,) of all points: whether observed enough, uncertainties."""
    counts = np.concatenate([np.zeros(0, int), *(t.observations.counts for t in traced)])
    uncertain = np.concatenate([np.zeros(0), *(t.uncertainties for t in traced)])
    return counts >= options.min_observations, uncertain


def median_of(values: FloatArray) -> float:
    """The median; 0 of nothing."""
    return float(np.median(values)) if len(values) else 0.0


def scatter_of_points(traced: list[Traced]) -> tuple[FloatArray, IntArray]:
    """(N,) scatter of all points in pixels, and (N,) of how many observations that is."""
    scatter = [scatter_of(t, np.arange(len(t.points))) for t in traced]
    spare = [np.maximum(t.observations.counts - 2, 0) for t in traced]
    return np.concatenate([np.zeros(0), *scatter]), np.concatenate([np.zeros(0, np.int64), *spare])


def scatter_of(traced: Traced, groups: IntArray) -> FloatArray:
    """(G,) mean distance of the observations to the edge, in pixels, for groups of points.

    One of the other views' observations fixes the depth and tells nothing of the scatter.
    (N,) groups from 0 on.
    """
    others = traced.observations.counts - 1
    sums = np.bincount(groups, weights=others * traced.residuals)
    spare = np.bincount(groups, weights=others - 1)
    scatter: FloatArray = sums / np.maximum(spare, 1)
    return scatter


def sort_pieces(
    traced: Traced, keep: BoolArray, limits: Limits, options: TracingOptions
) -> tuple[Traced, Traced]:
    """Split curves where points are dropped; short pieces and those that chance makes go with them.

    Returns:
        The pieces that are edges, and those that scatter around any fixed curve: what moves over a
        body from view to view, as its silhouette and reflections do.
    """
    pieces, good = find_pieces(traced, keep, limits.log_chance, options)
    fixed = scatter_of(traced, pieces) <= limits.residual_px
    return (
        chosen(traced, pieces, keep & (good & fixed)[pieces]),
        chosen(traced, pieces, keep & (good & ~fixed)[pieces]),
    )


def sort_remains(traced: Traced, limits: Limits, options: TracingOptions) -> tuple[Traced, Traced]:
    """Split what is left of pieces where points are observed too little.

    The scatter of few points is known to one over the square root of their number of itself.

    Returns:
        The pieces that are edges, and those that scatter around any fixed curve.
    """
    keep = traced.observations.counts >= options.min_observations
    keep &= traced.uncertainties <= limits.uncertainty_px
    pieces, long = find_pieces(traced, keep, np.inf, options)
    sizes = np.bincount(pieces)
    fixed = scatter_of(traced, pieces) <= limits.residual_px * (1 + 1 / np.sqrt(sizes))
    return (
        chosen(traced, pieces, keep & (long & fixed)[pieces]),
        chosen(traced, pieces, keep & (long & ~fixed)[pieces]),
    )


def find_pieces(
    traced: Traced, keep: BoolArray, log_chance: float, options: TracingOptions
) -> tuple[IntArray, BoolArray]:
    """Split curves where points are dropped.

    Returns:
        (N,) piece of each point, and of each piece whether it is long enough and no likelier by
        chance than 10 to the power of `log_chance`.
    """
    ids = owners_of(traced.offsets)
    broken = np.ones(len(ids), bool)
    broken[1:] = (np.diff(ids) != 0) | (keep[1:] != keep[:-1])
    pieces = np.cumsum(broken) - 1
    sizes = np.bincount(pieces) if len(pieces) else np.zeros(0, np.int64)
    # Points nearer to each other than that are not independent evidence.
    share = min(1.0, options.curve_step_points / INDEPENDENT_PX)
    logs = share * np.bincount(pieces, weights=traced.log_chances, minlength=len(sizes))
    return pieces, (sizes >= options.min_curve_points) & (logs <= log_chance)


def chosen(traced: Traced, pieces: IntArray, keep: BoolArray) -> Traced:
    """The points where `keep` is true, as curves of their (N,) pieces."""
    lengths = np.unique(pieces[keep], return_counts=True)[1]
    return Traced(
        points=traced.points[keep],
        sigmas=traced.sigmas[keep],
        uncertainties=traced.uncertainties[keep],
        residuals=traced.residuals[keep],
        log_chances=traced.log_chances[keep],
        offsets=offsets_of(lengths),
        reference=traced.reference,
        observations=traced.observations.select(np.flatnonzero(keep)),
    )
