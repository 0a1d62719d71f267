"""Small arcs between two lines that are tangent to both: rounded corners of a few points.

An arc has eight parameters, and the few points of a small one cost less as outliers. Tangent to the
lines on both sides, it has one: its radius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of, ranges_of
from colmap_edges.core.curves3d import ARC, LINE
from colmap_edges.core.polylines import unit
from colmap_edges.edges3d.curves.choosing import MAX_DOUBT, Choice
from colmap_edges.edges3d.curves.cutting import Noise, log_counts
from colmap_edges.edges3d.curves.joints import MAX_POINTS_BETWEEN
from colmap_edges.edges3d.curves.stacks import MISFIT, Stack, costs_of

FREEDOM = 1  # parameters of a fillet: its radius
MIN_POINTS = 3  # minimum number of points of a fillet; fewer are what blur makes of a corner
MIN_TURN, MAX_TURN = np.radians(20.0), np.radians(150.0)  # turn between the lines
STEPS = 8  # Gauss-Newton steps


@dataclass(frozen=True, kw_only=True)
class Bends:
    """Gaps of outliers between successive lines, in the plane of both lines.

    Attributes:
        left: (B,) line before the gap; the one behind it is the next one of the edge.
        right: (B,) line behind the gap.
        corners: (B, 3) meeting points of the lines.
        ways: (B, 3) unit directions at the middle of the bend.
        inward: (B, 3) unit directions from the corner to the centre of the arc.
        halves: (B,) half the turn between the lines.
        rooms: (B,) largest radius for which the arc touches the lines where they have points.
        stack: the points in the gaps.
    """

    left: IntArray
    right: IntArray
    corners: FloatArray
    ways: FloatArray
    inward: FloatArray
    halves: FloatArray
    rooms: FloatArray
    stack: Stack


def with_fillets(
    points: FloatArray, noise: Noise, choice: Choice, offsets: IntArray, closed: BoolArray
) -> Choice:
    """Add arcs tangent to two successive lines where outliers between these lie on one.

    Args:
        points: (N, 3) edge points.
        noise: the noise of the points.
        choice: the curves.
        offsets: (E + 1,) offsets of the points of the edges.
        closed: (E,) whether the edges are closed.
    """
    bends = find_bends(points, noise, choice, offsets, closed)
    if not len(bends.left):
        return choice
    radii, squares, sigmas = fit_radii(bends)
    lengths = np.diff(offsets)[choice.edges[bends.left]]
    shares = noise.shares(np.diff(bends.stack.offsets))[bends.stack.owners]
    costs = bends.stack.sums(costs_of(squares, shares, noise.correlation))
    costs += FREEDOM * log_counts(lengths, noise.correlation)
    outliers = MISFIT**2 / noise.correlation * np.diff(bends.stack.offsets)
    fine = (costs < outliers) & (radii > 0) & (radii <= bends.rooms)
    fine &= sigmas * np.sqrt(noise.correlation) < MAX_DOUBT * radii
    return inserted(choice, bends, np.flatnonzero(fine), radii, sigmas, costs)


def find_bends(
    points: FloatArray, noise: Noise, choice: Choice, offsets: IntArray, closed: BoolArray
) -> Bends:
    """Find gaps between successive lines in one plane that turn at an angle."""
    left, right, first, end = gaps_between(choice, offsets, closed)
    before, behind = directed(points, choice, left), directed(points, choice, right)
    cosines = np.einsum("ij,ij->i", before, behind)
    keep = (cosines < np.cos(MIN_TURN)) & (cosines > np.cos(MAX_TURN))
    left, right, first, end, before, behind, cosines = (
        of[keep] for of in (left, right, first, end, before, behind, cosines)
    )
    origins = choice.frames[left, 0], choice.frames[right, 0]
    offset = origins[1] - origins[0]
    on = [np.einsum("ij,ij->i", offset, way) for way in (before, behind)]
    sine2 = 1 - cosines**2
    feet = (
        origins[0] + ((on[0] - cosines * on[1]) / sine2)[:, None] * before,
        origins[1] + ((cosines * on[0] - on[1]) / sine2)[:, None] * behind,
    )
    corners = (feet[0] + feet[1]) / 2
    miss = np.linalg.norm(feet[1] - feet[0], axis=1)
    sigmas = noise.sigmas[choice.bounds[left, 1] - 1] + noise.sigmas[choice.bounds[right, 0]]
    halves = np.arccos(cosines) / 2
    starts = points[choice.bounds[left, 0]], points[choice.bounds[right, 1] - 1]
    rooms = np.minimum(*(np.linalg.norm(start - corners, axis=1) for start in starts))
    meet = np.flatnonzero(miss < MISFIT * sigmas)
    rows, sizes = ranges_of(first[meet], end[meet]), end[meet] - first[meet]
    return Bends(
        left=left[meet],
        right=right[meet],
        corners=corners[meet],
        ways=unit(before + behind)[meet],
        inward=unit(behind - before)[meet],
        halves=halves[meet],
        rooms=(rooms / np.tan(halves))[meet],
        stack=Stack(points=points[rows], weights=noise.weights[rows], offsets=offsets_of(sizes)),
    )


def gaps_between(choice: Choice, offsets: IntArray, closed: BoolArray) -> tuple[IntArray, ...]:
    """Lines before and behind each gap of a few outliers, and its range of points."""
    count = len(choice.kinds)
    edges = choice.edges
    left = np.arange(count)
    last = np.diff(edges, append=-1) != 0
    first_of = np.searchsorted(edges, edges)
    right = np.where(last, first_of, np.minimum(left + 1, count - 1))
    first = choice.bounds[:, 1]
    end = np.where(last, offsets[edges + 1], choice.bounds[right, 0])
    # Around the seam of a closed edge, where the next curve begins with the edge's first point.
    seam = last & closed[edges] & (choice.bounds[right, 0] == offsets[edges]) & (right != left)
    sizes = end - first
    keep = (~last | seam) & (sizes >= MIN_POINTS) & (sizes <= MAX_POINTS_BETWEEN)
    keep &= (choice.kinds == LINE) & (choice.kinds[right] == LINE)
    return left[keep], right[keep], first[keep], end[keep]


def directed(points: FloatArray, choice: Choice, lines: IntArray) -> FloatArray:
    """(n, 3) unit directions of lines from their first points to their last."""
    first, last = choice.bounds[lines, 0], choice.bounds[lines, 1] - 1
    ways = choice.frames[lines, 1]
    sign = np.sign(np.einsum("ij,ij->i", points[last] - points[first], ways))
    return np.asarray(unit(ways) * sign[:, None])


def fit_radii(bends: Bends) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit the radius of the tangent arc to the points of each gap by least squares.

    Returns:
        (B,) radii; (N,) squared distances of the points from the arc, in standard deviations;
        (B,) standard deviations of the radii.
    """
    stack, owners = bends.stack, bends.stack.owners
    away = stack.points - bends.corners[owners]
    aside = np.einsum("ij,ij->i", away, bends.inward[owners])
    ahead = np.einsum("ij,ij->i", away, bends.ways[owners])
    off = (away**2).sum(axis=1) - aside**2 - ahead**2
    slope = 1 / np.cos(bends.halves)  # distance of the centre from the corner, in radii
    # The middle of the arc is (slope - 1) radii from the corner.
    radii = np.minimum.reduceat(np.abs(aside), stack.offsets[:-1]) / (slope - 1)
    for step in range(STEPS + 1):
        across = aside - (slope * radii)[owners]
        distance = np.maximum(np.hypot(across, ahead), 1e-300)
        rest = distance - radii[owners]
        change = -slope[owners] * across / distance - 1
        information = np.maximum(stack.sums(stack.weights * change**2), 1e-300)
        if step < STEPS:
            radii = radii - stack.sums(stack.weights * change * rest) / information
    squares = stack.weights * (rest**2 + np.maximum(off, 0))
    return radii, squares, 1 / np.sqrt(information)


