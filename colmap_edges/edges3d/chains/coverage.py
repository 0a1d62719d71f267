"""Bookkeeping of the stretches of chains that have a 3D edge; later rounds use the rest.

Since few chains remain, later rounds require less agreement between views for a depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, IntArray, long_runs, owners_of
from colmap_edges.core.observations import ChainObservations, Kind
from colmap_edges.edges3d.chains.filtering import FilteredCurves, chosen, find_pieces
from colmap_edges.edges3d.chains.traced_curves import TracedCurves
from colmap_edges.edges3d.chains.tracing_input import (
    ByView,
    TracingInput,
    remaining,
)
from colmap_edges.options import TracingOptions


def nothing_covered(offsets: ByView[IntArray]) -> list[BoolArray]:
    """Per view (P,) bool, all false, for the points of its polylines with these offsets."""
    return [np.zeros(offsets[view][-1], bool) for view in range(len(offsets))]


def what_remains(
    whole: TracingInput, kept: FilteredCurves, options: TracingOptions
) -> TracingInput:
    """The input of a later round: the stretches of chains without a 3D edge.

    Contours cover nothing: they move over the surface and so cross chains of nearby edges.
    """
    covered = nothing_covered(whole.polyline_offsets)
    for traced in kept.edges:
        mark_covered(
            covered, whole.polyline_offsets, traced.observations, options.curve_step_points
        )
    least = options.min_curve_points * options.curve_step_points // 2
    free = [
        long_runs(~each, least, owners_of(whole.polyline_offsets[view]))
        for view, each in enumerate(covered)
    ]
    return remaining(whole, free)


def without_repeats(
    whole: TracingInput, kept: FilteredCurves, options: TracingOptions
) -> tuple[FilteredCurves, dict[str, int]]:
    """Keep each stretch of a chain in its first contour only; also returns counts.

    Contours do not cover chains, so that further reference views trace them again.
    """
    covered = nothing_covered(whole.polyline_offsets)
    firsts = []
    for contours in kept.contours:
        # Contours lie on the reference view's chains, unless they are occluded there.
        own = contours.observations.keep(contours.observations.views == contours.reference)
        free = np.ones(len(contours.points), bool)
        free[own.points] = ~covered[contours.reference][own.positions.astype(np.int64)]
        pieces, lasting = find_pieces(contours, free, np.inf, options)
        first = chosen(contours, pieces, free & lasting[pieces])
        mark_covered(covered, whole.polyline_offsets, first.observations, options.curve_step_points)
        firsts.append(first)
    left, all_found = (sum(len(t.points) for t in of) for of in (firsts, kept.contours))
    counts = {"points_of_contours": left, "points_dropped_repeated": all_found - left}
    return replace(kept, contours=firsts), counts


def in_whole_graphs(given: TracingInput, traced: list[TracedCurves]) -> list[TracedCurves]:
    """Convert positions of curves from the remaining parts of graphs to the whole graphs."""
    if given.free is None:
        return traced
    points = [np.flatnonzero(free) for free in given.free]
    return [
        replace(each, observations=among_all_points(each.observations, points)) for each in traced
    ]


def mark_covered(
    covered: ByView[BoolArray],
    offsets: ByView[IntArray],
    observed: ChainObservations,
    reach: int,
) -> None:
    """Mark the stretches of chains that points of curves are observed on, in every view.

    Args:
        covered: per view (P,) bool of its points; changed in place.
        offsets: per view the offsets of its polylines.
        observed: the observations of the curves.
        reach: number of points marked on both sides of an observation.
    """
    steps = np.arange(-reach, reach + 1)[:, None]
    for view, rows in observed.by_view():
        at = observed.positions[rows].astype(np.int64)
        polyline = np.searchsorted(offsets[view], at, "right") - 1
        first, last = offsets[view][polyline], offsets[view][polyline + 1] - 1
        covered[view][np.minimum(np.maximum(at + steps, first), last)] = True


def among_all_points(observed: Kind, points: Sequence[IntArray]) -> Kind:
    """Convert positions from indices into selected points of each view to indices into all points.

    Args:
        observed: the observations.
        points: per view the indices of the selected points, ascending.
    """
    positions = observed.positions.copy()
    for view, rows in observed.by_view():
        low = positions[rows].astype(np.int64)
        positions[rows] += points[view][low] - low
    return replace(observed, positions=positions)
