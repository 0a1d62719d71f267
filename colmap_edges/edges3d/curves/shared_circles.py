"""Circles that several edges share: pieces of one circle, with gaps or other edges in between.

A piece of a few points does not determine its circle, and is often classified as a line. If it lies
on the circle of another edge, one circle for both needs fewer parameters, and is chosen by the same
criterion (BIC) as the kinds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    joined_lists,
    offsets_of,
    ranges_of,
    row_numbers,
)
from colmap_edges.core.curves3d import ARC, CIRCLE
from colmap_edges.edges3d.curves.joints import MAX_POINTS_BETWEEN
from colmap_edges.edges3d.curves.lines_and_circles import fit_circles
from colmap_edges.edges3d.curves.noise import NUM_PARAMETERS, Noise
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS, Fits, PointSequences
from colmap_edges.edges3d.curves.selection import MAX_RADIUS_DOUBT, SelectedCurves

# maximum relative standard deviation of the radius of an arc that is compared with other arcs;
# those of `MAX_RADIUS_DOUBT` and less are compared with all curves
MAX_TRIAL_DOUBT = 1 / 3


def with_shared_circles(
    points: FloatArray, noise: Noise, curves: SelectedCurves
) -> tuple[SelectedCurves, IntArray]:
    """Describe curves on one circle by that circle, where this costs less.

    Args:
        points: (N, 3) edge points.
        noise: the noise of the points.
        curves: the curves of each edge by themselves.

    Returns:
        The curves, successive ones on one circle combined, and the (C,) circle of each: equal
        numbers are equal circles.
    """
    every = np.arange(len(curves.kinds))
    # The curve or the circle of each group of curves, at the index of its first curve.
    members, groups = every.copy(), curves.select(every)
    fresh = doubts_of(groups, noise) <= MAX_TRIAL_DOUBT
    # Groups are combined in pairs, again and again.
    for _ in range(8):
        pairs = candidate_pairs(points, noise, curves, groups, members, fresh)
        if not len(pairs):
            break
        fresh = combine(points, noise, curves, groups, members, pairs)
    shared = np.bincount(members, minlength=len(every))[members] > 1
    kinds = np.where(shared & (curves.kinds != CIRCLE), ARC, curves.kinds)
    own = np.where(shared, members, every)
    return successive_combined(
        replace(curves, kinds=kinds, frames=groups.frames[own], sigmas=groups.sigmas[own]), own
    )


def doubts_of(curves: SelectedCurves, noise: Noise) -> FloatArray:
    """(C,) standard deviations of radii, relative to them; infinite unless a curve is circular."""
    circular = (curves.kinds == ARC) | (curves.kinds == CIRCLE)
    return np.where(circular, relative_sigmas(curves.frames, curves.sigmas, noise), np.inf)


def relative_sigmas(frames: FloatArray, sigmas: FloatArray, noise: Noise) -> FloatArray:
    """(n,) standard deviations of the radii of circles, relative to the radii."""
    radii = np.maximum(np.linalg.norm(frames[:, 1], axis=1), 1e-300)
    doubts = sigmas[:, 3] * np.sqrt(noise.correlation) / radii
    return np.asarray(np.nan_to_num(doubts, nan=np.inf), np.float64)


def candidate_pairs(
    points: FloatArray,
    noise: Noise,
    curves: SelectedCurves,
    groups: SelectedCurves,
    members: IntArray,
    fresh: BoolArray,
) -> IntArray:
    """(n, 2) groups that may be one circle, the first of them known and one of them `fresh`."""
    doubts = doubts_of(groups, noise)
    first, end = curves.bounds.T
    # The ends and the middle of a curve are compared with a circle first.
    steps = (end - 1 - first)[:, None] * np.array([0.0, 0.5, 1.0])
    places = first[:, None] + steps.astype(np.int64)
    samples, spread = points[places], noise.sigmas[places]
    alive = np.bincount(members, minlength=len(first)) > 0
    known = np.flatnonzero((doubts <= MAX_TRIAL_DOUBT) & alive)
    if not len(known):
        return np.zeros((0, 2), np.int64)
    centers, radii = groups.frames[known, 0], np.linalg.norm(groups.frames[known, 1], axis=1)
    most = np.maximum(doubts[known], MAX_RADIUS_DOUBT)
    rounded = np.isfinite(doubts[members])
    lists = cKDTree(samples[:, 1]).query_ball_point(centers, (1 + most) * radii)
    rows, found = joined_lists(lists)
    other = (most[rows] <= MAX_RADIUS_DOUBT) | rounded[found]
    other &= members[found] != known[rows]
    rows, found = rows[other], found[other]
    away = samples[found] - centers[rows, None]
    normals = np.cross(groups.frames[known[rows], 1], groups.frames[known[rows], 2])
    normals /= radii[rows, None] ** 2
    across = np.einsum("nki,ni->nk", away, normals)
    inside = np.sqrt(np.maximum((away**2).sum(axis=2) - across**2, 0)) - radii[rows, None]
    own = np.sqrt(noise.correlation) * groups.sigmas[known[rows]]
    doubt = own[:, 0] + own[:, 1] + own[:, 2] * radii[rows] + own[:, 3]
    doubt = np.minimum(doubt, most[rows] * radii[rows])[:, None]
    near = np.hypot(across, inside) <= OUTLIER_SIGMAS * np.hypot(spread[found], doubt)
    near = near.sum(axis=1) >= 2
    pairs = distinct(np.column_stack([known[rows], members[found]])[near])[0]
    pairs = pairs[fresh[pairs].any(axis=1)]
    # Of two circles of different edges each must lie on the other.
    tried = (doubts[pairs] <= MAX_TRIAL_DOUBT).all(axis=1)
    pairs[tried] = np.sort(pairs[tried], axis=1)
    tried &= np.diff(curves.edges[pairs], axis=1)[:, 0] != 0
    mutual, times = distinct(pairs[tried])
    return np.concatenate([distinct(pairs[~tried])[0], mutual[times >= 2]])


def distinct(pairs: IntArray) -> tuple[IntArray, IntArray]:
    """The distinct ones of (n, 2) pairs, in lexicographic order, and how often each occurs."""
    _, first, times = np.unique(row_numbers(pairs), return_index=True, return_counts=True)
    return pairs[first], times


def combine(
    points: FloatArray,
    noise: Noise,
    curves: SelectedCurves,
    groups: SelectedCurves,
    members: IntArray,
    pairs: IntArray,
) -> BoolArray:
    """Combine pairs of groups that cost less as one circle, the largest gain first.

    Changes `groups` and `members`; returns the (C,) groups that were changed.
    """
    order = np.argsort(members, kind="stable")
    offsets = offsets_of(np.bincount(members, minlength=len(members)))
    joint, num_arcs = joint_sequences(points, noise, curves, order, offsets, pairs)
    fits, gains = joint_circles(noise, joint, num_arcs, groups.costs[pairs].sum(axis=1))
    doubts = relative_sigmas(fits.frames, fits.sigmas, noise)
    fine = (gains > 0) & (doubts <= MAX_RADIUS_DOUBT)
    changed = np.zeros(len(members), bool)
    for row in np.flatnonzero(fine)[np.argsort(-gains[fine], kind="stable")].tolist():
        kept, gone = np.sort(pairs[row]).tolist()
        if changed[kept] or changed[gone]:
            continue
        changed[[kept, gone]] = True
        members[order[offsets[gone] : offsets[gone + 1]]] = kept
        groups.kinds[kept], groups.costs[kept] = ARC, groups.costs[[kept, gone]].sum() - gains[row]
        groups.frames[kept], groups.sigmas[kept] = fits.frames[row], fits.sigmas[row]
    return changed


def joint_circles(
    noise: Noise, joint: PointSequences, num_arcs: IntArray | int, separate: FloatArray
) -> tuple[Fits, FloatArray]:
    """Fit one circle to the points of several curves, and compare its cost with theirs (BIC).

    Args:
        noise: the noise of edge points.
        joint: S sequences, each of the points of several curves.
        num_arcs: (S,) numbers of these curves that are open.
        separate: (S,) costs of the curves by themselves.

    Returns:
        The circles, and (S,) by how much they cost less.
    """
    fits = fit_circles(joint)
    prices = noise.parameter_costs(joint.lengths)
    num_parameters = NUM_PARAMETERS[CIRCLE] + 2 * num_arcs  # an arc has two ends
    costs = noise.costs(joint, fits.squares) + num_parameters * prices
    return fits, separate - costs


def joint_sequences(
    points: FloatArray,
    noise: Noise,
    curves: SelectedCurves,
    order: IntArray,
    offsets: IntArray,
    pairs: IntArray,
) -> tuple[PointSequences, IntArray]:
    """The points of (n, 2) pairs of groups, and their (n,) numbers of open curves.

    `order` has the curves group by group, with CSR `offsets`.
    """
    spans = offsets[pairs.ravel()], offsets[pairs.ravel() + 1]
    rows = order[ranges_of(*spans)]
    counts = (spans[1] - spans[0]).reshape(-1, 2).sum(axis=1)
    each = noise.sequences(points, curves.bounds[rows])
    is_open = (curves.kinds[rows] != CIRCLE).astype(np.int64)
    joint = replace(each, offsets=each.offsets[offsets_of(counts)])
    return joint, np.add.reduceat(is_open, offsets_of(counts)[:-1])


def successive_combined(
    curves: SelectedCurves, circles: IntArray
) -> tuple[SelectedCurves, IntArray]:
    """Combine successive curves of an edge on one circle, with few outliers in between."""
    same = (circles[1:] == circles[:-1]) & (curves.edges[1:] == curves.edges[:-1])
    same &= curves.bounds[1:, 0] - curves.bounds[:-1, 1] <= MAX_POINTS_BETWEEN
    first = np.flatnonzero(np.concatenate([[True], ~same])[: len(circles)])
    last = np.append(first[1:], len(circles))[: len(first)] - 1
    bounds = np.column_stack([curves.bounds[first, 0], curves.bounds[last, 1]])
    return replace(curves.select(first), bounds=bounds), circles[first]
