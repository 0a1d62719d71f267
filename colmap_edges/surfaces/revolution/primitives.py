"""Kinds of faces of revolution: the parts of a profile that are lines, arcs or other curves."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.polylines import unit
from colmap_edges.surfaces.revolution.profiles import MIN_BINS, Profile
from colmap_edges.surfaces.round_face import RoundFace

MAX_OFF_PX = 0.5  # maximum root mean square distance of a profile from a line or an arc
MIN_LINE = 0.5  # minimum share of a line that is a part of the profile
NUM_KNOTS = 12  # maximum number of points of other profiles


def faces_of(profile: Profile, views: IntArray) -> list[RoundFace]:
    """The faces of a body, along its axis.

    Args:
        profile: its profile.
        views: the views that show outlines on both sides of it.
    """
    points = np.column_stack([profile.places, profile.radii])
    return [
        RoundFace(
            kind=kind,
            point=profile.axis.point,
            direction=profile.axis.direction,
            profile=part * profile.axis.pixel,
            views=views,
        )
        for kind, part in parts_of(points, MAX_OFF_PX)
    ]


def parts_of(points: FloatArray, limit: float) -> list[tuple[str, FloatArray]]:
    """Kinds and profiles of the parts of (n, 2) points within a limit of lines and arcs."""
    if whole := line_of(points, limit) or arc_of(points, limit):
        return [whole]
    first, last = longest_line(points, limit)
    if last - first < max(MIN_LINE * len(points), MIN_BINS):
        return [("revolution", curve_of(points))]
    found = []
    for part in (points[: first + 1], points[first:last], points[last - 1 :]):
        if len(part) >= MIN_BINS:
            found += parts_of(part, limit)
    return found


def line_of(points: FloatArray, limit: float) -> tuple[str, FloatArray] | None:
    """The cylinder, or else the cone, within a limit of (n, 2) points, or None."""
    places, radii = points.T
    for degree, kind in enumerate(("cylinder", "cone")):
        line = np.polynomial.Polynomial.fit(places, radii, degree)
        off = (radii - line(places)) / np.hypot(1, line.deriv()(0))
        ends = np.column_stack([places, line(places)])[[0, -1]]
        if np.sqrt(np.mean(off**2)) <= limit and ends[:, 1].min() >= 0:
            return kind, ends
    return None


def arc_of(points: FloatArray, limit: float) -> tuple[str, FloatArray] | None:
    """The sphere, or else the torus, within a limit of (n, 2) points, or None."""
    middle = points.mean(axis=0)
    away = points - middle
    matrix = np.column_stack([2 * away, np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(matrix, (away**2).sum(axis=1), rcond=None)[0]
    radius = np.sqrt(max(rest + x**2 + y**2, 1e-12))
    start = np.array([middle[0] + x, radius, middle[1] + y])

    def off(x: FloatArray) -> FloatArray:
        distances: FloatArray = np.hypot(points[:, 0] - x[0], points[:, 1] - x[2:].sum()) - x[1]
        return distances

    for count, kind in ((2, "sphere"), (3, "torus")):  # the centre of a sphere is on the axis
        found = least_squares(off, start[:count])
        if np.sqrt(np.mean(found.fun**2)) <= limit:
            center, own = (
                np.array([found.x[0], found.x[2:].sum()]),
                points[[0, len(points) // 2, -1]],
            )
            ends = center + found.x[1] * unit(own - center)
            ends[:, 1] = np.where(own[:, 1] == 0, 0, np.maximum(ends[:, 1], 0))
            return kind, ends
    return None


def longest_line(points: FloatArray, limit: float) -> tuple[int, int]:
    """First index of the longest run of (n, 2) points within a limit of a line, and its end."""
    sums = np.zeros((len(points) + 1, 5))
    places, radii = (points - points.mean(axis=0)).T
    terms = np.column_stack([places, radii, places**2, places * radii, radii**2])
    np.cumsum(terms, axis=0, out=sums[1:])
    first, last = np.triu_indices(len(points) + 1, MIN_BINS)
    counts = last - first
    x, y, xx, xy, yy = (sums[last] - sums[first]).T / counts
    xx, xy, yy = xx - x**2, xy - x * y, yy - y**2
    # The smaller eigenvalue of the covariance.
    across = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    straight = np.sqrt(np.maximum(across, 0)) <= limit
    if not straight.any():
        return 0, 0
    best = int(np.argmax(np.where(straight, counts, -1)))
    return int(first[best]), int(last[best])


def curve_of(points: FloatArray) -> FloatArray:
    """(m, 2) points of a smooth curve through (n, 2) points, fewer and without their noise."""
    count = min(NUM_KNOTS, len(points))
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, arc[-1], count)
    width = arc[-1] / count / 2
    weights = np.exp(-(((at[:, None] - arc) / width) ** 2) / 2)
    inner = weights @ points / weights.sum(axis=1, keepdims=True)
    return np.concatenate([points[:1], inner[1:-1], points[-1:]])
