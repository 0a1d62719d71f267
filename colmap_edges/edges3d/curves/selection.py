"""Model selection: which consecutive segments of an edge form one line, arc, ellipse or spline.

Segmentation fits only lines and arcs: it cuts ellipses and splines into rows of arcs, and outliers
split curves. Rows of consecutive segments without a corner are therefore refitted as one curve of
each kind, and the combination of least cost is selected, again by BIC.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, Table, owners_of
from colmap_edges.core.curves3d import ARC, CIRCLE, DEGREE, ELLIPSE, ELLIPTIC_ARC, LINE, SPLINE
from colmap_edges.edges3d.curves.ellipses import fit_ellipses
from colmap_edges.edges3d.curves.lines_and_circles import fit_circles, fit_lines
from colmap_edges.edges3d.curves.noise import NUM_PARAMETERS, Noise
from colmap_edges.edges3d.curves.point_sequences import Fits, PointSequences
from colmap_edges.edges3d.curves.segmentation import NOTHING, Segmentation
from colmap_edges.edges3d.curves.splines import fit_splines, num_parameters

MAX_ROW = 6  # maximum number of segments fitted as one curve
MAX_RADIUS_DOUBT = 0.03  # maximum standard deviation of a radius, relative to the radius
MIN_POINTS = {LINE: 2, ARC: 5, CIRCLE: 8, ELLIPTIC_ARC: 10, ELLIPSE: 10, SPLINE: 10}


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Rows of successive segments that may be one curve.

    Attributes:
        segments: (R, 2) first and last segment.
        whole: (R,) whether the row is a whole closed edge, fitted as a closed curve.
        all_of_edge: (R,) whether the row is a whole edge.
    """

    segments: IntArray
    whole: BoolArray
    all_of_edge: BoolArray


@dataclass(frozen=True, kw_only=True)
class SelectedCurves(Table):
    """Curves of edges, with the ranges of points that they fit.

    Attributes:
        kinds, edges, bounds: (C,), (C,), (C, 2).
        frames, sigmas: (C, 3, 3) and (C, 5) as in `Fits`.
        costs: (C,) costs by which they are selected.
        splines: (C,) objects: `SplineFit` of the splines, else None.
    """

    kinds: IntArray
    edges: IntArray
    bounds: IntArray
    frames: FloatArray
    sigmas: FloatArray
    costs: FloatArray
    splines: Any

    def keep_better(self, rows: IntArray, kind: int, fits: Fits, costs: FloatArray) -> None:
        """Store fits of one kind to (n,) rows if their costs are lower than the stored ones."""
        better = costs < self.costs[rows]
        rows = rows[better]
        self.kinds[rows], self.costs[rows] = kind, costs[better]
        self.frames[rows], self.sigmas[rows] = fits.frames[better], fits.sigmas[better]


@dataclass(frozen=True, kw_only=True)
class CostModel:
    """Data for the costs of fits to rows of segments.

    Attributes:
        noise: the noise of the edge points.
        points: the points of each row.
        prices: (R,) cost of one parameter.
    """

    noise: Noise
    points: PointSequences
    prices: FloatArray

    def costs(self, which: IntArray, part: PointSequences, fits: Fits, kind: int) -> FloatArray:
        """(n,) costs of fits of a kind to the points of (n,) rows."""
        return self.noise.costs(part, fits.squares) + NUM_PARAMETERS[kind] * self.prices[which]

    def part(self, mask: BoolArray, kind: int) -> tuple[IntArray, PointSequences]:
        """The rows of a mask with enough points for a kind, and their points."""
        which = np.flatnonzero(mask & (self.points.lengths >= MIN_POINTS[kind]))
        return which, self.points.select(which)


def select_curves(
    points: FloatArray, noise: Noise, segments: Segmentation, closed: BoolArray
) -> SelectedCurves:
    """Select the curves of edges from their segments.

    Args:
        points: (N, 3) edge points.
        noise: the noise of the points.
        segments: the segments of each edge.
        closed: (E,) whether an edge is closed.
    """
    rows = candidate_rows(points, segments, closed)
    first, last = rows.segments.T
    bounds = np.column_stack([segments.bounds[first, 0], segments.bounds[last, 1]])
    owners, count = owners_of(segments.offsets), len(first)
    lengths = np.bincount(owners, np.diff(segments.bounds)[:, 0], len(segments.offsets) - 1).astype(
        np.int64
    )
    edges = owners[first]
    model = CostModel(
        noise=noise,
        points=noise.sequences(points, bounds),
        prices=noise.parameter_costs(lengths)[edges],
    )
    # At first, all points of a row are outliers; not allowed for whole edges.
    curves = SelectedCurves(
        kinds=np.full(count, NOTHING, np.int64),
        edges=edges,
        bounds=bounds,
        frames=np.zeros((count, 3, 3)),
        sigmas=np.full((count, 5), np.nan),
        costs=np.where(rows.all_of_edge, 1e300, noise.outlier_cost * model.points.lengths),
        splines=np.full(count, None),
    )
    fit_lines_and_circles(model, rows, segments, curves)
    fit_ellipses_and_splines(model, rows, segments, curves)
    taken = cheapest(rows.segments, len(segments.kinds), curves.costs)
    return curves.select(taken[curves.kinds[taken] != NOTHING])


