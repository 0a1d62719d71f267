"""Which stretches of chains edges run through, and what remains for later rounds.

Among the few chains that remain less agreement tells a depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from colmap_edges.core.arrays import BoolArray, IntArray, owners_of, ranges_of
from colmap_edges.edges3d.chains.filtering import Sorted, Traced, chosen, find_pieces
from colmap_edges.edges3d.chains.tracing_input import (
    ByView,
    TracingInput,
    remaining,
)
from colmap_edges.options import TracingOptions


def nothing_covered(offsets: ByView[IntArray]) -> list[BoolArray]:
    """Per view, by the offsets of its polylines, its points, none of them marked."""
    return [np.zeros(offsets[view][-1], bool) for view in range(len(offsets))]


def what_remains(whole: TracingInput, kept: Sorted, options: TracingOptions) -> TracingInput:
    """The scene of those stretches of chains that no edge runs through.

    Outlines take nothing: moving over a body they cross chains of edges beside it.
    """
    covered = nothing_covered(whole.polyline_offsets)
    for traced in kept.edges:
        mark_covered(
            covered,
            whole.polyline_offsets,
            traced.views,
            traced.positions,
            options.point_spacing_px,
        )
    least = options.min_curve_points * options.point_spacing_px // 2
    free = [
        without_short(~each, whole.polyline_offsets[view], least)
        for view, each in enumerate(covered)
    ]
    return remaining(whole, free)


def without_repeats(
    whole: TracingInput, kept: Sorted, options: TracingOptions
) -> tuple[Sorted, dict[str, int]]:
    """The same with each stretch of a chain in one outline, its first, and counts.

    Outlines take nothing of what remains, so that other views find them again.
    """
    covered = nothing_covered(whole.polyline_offsets)
    firsts = []
    for outlines in kept.outlines:
        own = outlines.positions[:, [0]]  # on the driver's chains, unless something hides it there
        free = np.ones(len(outlines.points), bool)
        free[owners_of(own.indptr)] = ~covered[outlines.views[0]][own.data.astype(np.int64)]
        pieces, lasting = find_pieces(outlines, free, np.inf, options)
        first = chosen(outlines, pieces, free & lasting[pieces])
        mark_covered(
            covered,
            whole.polyline_offsets,
            first.views,
            first.positions,
            options.point_spacing_px,
        )
        firsts.append(first)
    left, all_found = (sum(len(t.points) for t in of) for of in (firsts, kept.outlines))
    counts = {"points_of_outlines": left, "points_dropped_repeated": all_found - left}
    return replace(kept, outlines=firsts), counts


def in_whole_graphs(scene: TracingInput, traced: list[Traced]) -> list[Traced]:
    """Curves at positions on the scene's graphs -> the same at positions on the whole graphs."""
    if scene.free is None:
        return traced
    points = [np.flatnonzero(free) for free in scene.free]
    return [
        replace(each, positions=positions_among_all(each.positions, each.views, points))
        for each in traced
    ]


def mark_covered(
    covered: ByView[BoolArray],
    offsets: ByView[IntArray],
    views: IntArray,
    positions: csr_array,
    reach: int,
) -> None:
    """Mark the stretches of chains that points of curves are observed on, in every view.

    Args:
        covered: per view its points, to be marked.
        offsets: per view those of its polylines.
        views: (K,) view of each column of `positions`.
        positions: (N, K) sparse positions on the views' chains.
        reach: points to both sides of an observation.
    """
    observed = positions.tocsc()
    for column, view in enumerate(views):
        first, last = observed.indptr[column : column + 2]
        at = observed.data[first:last].astype(np.int64)
        polyline = np.searchsorted(offsets[view], at, "right") - 1
        low = np.maximum(at - reach, offsets[view][polyline])
        high = np.minimum(at + reach + 1, offsets[view][polyline + 1])
        covered[view][ranges_of(low, high)] = True


def without_short(free: BoolArray, offsets: IntArray, least: int) -> BoolArray:
    """(N,) the points of `free` in runs of at least so many along one polyline."""
    begins = np.zeros(len(free), np.int64)
    begins[1:] = (np.diff(owners_of(offsets)) != 0) | (free[1:] != free[:-1])
    runs = np.cumsum(begins)
    kept: BoolArray = free & (np.bincount(runs)[runs] >= least)
    return kept


def positions_among_all(
    positions: csr_array, views: IntArray, points: Sequence[IntArray]
) -> csr_array:
    """Positions counted among some points of each view -> the same counted among all of them.

    Args:
        positions: (N, K) sparse.
        views: (K,) view of each column.
        points: per view the places of those some, ascending.
    """
    data = positions.data.copy()
    for column, view in enumerate(views):
        rows = positions.indices == column
        low = data[rows].astype(np.int64)
        data[rows] += points[view][low] - low
    return csr_array((data, positions.indices, positions.indptr), shape=positions.shape)
