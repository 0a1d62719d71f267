"""Model selection: which consecutive pieces of an edge form one line, arc, ellipse or spline.

Cutting fits only lines and arcs: it cuts ellipses and splines into rows of arcs, and outliers split
curves. Rows of consecutive pieces without a corner are therefore refitted as one curve of each
kind, and the combination of least cost is selected, again by BIC.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of, ranges_of
from colmap_edges.core.curves3d import ARC, CIRCLE, DEGREE, ELLIPSE, ELLIPTIC_ARC, LINE, SPLINE
from colmap_edges.edges3d.curves import cutting
from colmap_edges.edges3d.curves.cutting import Noise, Pieces
from colmap_edges.edges3d.curves.ellipses import fit_ellipses
from colmap_edges.edges3d.curves.rounds import fit_circles, fit_lines
from colmap_edges.edges3d.curves.splines import SplineFit, fit_splines, smooth_squares, spline_price
from colmap_edges.edges3d.curves.stacks import MISFIT, Stack, costs_of

MAX_ROW = 6  # maximum number of pieces fitted as one curve
# maximum turn between the chords before and after a point that is no corner
MAX_TURN = np.radians(40)
CHORD = 4  # length of these chords, in points
MAX_DOUBT = 0.03  # maximum relative standard deviation of an ellipse's radii
TRIAL_STEPS = 2  # Gauss-Newton steps after which the cost of an ellipse is estimated
TRIAL_RATIO = 2.0  # factor up to which that estimate may be too large
# Smallest numbers of control points of splines, with the degree of polynomials that contain all
# splines of up to one (second entry: four) more control points: their residuals plus the price of
# the smallest spline are a lower bound of the splines' costs.
PROBES = ((4, 5), (6, 9))
FREEDOM = {LINE: 5, ARC: 8, CIRCLE: 6, ELLIPTIC_ARC: 10, ELLIPSE: 8}
MIN_POINTS = {LINE: 2, ARC: 5, CIRCLE: 8, ELLIPTIC_ARC: 10, ELLIPSE: 10, SPLINE: 10}


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Rows of successive pieces that may be one curve.

    Attributes:
        edges: (R,) their edges.
        pieces: (R, 2) first and last piece.
        bounds: (R, 2) range of points, end exclusive.
        whole: (R,) whether the row is a whole closed edge, fitted as a closed curve.
        all_of_edge: (R,) whether the row is a whole edge.
    """

    edges: IntArray
    pieces: IntArray
    bounds: IntArray
    whole: BoolArray
    all_of_edge: BoolArray

    @property
    def lengths(self) -> IntArray:
        """(R,) numbers of points."""
        return np.diff(self.bounds)[:, 0]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The selected curves with their kinds, edges, ranges of points, and fits.

    Attributes:
        kinds, edges, bounds: (C,), (C,), (C, 2).
        frames: (C, 3, 3) rows: for lines a point, the direction and 0; for circles and ellipses the
            centre and the half axes.
        sigmas: (C, 5) standard deviations of the point or centre, of the centre across its plane,
            of the direction or normal (radians), and of the two radii.
        costs: (C,) costs by which they were selected.
        splines: fits of the splines, by index of the curve.
    """

    kinds: IntArray
    edges: IntArray
    bounds: IntArray
    frames: FloatArray
    sigmas: FloatArray
    costs: FloatArray
    splines: dict[int, SplineFit]


@dataclass(frozen=True, kw_only=True)
class Fits:
    """The fit of least cost to each row so far.

    Attributes:
        kinds: (R,) kind.
        costs: (R,) cost.
        frames, sigmas: (R, 3, 3) and (R, 5) as in `Choice`.
        splines: fits of the splines, by row.
    """

    kinds: IntArray
    costs: FloatArray
    frames: FloatArray
    sigmas: FloatArray
    splines: dict[int, SplineFit]

    def take(self, rows: IntArray, kind: int, costs: FloatArray, frames: Any, sigmas: Any) -> None:
        """Store fits of one kind to (n,) rows if their costs are lower than the stored ones."""
        better = costs < self.costs[rows]
        rows = rows[better]
        self.kinds[rows], self.costs[rows] = kind, costs[better]
        self.frames[rows], self.sigmas[rows] = frames[better], sigmas[better]


def choose(points: FloatArray, noise: Noise, pieces: Pieces, closed: BoolArray) -> Choice:
    """Select the curves of edges from their pieces.

    Args:
        points: (N, 3) edge points.
        noise: the noise of the points.
        pieces: the pieces of each edge.
        closed: (E,) whether an edge is closed.
    """
    rows = candidate_rows(points, pieces, closed)
    judge = Judge(
        stack=stacked(points, noise.weights, rows.bounds),
        rows=rows,
        logs=price_of_a_parameter(pieces, noise)[rows.edges],
        shares=noise.shares(rows.lengths),
        correlation=noise.correlation,
    )
    fits = fits_of_nothing(rows, noise)
    fit_simple(judge, pieces, fits)
    fit_free(judge, pieces, fits)
    taken = cheapest(rows, pieces, fits.costs)
    taken = taken[fits.kinds[taken] != cutting.NOTHING]
    return Choice(
        kinds=fits.kinds[taken],
        edges=rows.edges[taken],
        bounds=rows.bounds[taken],
        frames=fits.frames[taken],
        sigmas=fits.sigmas[taken],
        costs=fits.costs[taken],
        splines={
            curve: fits.splines[row]
            for curve, row in enumerate(taken.tolist())
            if fits.kinds[row] == SPLINE
        },
    )


def price_of_a_parameter(pieces: Pieces, noise: Noise) -> FloatArray:
    """(E,) cost of one parameter of a curve of each edge (BIC)."""
    lengths = np.zeros(len(pieces.offsets) - 1, np.int64)
    some = np.diff(pieces.offsets) > 0
    first, last = pieces.offsets[:-1][some], pieces.offsets[1:][some] - 1
    lengths[some] = pieces.bounds[last, 1] - pieces.bounds[first, 0]
    return cutting.log_counts(lengths, noise.correlation)


def fits_of_nothing(rows: Rows, noise: Noise) -> Fits:
    """The initial fits: all points of a row are outliers; not allowed for whole edges."""
    count = len(rows.edges)
    costs = MISFIT**2 / noise.correlation * rows.lengths
    return Fits(
        kinds=np.full(count, cutting.NOTHING, np.int64),
        costs=np.where(rows.all_of_edge, 1e300, costs),
        frames=np.zeros((count, 3, 3)),
        sigmas=np.full((count, 5), np.nan),
        splines={},
    )


@dataclass(frozen=True, kw_only=True)
class Judge:
    """Data for the costs of fits to rows.

    Attributes:
        stack: the points of each row.
        rows: the rows.
        logs: (R,) cost of one parameter.
        shares: (R,) divisors of squared residuals.
        correlation: number of consecutive points that count as one independent point.
    """

    stack: Stack
    rows: Rows
    logs: FloatArray
    shares: FloatArray
    correlation: float

    def costs(self, which: IntArray, part: Stack, squares: FloatArray, kind: int) -> FloatArray:
        """(n,) costs of fits of a kind to rows with the squared distances of their points."""
        shares = self.shares[which][part.owners]
        sums = part.sums(costs_of(part.weights * squares, shares, self.correlation))
        return np.asarray(sums + FREEDOM[kind] * self.logs[which])

    def asked(self, mask: BoolArray, kind: int) -> IntArray:
        """The rows of a mask with enough points for a kind."""
        return np.flatnonzero(mask & (self.rows.lengths >= MIN_POINTS[kind]))


def fit_simple(judge: Judge, pieces: Pieces, fits: Fits) -> None:
    """Fit lines, arcs and circles to rows; to single pieces only the kind of the segmentation."""
    first, last = judge.rows.pieces.T
    several = (first != last) | judge.rows.all_of_edge & (pieces.kinds[first] != cutting.LINE)
    which = judge.asked(several | (pieces.kinds[first] != cutting.ARC), LINE)
    part = judge.stack.select(which)
    lines = fit_lines(part)
    frames = np.stack([lines.origins, lines.directions, 0 * lines.origins], axis=1)
    middle, direction = lines.middle_sigmas, lines.direction_sigmas
    sigmas = np.column_stack([middle, middle, direction, 0 * middle, 0 * middle])
    fits.take(which, LINE, judge.costs(which, part, lines.squares, LINE), frames, sigmas)
    round_ = several | (pieces.kinds[first] != cutting.LINE)
    for kind, mask in ((ARC, ~judge.rows.whole), (CIRCLE, judge.rows.whole)):
        which = judge.asked(round_ & mask, kind)
        part = judge.stack.select(which)
        circles = fit_circles(part)
        half = circles.radii[:, None, None] * circles.axes[:, :2]
        frames = np.concatenate([circles.centers[:, None], half], axis=1)
        sigmas = circles.sigmas[:, [0, 1, 2, 3, 3]]
        fits.take(which, kind, judge.costs(which, part, circles.squares, kind), frames, sigmas)


def stacked(points: FloatArray, weights: FloatArray, bounds: IntArray) -> Stack:
    """Stack of the ranges of points with these (R, 2) bounds."""
    rows = ranges_of(bounds[:, 0], bounds[:, 1])
    offsets = offsets_of(bounds[:, 1] - bounds[:, 0])
    return Stack(points=points[rows], weights=weights[rows], offsets=offsets)


def candidate_rows(points: FloatArray, pieces: Pieces, closed: BoolArray) -> Rows:
    """Single pieces, rows of up to `MAX_ROW` or all pieces between corners, whole closed edges."""
    count = len(pieces.kinds)
    owners = np.repeat(np.arange(len(pieces.offsets) - 1), np.diff(pieces.offsets))
    smooth = np.zeros(count, bool)  # whether the piece continues the previous one without a corner
    if count:
        smooth[1:] = (owners[1:] == owners[:-1]) & ~is_corner(points, pieces)[1:]
    firsts, lasts = [np.arange(count)], [np.arange(count)]
    reach = np.ones(count, bool)
    for length in range(1, MAX_ROW):
        reach = reach[:-1] & smooth[length:] if len(reach) > 1 else reach[:0]
        firsts.append(np.flatnonzero(reach))
        lasts.append(firsts[-1] + length)
    starts = np.flatnonzero(~smooth)
    ends = np.append(starts[1:], count) - 1
    long = ends - starts >= MAX_ROW  # rows of all pieces between two corners
    firsts.append(starts[long])
    lasts.append(ends[long])
    loops = np.flatnonzero(closed & (np.diff(pieces.offsets) > 0))
    singles = len(np.concatenate(firsts))
    first = np.concatenate([*firsts, pieces.offsets[loops]])
    last = np.concatenate([*lasts, pieces.offsets[loops + 1] - 1])
    whole = np.arange(len(first)) >= singles
    return Rows(
        edges=owners[first] if count else np.zeros(0, np.int64),
        pieces=np.column_stack([first, last]),
        bounds=np.column_stack([pieces.bounds[first, 0], pieces.bounds[last, 1]]),
        whole=whole,
        all_of_edge=(first == pieces.offsets[owners[first]])
        & (last == pieces.offsets[owners[first] + 1] - 1),
    )


def is_corner(points: FloatArray, pieces: Pieces) -> BoolArray:
    """(K,) whether the edge has a corner at the first point of each piece."""
    owners = np.repeat(np.arange(len(pieces.offsets) - 1), np.diff(pieces.offsets))
    start = pieces.bounds[pieces.offsets[:-1], 0][owners]
    end = pieces.bounds[pieces.offsets[1:] - 1, 1][owners] - 1
    at = pieces.bounds[:, 0]
    # The chords leave out the points next to the cut, which rounding of a corner may displace.
    before = points[np.maximum(at - 2, start)] - points[np.maximum(at - 1 - CHORD, start)]
    after = points[np.minimum(at + CHORD, end)] - points[np.minimum(at + 1, end)]
    norms = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.asarray(np.einsum("ij,ij->i", before, after) < np.cos(MAX_TURN) * norms)


def fit_free(judge: Judge, pieces: Pieces, fits: Fits) -> None:
    """Fit ellipses and splines to rows with a curved piece, if they can have lower costs."""
    first, last = judge.rows.pieces.T
    totals = np.concatenate([[0.0], np.cumsum(fits.costs[: len(pieces.kinds)])])
    limit = np.minimum(totals[last + 1] - totals[first], fits.costs)
    bends = np.concatenate([[0], np.cumsum(pieces.kinds != cutting.LINE)])
    bent = bends[last + 1] > bends[first]
    for kind, mask in ((ELLIPTIC_ARC, ~judge.rows.whole), (ELLIPSE, judge.rows.whole)):
        which = judge.asked(bent & mask & (FREEDOM[kind] * judge.logs < limit), kind)
        part = judge.stack.select(which)
        near = judge.costs(which, part, fit_ellipses(part, TRIAL_STEPS).squares, kind)
        which = which[near < TRIAL_RATIO * limit[which]]
        part = judge.stack.select(which)
        ellipses = fit_ellipses(part)
        costs = judge.costs(which, part, ellipses.squares, kind)
        radii = np.linalg.norm(ellipses.frames[:, 1:], axis=2)
        known = ellipses.sigmas[:, 3:] * np.sqrt(judge.correlation) < MAX_DOUBT * radii
        costs[~(ellipses.found & known.all(axis=1))] = np.inf
        fits.take(which, kind, costs, ellipses.frames, ellipses.sigmas)
    limit = np.minimum(limit, fits.costs)
    price = spline_price(DEGREE + 1, 1.0) * judge.logs
    which = judge.asked(bent & (price < limit), SPLINE)
    part = judge.stack.select(which)
    least = np.full(len(which), np.inf)
    for size, degree in PROBES:
        squares = part.weights * smooth_squares(part, degree)
        costs = part.sums(costs_of(squares, judge.shares[which][part.owners], judge.correlation))
        least = np.minimum(least, costs + spline_price(size, 1.0) * judge.logs[which])
    which = which[least < limit[which]]
    prices = judge.logs[which], judge.shares[which], judge.correlation, limit[which]
    for place, spline in fit_splines(judge.stack.select(which), *prices).items():
        row = int(which[place])
        fits.kinds[row], fits.costs[row], fits.splines[row] = SPLINE, spline.cost, spline


def cheapest(rows: Rows, pieces: Pieces, cost: FloatArray) -> IntArray:
    """The rows, in order, that cover every piece once at the least total cost."""
    order = np.argsort(rows.pieces[:, 1], kind="stable")
    best = np.full(len(pieces.kinds) + 1, np.inf)
    best[0] = 0
    from_row = np.zeros(len(pieces.kinds) + 1, np.int64)
    for row in order.tolist():
        first, last = rows.pieces[row].tolist()
        total = best[first] + cost[row]
        if total < best[last + 1]:
            best[last + 1], from_row[last + 1] = total, row
    taken, piece = [], len(pieces.kinds)
    while piece > 0:
        taken.append(int(from_row[piece]))
        piece = int(rows.pieces[taken[-1], 0])
    return np.array(taken[::-1], dtype=np.int64)