def inserted(
    choice: Choice,
    bends: Bends,
    which: IntArray,
    radii: FloatArray,
    sigmas: FloatArray,
    costs: FloatArray,
) -> Choice:
    """The curves with the selected fillets in their places."""
    radii, sigmas, left = radii[which], sigmas[which], bends.left[which]
    slope = 1 / np.cos(bends.halves[which])
    centers = bends.corners[which] + (slope * radii)[:, None] * bends.inward[which]
    axes = -bends.inward[which], bends.ways[which]
    frames = np.stack([centers, *(radii[:, None] * axis for axis in axes)], axis=1)
    middle = choice.sigmas[left, 0]
    columns = np.hypot(slope * sigmas, middle), middle, choice.sigmas[left, 2], sigmas, sigmas
    sizes = np.diff(bends.stack.offsets)[which]
    bounds = choice.bounds[left, 1][:, None] + np.column_stack([0 * sizes, sizes])
    order = np.argsort(np.concatenate([np.arange(len(choice.kinds)), left + 0.5]), kind="stable")
    place = np.argsort(order)
    return replace(
        choice,
        kinds=np.concatenate([choice.kinds, np.full(len(which), ARC)])[order],
        edges=np.concatenate([choice.edges, choice.edges[left]])[order],
        bounds=np.concatenate([choice.bounds, bounds])[order],
        frames=np.concatenate([choice.frames, frames])[order],
        sigmas=np.concatenate([choice.sigmas, np.column_stack(columns)])[order],
        costs=np.concatenate([choice.costs, costs[which]])[order],
        splines={int(place[curve]): fit for curve, fit in choice.splines.items()},
    )
