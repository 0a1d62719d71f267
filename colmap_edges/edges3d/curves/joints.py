"""Joints of consecutive curves of an edge: both are extended to a common point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.curves3d import CIRCLE, ELLIPSE, LINE, SPLINE, Curves3D
from colmap_edges.edges3d.curves.noise import Noise
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS

# maximum number of points between two curves that meet, such as at a rounded corner
MAX_POINTS_BETWEEN = 8


def joined_at_corners(curves: Curves3D, points: FloatArray, noise: Noise) -> Curves3D:
    """Extend or shorten consecutive curves to their common point, if they meet within the noise.

    The common point is found by alternating projections onto both curves. Splines are not changed:
    the other curve is extended to them. Ends of lines are moved to the point itself.

    Args:
        curves: curves with ranges into `points`, in order along each edge.
        points: (N, 3) edge points in that order.
        noise: the noise of the points.
    """
    left, right = joints_of(curves)
    if not len(left):
        return curves
    ends = curves.ends()
    at_left, at_right = ends[left, 1], ends[right, 0]
    starts = at_left.copy(), at_right.copy()
    for _ in range(30):
        middle = (at_left + at_right) / 2
        at_left = nearest_on(curves, left, middle, starts[0])
        at_right = nearest_on(curves, right, middle, starts[1])
    sigmas = noise.sigmas[curves.ranges[left, 1] - 1] + noise.sigmas[curves.ranges[right, 0]]
    meet = np.linalg.norm(at_left - at_right, axis=1) < OUTLIER_SIGMAS * sigmas
    place = np.where(is_line(curves, right)[:, None], at_left, at_right)
    both = is_line(curves, left) & is_line(curves, right)
    place[both] = ((at_left + at_right) / 2)[both]
    curves = with_ends(curves, left[meet], place[meet], 1)
    return with_ends(curves, right[meet], place[meet], 0)


def joints_of(curves: Curves3D) -> tuple[IntArray, IntArray]:
    """(J,) curves and (J,) their successors on the same edge, with a gap of few points at most."""
    follows = curves.edges[1:] == curves.edges[:-1]
    between = curves.ranges[1:, 0] - curves.ranges[:-1, 1]
    closed = (curves.kinds == CIRCLE) | (curves.kinds == ELLIPSE)
    follows &= (between <= MAX_POINTS_BETWEEN) & ~closed[1:] & ~closed[:-1]
    left = np.flatnonzero(follows)
    return left, left + 1


def is_line(curves: Curves3D, which: IntArray) -> BoolArray:
    """(J,) whether these curves are lines."""
    return np.asarray(curves.kinds[which] == LINE)


def nearest_on(
    curves: Curves3D, which: IntArray, targets: FloatArray, ends: FloatArray
) -> FloatArray:
    """(J, 3) nearest points to (J, 3) targets on (J,) curves, which are extended as needed.

    For ellipses, approximately: the point at the same angle. Splines are not extended: their end.
    """
    found = foot_points(curves.frames[which], is_line(curves, which), targets)
    return np.where((curves.kinds[which] == SPLINE)[:, None], ends, found)


def foot_points(frames: FloatArray, straight: BoolArray, points: FloatArray) -> FloatArray:
    """(n, 3) nearest points to (n, 3) points on the whole lines or circles of (n, 3, 3) frames."""
    along, aside = coordinates_in(frames, points)
    angles = np.arctan2(aside, along)
    x, y = np.where(straight, along, np.cos(angles)), np.where(straight, 0, np.sin(angles))
    origin, a, b = np.moveaxis(frames, 1, 0)
    return np.asarray(origin + x[:, None] * a + y[:, None] * b)


def coordinates_in(frames: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) and (n,) coordinates of (n, 3) points along the half axes of (n, 3, 3) frames."""
    origin, *axes = np.moveaxis(frames, 1, 0)
    q = points - origin
    x, y = (
        np.einsum("ij,ij->i", q, of) / np.maximum(np.einsum("ij,ij->i", of, of), 1e-300)
        for of in axes
    )
    return x, y


def with_ends(curves: Curves3D, which: IntArray, places: FloatArray, side: int) -> Curves3D:
    """Set the start (side 0) or end (side 1) of (J,) curves to (J, 3) points."""
    frames, spans = curves.frames.copy(), curves.spans.copy()
    lines = is_line(curves, which)
    straight, round_ = which[lines], which[~lines & (curves.kinds[which] != SPLINE)]
    first, last = frames[straight, 0], frames[straight].sum(axis=1)  # b of lines is 0
    if side == 0:
        frames[straight, 0], frames[straight, 1] = places[lines], last - places[lines]
    else:
        frames[straight, 1] = places[lines] - first
    targets = places[~lines & (curves.kinds[which] != SPLINE)]
    along, aside = coordinates_in(frames[round_], targets)
    now = spans[round_, side]
    turn = np.arctan2(aside, along) - now
    spans[round_, side] = now + (turn + np.pi) % (2 * np.pi) - np.pi
    return replace(curves, frames=frames, spans=spans)
