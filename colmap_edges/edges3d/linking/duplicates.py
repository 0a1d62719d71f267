"""Classification of parallel pieces of curves: duplicates of one edge, or neighbouring edges.

An edge is traced once for each pair of intensities on its two sides, since views with different
intensities are not matched, and again where light or blur displaced it. The distance of two pieces
does not separate duplicates from neighbours, but observations do: views that resolve neighbours
observe both at different positions, and duplicates at one position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    Table,
    blocks,
    grown,
    joined_lists,
    long_runs,
    order_of,
    owners_of,
    ranks_of,
)
from colmap_edges.core.observations import ChainObservations
from colmap_edges.core.polylines import curve_tangents, unit
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_index import IndexedGraphs
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.executors import in_threads

MAX_OFFSET_PX = 6.0  # maximum displacement of an edge in an image by light and blur


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """Pieces of curves with their observations.

    Attributes:
        points: (N, 3) world points, piece by piece.
        offsets: (E + 1,) CSR of the points by piece.
        sigmas: (N,) standard deviation of a point, world units.
        observations: positions on chains that observe the N points.
        views: the views of the model.
    """

    points: FloatArray
    offsets: IntArray
    sigmas: FloatArray
    observations: ChainObservations
    views: Sequence[View]

    @cached_property
    def ids(self) -> IntArray:
        """(N,) piece of each point."""
        return owners_of(self.offsets)

    @cached_property
    def tangents(self) -> FloatArray:
        """(N, 3) unit directions along the pieces."""
        return unit(curve_tangents(self.points, self.offsets))

    @cached_property
    def spacings(self) -> FloatArray:
        """(N,) distance to the next point of the piece; of its last point, to the previous one."""
        apart = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        apart[np.diff(self.ids) != 0] = 0
        return np.asarray(np.maximum(np.append(apart, 0), np.append(0, apart)), np.float64)

    @cached_property
    def pixel_sizes(self) -> FloatArray:
        """(N,) size of a pixel at the point in the nearest view that observes it, world units."""
        sizes = np.full(len(self.points), np.inf)
        for index, rows in self.observations.by_view():
            view, points = self.views[index], self.observations.points[rows]
            depths = view.cam_from_world(self.points[points])[:, 2]
            sizes[points] = np.minimum(sizes[points], depths / view.focal_px)
        return np.where(np.isfinite(sizes), sizes, 0)


@dataclass(frozen=True, kw_only=True)
class Matches(Table):
    """Pairs of points of parallel pieces.

    Attributes:
        points: (M,) indices of the points.
        others: (M,) index of the nearest point of another piece.
        offsets: (M, 3) vector from the point to the other piece, perpendicular to it.
    """

    points: IntArray
    others: IntArray
    offsets: FloatArray


@dataclass(frozen=True, kw_only=True)
class Merging:
    """Points that are kept, and the observations that they take over.

    Attributes:
        kept: (N,) whether a point is kept; the others are duplicates.
        takers: (K,) indices of kept points that take over observations.
        givers: (K,) indices of the duplicates whose observations they take over.
    """

    kept: BoolArray
    takers: IntArray
    givers: IntArray


def merge_pieces(
    pieces: Pieces, given: IndexedGraphs, options: PipelineOptions, num_threads: int
) -> Merging:
    """Separate duplicates from neighbouring edges, and choose the points to keep of duplicates.

    Args:
        pieces: pieces of curves with their observations.
        given: the edge graphs of all views.
        options: noise, search radius of observations, probability of observing an edge.
        num_threads: threads to use; the result does not depend on it.
    """
    matches = find_matches(pieces, num_threads)
    pairs = pairs_of(pieces, matches)
    ratios = log_ratios(pieces, matches, pairs, given, options, num_threads)
    same = ratios[pairs] <= 0
    matches, pairs = matches.select(same), pairs[same]
    offset, scale = offsets_in_pixels(pieces, matches, options)
    apart = mean_of(pairs, offset / scale)[pairs] > OUTLIER_SIGMAS
    displaced = weaker_points(pieces, matches.select(apart), pairs[apart])
    return keep_best(pieces, displaced, matches.select(~apart), options.tracing.min_curve_points)


def pairs_of(pieces: Pieces, matches: Matches) -> IntArray:
    """(M,) index of the pair of pieces of each match."""
    ids = np.sort(pieces.ids[np.column_stack([matches.points, matches.others])], axis=1)
    keys = ids[:, 0] * len(pieces.offsets) + ids[:, 1]
    return np.asarray(np.unique(keys, return_inverse=True)[1], np.int64)


def mean_of(groups: IntArray, values: FloatArray) -> FloatArray:
    """(G,) means of (M,) values by group."""
    return np.asarray(np.bincount(groups, values) / np.maximum(np.bincount(groups), 1))


def offsets_in_pixels(
    pieces: Pieces, matches: Matches, options: PipelineOptions
) -> tuple[FloatArray, FloatArray]:
    """(M,) distances between the pieces and (M,) their standard deviations, in pixels."""
    size = pieces.pixel_sizes[matches.points]
    offset = np.linalg.norm(matches.offsets, axis=1) / size
    known = np.hypot(pieces.sigmas[matches.points], pieces.sigmas[matches.others]) / size
    return offset, np.hypot(np.sqrt(2) * options.refinement.noise_px, known)


def weaker_points(pieces: Pieces, matches: Matches, pairs: IntArray) -> BoolArray:
    """(N,) whether a point is of a displaced duplicate: fewer views observe it than the other."""
    counts = pieces.observations.counts
    first = pieces.ids[matches.points] < pieces.ids[matches.others]
    # Per pair, the numbers of observations of both pieces along their common stretch.
    lower = np.where(first, counts[matches.points], counts[matches.others])
    upper = np.where(first, counts[matches.others], counts[matches.points])
    gain = mean_of(pairs, lower) / np.maximum(mean_of(pairs, upper), 1e-9)
    ratio = np.where(first, gain[pairs], 1 / np.maximum(gain[pairs], 1e-9))
    weaker = np.zeros(len(pieces.points), bool)
    weaker[matches.points[ratio <= 1]] = True
    return weaker


def nearest_of_pieces(
    pieces: Pieces, reach: FloatArray, num_threads: int
) -> tuple[IntArray, IntArray]:
    """Pairs of points and the nearest point of each other piece within (N,) `reach` of them."""
    tree, found = cKDTree(pieces.points), [np.zeros((2, 0), np.int64)]
    for rows in blocks(len(pieces.points), 1 << 11):
        lists = tree.query_ball_point(pieces.points[rows], reach[rows], workers=num_threads)
        a, b = joined_lists(lists)
        a += rows.start
        others = pieces.ids[a] != pieces.ids[b]
        a, b = a[others], b[others]
        away = pieces.points[b] - pieces.points[a]
        order = np.lexsort((np.einsum("ij,ij->i", away, away), pieces.ids[b], a))
        a, b = a[order], b[order]
        nearest = np.ones(len(a), bool)
        nearest[1:] = (np.diff(a) != 0) | (np.diff(pieces.ids[b]) != 0)
        found.append(np.stack([a[nearest], b[nearest]]))
    a, b = np.concatenate(found, axis=1)
    return a, b


def find_matches(pieces: Pieces, num_threads: int) -> Matches:
    """Match points of pieces that are near and parallel."""
    radius = MAX_OFFSET_PX * pieces.pixel_sizes
    a, b = nearest_of_pieces(pieces, np.hypot(radius, pieces.spacings), num_threads)
    away = pieces.points[b] - pieces.points[a]
    along = np.einsum("ij,ij->i", away, pieces.tangents[b])
    across = away - along[:, None] * pieces.tangents[b]
    cosines = np.abs(np.einsum("ij,ij->i", pieces.tangents[a], pieces.tangents[b]))
    parallel = cosines >= np.cos(np.radians(15.0))
    beside = np.abs(along) <= 0.75 * pieces.spacings[b]
    near = np.linalg.norm(across, axis=1) <= radius[a]
    kept = parallel & beside & near
    return Matches(points=a[kept], others=b[kept], offsets=across[kept])


def log_ratios(
    pieces: Pieces,
    matches: Matches,
    pairs: IntArray,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> FloatArray:
    """(P,) log likelihood ratio of two edges against one edge for each pair of pieces."""
    ratios = mean_of(pairs, distance_ratios(pieces, matches, options))
    # Observations are compared at three positions along a pair of pieces.
    sampled = spread(pairs, 3)
    chosen, of = matches.select(sampled), pairs[sampled]
    seen = seen_by(pieces, chosen)
    llr = view_ratios(pieces, chosen, seen, given, options, num_threads)
    # The ratios along two pieces are not independent: their mean counts once per view.
    owners = of[seen.matches]
    for rows in blocks(len(ratios), 1 << 9):
        some = ratios[rows]
        part = slice(*np.searchsorted(owners, (rows.start, rows.stop)))
        keys = (owners[part] - rows.start) * len(pieces.views) + seen.views[part]
        each, place = np.unique(keys, return_inverse=True)
        some += np.bincount(each // len(pieces.views), mean_of(place, llr[part]), len(some))
    return ratios


def spread(groups: IntArray, count: int) -> IntArray:
    """Indices of at most `count` evenly spread rows of each of (M,) groups, group by group."""
    order = np.argsort(groups, kind="stable")
    sizes = np.bincount(groups)
    ranks = ranks_of(sizes)
    own = sizes[groups[order]]
    step = np.maximum(own / count, 1)
    picked = np.floor((ranks + 1) / step) > np.floor(ranks / step)
    return order[picked]


def distance_ratios(pieces: Pieces, matches: Matches, options: PipelineOptions) -> FloatArray:
    """(M,) log likelihood ratio of the offsets: neighbouring edges against duplicates.

    Neighbouring edges have any distance; duplicates, except outliers, are within the noise.
    """
    offset, scale = offsets_in_pixels(pieces, matches, options)
    anywhere = 1 / MAX_OFFSET_PX
    half_normal = np.sqrt(2 / np.pi) / scale * np.exp(-0.5 * (offset / scale) ** 2)
    outliers = 0.1  # share of duplicates that are farther apart than noise explains
    duplicates = (1 - outliers) * half_normal + outliers * anywhere
    return np.asarray(np.log(anywhere / duplicates))


@dataclass(frozen=True, kw_only=True)
class Seen:
    """R pairs of a match and a view that observes at least one of its two points.

    Attributes:
        matches: (R,) the match, ascending.
        views: (R,) the view.
        positions: (R, 2) positions that observe the point and the other; -1 where none.
    """

    matches: Int32Array
    views: Int32Array
    positions: FloatArray


def seen_by(pieces: Pieces, matches: Matches) -> Seen:
    """The views that observe either point of each match."""
    observed, num_views = pieces.observations, len(pieces.views)
    parts = [(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 2)))]
    for some in blocks(len(matches.points), 1 << 11):
        found = []
        for side, of in enumerate((matches.points, matches.others)):
            own = observed.select(of[some])
            keys = own.points * num_views + own.views
            found.append((keys, np.full(len(keys), side), own.positions))
        keys, sides, positions = (np.concatenate(of) for of in zip(*found, strict=True))
        each, place = np.unique(keys, return_inverse=True)
        table = np.full((len(each), 2), -1.0)
        table[place, sides] = positions
        owners, views = np.divmod(each, num_views)
        parts.append(((owners + some.start).astype(np.int32), views.astype(np.int32), table))
    of_matches, of_views, tables = (np.concatenate(of) for of in zip(*parts, strict=True))
    return Seen(matches=of_matches, views=of_views, positions=tables)


def view_ratios(
    pieces: Pieces,
    matches: Matches,
    seen: Seen,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> FloatArray:
    """(R,) log likelihood ratio of a view's observations at a match: two edges against one.

    Two edges are observed as far apart as the pieces project; of one edge, both are observed at
    the same position. If the pieces project to the same position, the ratio is 1.
    """
    radius = options.refinement.max_residual_px
    cosine = float(np.cos(np.radians(options.refinement.max_tangent_angle_deg)))
    noise2 = 2 * options.refinement.noise_px**2
    both, one = seen_ratios(options)
    llr = np.zeros(len(seen.views))
    points = matches.points
    steps = pieces.spacings[points, None] * pieces.tangents[points]
    places = pieces.points[points], matches.offsets, steps
    order = order_of(seen.views, len(pieces.views))

    def compare_in(rows: IntArray) -> None:
        if len(rows) == 0:
            return
        index, of = given.index(int(seen.views[rows[0]])), seen.matches[rows]
        expected, apart = _kernels.separations(
            index, *places, of, seen.positions[rows], radius, cosine, 1
        )
        apart = np.nan_to_num(apart)
        llr[rows] = np.clip(expected * (2 * apart - expected) / (2 * noise2), -one, both)

    parts = np.split(order, np.flatnonzero(np.diff(seen.views[order])) + 1)
    in_threads(compare_in, parts, num_threads)
    return np.nan_to_num(llr, copy=False)


def seen_ratios(options: PipelineOptions) -> tuple[float, float]:
    """Bounds of a view's log likelihood ratios: both edges observed, only one observed."""
    rate = options.chain_depth.visibility_rate * options.chain_depth.detection_rate
    chance = 0.1  # probability that a view observes an edge where there is none
    return float(np.log(rate / chance)), float(np.log((1 - chance) / (1 - rate)))


def keep_best(pieces: Pieces, displaced: BoolArray, same: Matches, min_points: int) -> Merging:
    """Of duplicates, keep the points of the piece with the most observations.

    Args:
        pieces: the pieces.
        displaced: (N,) points of displaced duplicates, which are dropped.
        same: the matches between duplicates, in both directions.
        min_points: minimum length of the remaining runs of a piece.
    """
    count = len(pieces.offsets) - 1
    worth = np.bincount(pieces.ids, pieces.observations.counts, count)
    order = np.argsort(-worth, kind="stable")
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    kept = ~displaced
    begins = np.searchsorted(same.points, pieces.offsets)
    for piece in order.tolist():
        rows = slice(begins[piece], begins[piece + 1])
        points, others = same.points[rows], same.others[rows]
        better = rank[pieces.ids[others]] < rank[piece]
        first, last = pieces.offsets[piece : piece + 2]
        kept[points[better & kept[others]]] = False
        if not kept[first:last].all():
            left = kept[first:last]
            kept[first:last] = long_runs(grown(left) & ~displaced[first:last], min_points)
    gives = ~kept[same.others] & kept[same.points]
    return Merging(kept=kept, takers=same.points[gives], givers=same.others[gives])