def fit_lines_and_circles(
    model: CostModel, rows: Rows, segments: Segmentation, curves: SelectedCurves
) -> None:
    """Fit lines, arcs and circles to rows; to single segments only their own kind."""
    first, last = rows.segments.T
    kinds = segments.kinds[first]
    several = (first != last) | rows.all_of_edge & (kinds != LINE)
    round_ = several | (kinds != LINE)
    for kind, mask, fit in (
        (LINE, several | (kinds != ARC), fit_lines),
        (ARC, round_ & ~rows.whole, fit_circles),
        (CIRCLE, round_ & rows.whole, fit_circles),
    ):
        which, part = model.part(mask, kind)
        fits = fit(part)
        curves.keep_better(which, kind, fits, model.costs(which, part, fits, kind))


def candidate_rows(points: FloatArray, segments: Segmentation, closed: BoolArray) -> Rows:
    """Single segments, rows of up to `MAX_ROW` or all between corners, whole closed edges."""
    count = len(segments.kinds)
    owners = owners_of(segments.offsets)
    smooth = np.zeros(
        count, bool
    )  # whether the segment continues the previous one without a corner
    if count:
        smooth[1:] = (owners[1:] == owners[:-1]) & ~is_corner(points, segments)[1:]
    firsts, lasts = [np.arange(count)], [np.arange(count)]
    reach = np.ones(count, bool)
    for length in range(1, MAX_ROW):
        reach = reach[:-1] & smooth[length:] if len(reach) > 1 else reach[:0]
        firsts.append(np.flatnonzero(reach))
        lasts.append(firsts[-1] + length)
    starts = np.flatnonzero(~smooth)
    ends = np.append(starts[1:], count) - 1
    long = ends - starts >= MAX_ROW  # rows of all segments between two corners
    firsts.append(starts[long])
    lasts.append(ends[long])
    loops = np.flatnonzero(closed & (np.diff(segments.offsets) > 0))
    singles = len(np.concatenate(firsts))
    first = np.concatenate([*firsts, segments.offsets[loops]])
    last = np.concatenate([*lasts, segments.offsets[loops + 1] - 1])
    whole = np.arange(len(first)) >= singles
    return Rows(
        segments=np.column_stack([first, last]),
        whole=whole,
        all_of_edge=(first == segments.offsets[owners[first]])
        & (last == segments.offsets[owners[first] + 1] - 1),
    )


def is_corner(points: FloatArray, segments: Segmentation) -> BoolArray:
    """(K,) whether the edge has a corner at the first point of each segment."""
    owners = owners_of(segments.offsets)
    start = segments.bounds[segments.offsets[:-1], 0][owners]
    end = segments.bounds[segments.offsets[1:] - 1, 1][owners] - 1
    at = segments.bounds[:, 0]
    # The chords leave out the points next to the cut, which rounding of a corner may displace.
    before = points[np.maximum(at - 2, start)] - points[np.maximum(at - 5, start)]
    after = points[np.minimum(at + 4, end)] - points[np.minimum(at + 1, end)]
    norms = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    # The chords before and after a corner turn by 40 degrees and more.
    return np.asarray(np.einsum("ij,ij->i", before, after) < np.cos(np.radians(40)) * norms)


def fit_ellipses_and_splines(
    model: CostModel, rows: Rows, segments: Segmentation, curves: SelectedCurves
) -> None:
    """Fit ellipses and splines to rows with a curved segment, if they can have lower costs."""
    noise, prices = model.noise, model.prices
    first, last = rows.segments.T
    totals = np.concatenate([[0.0], np.cumsum(curves.costs[: len(segments.kinds)])])
    limit = np.minimum(totals[last + 1] - totals[first], curves.costs)
    bends = np.concatenate([[0], np.cumsum(segments.kinds != LINE)])
    bent = bends[last + 1] > bends[first]
    for kind, mask in ((ELLIPTIC_ARC, ~rows.whole), (ELLIPSE, rows.whole)):
        which, part = model.part(bent & mask & (NUM_PARAMETERS[kind] * prices < limit), kind)
        fits = fit_ellipses(part)
        costs = model.costs(which, part, fits, kind)
        radii = np.linalg.norm(fits.frames[:, 1:], axis=2)
        known = fits.sigmas[:, 3:] * np.sqrt(noise.correlation) < MAX_RADIUS_DOUBT * radii
        costs[~known.all(axis=1)] = np.inf
        curves.keep_better(which, kind, fits, costs)
    limit = np.minimum(limit, curves.costs)
    which, part = model.part(bent & (num_parameters(DEGREE + 1) * prices < limit), SPLINE)
    found = fit_splines(part, noise, prices[which], limit[which])
    for place, spline in found.items():
        row = int(which[place])
        curves.kinds[row], curves.costs[row], curves.splines[row] = SPLINE, spline.cost, spline


def cheapest(rows: IntArray, num_segments: int, costs: FloatArray) -> IntArray:
    """The (R, 2) rows, in order, that cover every segment once at the least total cost."""
    order = np.argsort(rows[:, 1], kind="stable")
    best = np.full(num_segments + 1, np.inf)
    best[0] = 0
    from_row = np.zeros(num_segments + 1, np.int64)
    for row in order.tolist():
        first, last = rows[row].tolist()
        total = best[first] + costs[row]
        if total < best[last + 1]:
            best[last + 1], from_row[last + 1] = total, row
    taken, end = [], num_segments
    while end > 0:
        taken.append(int(from_row[end]))
        end = int(rows[taken[-1], 0])
    return np.array(taken[::-1], dtype=np.int64)
