"""Circles that several edges share: pieces of one circle, with gaps or other edges in between.

A piece of a few points says little about its circle, and is often told as a line. If it lies on the
circle of another edge, one circle for both needs fewer parameters, and is chosen by the same
criterion (BIC) as the kinds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    offsets_of,
    ranges_of,
    row_numbers,
)
from colmap_edges.core.curves3d import ARC, CIRCLE
from colmap_edges.edges3d.curves.choosing import FREEDOM, MAX_DOUBT, Choice
from colmap_edges.edges3d.curves.cutting import Noise, log_counts
from colmap_edges.edges3d.curves.joints import MAX_POINTS_BETWEEN
from colmap_edges.edges3d.curves.rounds import Circles, fit_circles
from colmap_edges.edges3d.curves.stacks import MISFIT, Stack, costs_of

END_FREEDOM = 2  # parameters of an arc of a known circle: its ends
MAX_ROUNDS = 8  # maximum number of times that groups are combined in pairs
# maximum relative standard deviation of the radius of an arc that is compared with other arcs;
# those of `MAX_DOUBT` and less are compared with all curves
MAX_TRIAL_DOUBT = 1 / 3
MIN_INLIERS = 0.75  # minimum share of a curve's points within the noise of the shared circle
SAMPLES = (0.0, 0.5, 1.0)  # places along a curve that are compared with a circle first


@dataclass(frozen=True, kw_only=True)
class Groups:
    """Groups of curves, each described by one circle or, if single, by its own curve.

    Attributes:
        members: (C,) group of each curve, any numbers.
        costs: (C,) cost of each group, stored at the index of its first curve.
        frames: (C, 3, 3) centre and half axes of each group, likewise.
        sigmas: (C, 5) standard deviations as in `Choice`, likewise.
        doubts: (C,) relative doubt of a group's radius, likewise; infinite for what is no circle.
    """

    members: IntArray
    costs: FloatArray
    frames: FloatArray
    sigmas: FloatArray
    doubts: FloatArray


def with_shared_circles(
    points: FloatArray, noise: Noise, choice: Choice
) -> tuple[Choice, IntArray]:
    """Describe curves on one circle by that circle, where this costs less.

    Args:
        points: (N, 3) edge points.
        noise: the noise of the points.
        choice: the curves of each edge by themselves.

    Returns:
        The curves, successive ones on one circle combined, and the (C,) circle of each: equal
        numbers are equal circles.
    """
    count = len(choice.kinds)
    rounded = (choice.kinds == ARC) | (choice.kinds == CIRCLE)
    groups = Groups(
        members=np.arange(count),
        costs=choice.costs.copy(),
        frames=choice.frames.copy(),
        sigmas=choice.sigmas.copy(),
        doubts=np.where(rounded, doubts_of(choice.frames, choice.sigmas, noise), np.inf),
    )
    fresh = groups.doubts <= MAX_TRIAL_DOUBT
    for _ in range(MAX_ROUNDS):
        pairs = candidate_pairs(points, noise, choice, groups, fresh)
        if not len(pairs):
            break
        fresh = combine(points, noise, choice, groups, pairs)
    sizes = np.bincount(groups.members, minlength=count)
    shared = sizes[groups.members] > 1
    kinds = np.where(shared & (choice.kinds != CIRCLE), ARC, choice.kinds)
    own = np.where(shared, groups.members, np.arange(count))
    told = replace(choice, kinds=kinds, frames=groups.frames[own], sigmas=groups.sigmas[own])
    return successive_combined(told, own)


def doubts_of(frames: FloatArray, sigmas: FloatArray, noise: Noise) -> FloatArray:
    """(C,) relative standard deviations of the radii of circles."""
    radii = np.linalg.norm(frames[:, 1], axis=1)
    doubts = sigmas[:, 3] * np.sqrt(noise.correlation) / np.maximum(radii, 1e-300)
    return np.asarray(np.nan_to_num(doubts, nan=np.inf), np.float64)


def candidate_pairs(
    points: FloatArray, noise: Noise, choice: Choice, groups: Groups, fresh: BoolArray
) -> IntArray:
    """(n, 2) groups that may be one circle, the first of them known and one of them `fresh`."""
    first, end = choice.bounds.T
    places = first[:, None] + ((end - 1 - first)[:, None] * np.array(SAMPLES)).astype(np.int64)
    samples, spread = points[places], noise.sigmas[places]
    alive = np.bincount(groups.members, minlength=len(first)) > 0
    known = np.flatnonzero((groups.doubts <= MAX_TRIAL_DOUBT) & alive)
    if not len(known):
        return np.zeros((0, 2), np.int64)
    centers, radii = groups.frames[known, 0], np.linalg.norm(groups.frames[known, 1], axis=1)
    most = np.maximum(groups.doubts[known], MAX_DOUBT)
    rounded = np.isfinite(groups.doubts[groups.members])
    rows, curves = np.zeros(0, np.int64), np.zeros(0, np.int64)
    for which, among in (
        (most <= MAX_DOUBT, np.ones(len(first), bool)),
        (most > MAX_DOUBT, rounded),
    ):
        circles, others = np.flatnonzero(which), np.flatnonzero(among)
        reach = (1 + most[circles]) * radii[circles]
        found = cKDTree(samples[others, 1]).query_ball_point(centers[circles], reach)
        rows = np.concatenate([rows, np.repeat(circles, [len(near) for near in found])])
        curves = np.concatenate([curves, *(others[near] for near in found)])
    other = groups.members[curves] != known[rows]
    rows, curves = rows[other], curves[other]
    away = samples[curves] - centers[rows, None]
    normals = np.cross(groups.frames[known[rows], 1], groups.frames[known[rows], 2])
    normals /= radii[rows, None] ** 2
    across = np.einsum("nki,ni->nk", away, normals)
    inside = np.sqrt(np.maximum((away**2).sum(axis=2) - across**2, 0)) - radii[rows, None]
    own = np.sqrt(noise.correlation) * groups.sigmas[known[rows]]
    doubt = own[:, 0] + own[:, 1] + own[:, 2] * radii[rows] + own[:, 3]
    doubt = np.minimum(doubt, most[rows] * radii[rows])[:, None]
    near = np.hypot(across, inside) <= MISFIT * np.hypot(spread[curves], doubt)
    near = near.sum(axis=1) >= 2
    pairs = distinct(np.column_stack([known[rows], groups.members[curves]])[near])[0]
    pairs = pairs[fresh[pairs].any(axis=1)]
    # Of two circles of different edges each must lie on the other.
    tried = (groups.doubts[pairs] <= MAX_TRIAL_DOUBT).all(axis=1)
    pairs[tried] = np.sort(pairs[tried], axis=1)
    tried &= np.diff(choice.edges[pairs], axis=1)[:, 0] != 0
    mutual, times = distinct(pairs[tried])
    return np.concatenate([distinct(pairs[~tried])[0], mutual[times >= 2]])


def distinct(pairs: IntArray) -> tuple[IntArray, IntArray]:
    """The distinct ones of (n, 2) pairs, in lexicographic order, and how often each occurs."""
    _, first, times = np.unique(row_numbers(pairs), return_index=True, return_counts=True)
    return pairs[first], times


def combine(
    points: FloatArray, noise: Noise, choice: Choice, groups: Groups, pairs: IntArray
) -> BoolArray:
    """Combine pairs of groups that cost less as one circle, the largest gain first.

    Changes `groups`; returns the (C,) groups that were changed.
    """
    order = np.argsort(groups.members, kind="stable")
    offsets = offsets_of(np.bincount(groups.members, minlength=len(groups.members)))
    stack, arcs = stack_of(points, noise, choice, order, offsets, pairs)
    fits = fit_circles(stack)
    lengths = np.diff(stack.offsets)
    shares = noise.shares(lengths)[stack.owners]
    squares = stack.weights * fits.squares
    logs = log_counts(lengths, noise.correlation)
    freedom = FREEDOM[CIRCLE] + END_FREEDOM * arcs
    costs = stack.sums(costs_of(squares, shares, noise.correlation)) + freedom * logs
    gains = groups.costs[pairs].sum(axis=1) - costs
    inliers = stack.sums((squares <= MISFIT**2).astype(np.float64)) / lengths
    frames, sigmas = as_frames(fits)
    doubts = doubts_of(frames, sigmas, noise)
    fine = (gains > 0) & (inliers >= MIN_INLIERS) & (doubts <= MAX_DOUBT)
    changed = np.zeros(len(groups.members), bool)
    for row in np.flatnonzero(fine)[np.argsort(-gains[fine], kind="stable")].tolist():
        pair = pairs[row]
        if changed[pair].any():
            continue
        changed[pair] = True
        kept, gone = int(pair.min()), int(pair.max())
        groups.members[order[offsets[gone] : offsets[gone + 1]]] = kept
        groups.costs[kept], groups.doubts[kept], groups.doubts[gone] = (
            costs[row],
            doubts[row],
            np.inf,
        )
        groups.frames[kept], groups.sigmas[kept] = frames[row], sigmas[row]
    return changed


def as_frames(fits: Circles) -> tuple[FloatArray, FloatArray]:
    """(S, 3, 3) frames and (S, 5) standard deviations of circles, as in `Choice`."""
    half = fits.radii[:, None, None] * fits.axes[:, :2]
    frames = np.concatenate([fits.centers[:, None], half], axis=1)
    return frames, fits.sigmas[:, [0, 1, 2, 3, 3]]


def stack_of(
    points: FloatArray,
    noise: Noise,
    choice: Choice,
    order: IntArray,
    offsets: IntArray,
    pairs: IntArray,
) -> tuple[Stack, IntArray]:
    """Stack of the points of (n, 2) pairs of groups, and their (n,) numbers of open curves.

    `order` has the curves group by group, with CSR `offsets`.
    """
    spans = offsets[pairs.ravel()], offsets[pairs.ravel() + 1]
    curves = order[ranges_of(*spans)]
    counts = (spans[1] - spans[0]).reshape(-1, 2).sum(axis=1)
    bounds = choice.bounds[curves]
    rows = ranges_of(bounds[:, 0], bounds[:, 1])
    lengths = offsets_of(bounds[:, 1] - bounds[:, 0])[offsets_of(counts)]
    stack = Stack(points=points[rows], weights=noise.weights[rows], offsets=lengths)
    is_open = (choice.kinds[curves] != CIRCLE).astype(np.int64)
    return stack, np.add.reduceat(is_open, offsets_of(counts)[:-1])


def successive_combined(choice: Choice, circles: IntArray) -> tuple[Choice, IntArray]:
    """Combine successive curves of an edge on one circle, with few outliers in between."""
    same = (circles[1:] == circles[:-1]) & (choice.edges[1:] == choice.edges[:-1])
    same &= choice.bounds[1:, 0] - choice.bounds[:-1, 1] <= MAX_POINTS_BETWEEN
    first = np.flatnonzero(np.concatenate([[True], ~same])[: len(circles)])
    last = np.concatenate([first[1:] - 1, [len(circles) - 1]])[: len(first)]
    place = np.searchsorted(first, np.arange(len(circles)), side="right") - 1
    combined = Choice(
        kinds=choice.kinds[first],
        edges=choice.edges[first],
        bounds=np.column_stack([choice.bounds[first, 0], choice.bounds[last, 1]]),
        frames=choice.frames[first],
        sigmas=choice.sigmas[first],
        costs=choice.costs[first],
        splines={
            int(place[curve]): fit
            for curve, fit in choice.splines.items()
            if choice.kinds[curve] not in (ARC, CIRCLE)
        },
    )
    return combined, circles[first]
