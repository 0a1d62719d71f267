"""Kinds of faces of revolution: the parts of a profile that are lines, arcs or other curves."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.surfaces.revolution.profiles import MAX_OFF, MIN_BINS, Profile
from colmap_edges.surfaces.round_face import RoundFace

LEAST_OFF_PX = 0.4  # root mean square distance from a line or an arc that is allowed anyway
MIN_LINE = 0.5  # minimum share of a line that is a part of the profile
SAME_RADIUS = 0.02  # maximum difference of a cylinder's radii, relative
CENTERED = 0.05  # maximum distance of the centre of a sphere's arc from the axis, in radii of it
MAX_ARC = 4.0  # maximum radius of an arc, in lengths of the profile: longer ones are no arcs
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
        for kind, part in parts_of(points, max(MAX_OFF * profile.deviation, LEAST_OFF_PX))
    ]


def parts_of(points: FloatArray, limit: float) -> list[tuple[str, FloatArray]]:
    """Kinds and profiles of the parts of (n, 2) points within a limit of lines and arcs."""
    for whole in (line_of(points, limit), arc_of(points, limit)):
        if whole:
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
    """The cylinder or cone within a limit of (n, 2) points, or None."""
    places, radii = points.T
    line = np.polynomial.Polynomial.fit(places, radii, 1)
    ends = line(places[[0, -1]])
    slope = float(np.diff(ends)[0] / np.ptp(places))
    off = (radii - line(places)) / np.hypot(1, slope)
    if np.sqrt(np.mean(off**2)) > limit or ends.min() < 0:
        return None
    if abs(ends[1] - ends[0]) < SAME_RADIUS * ends.mean():
        ends[:] = ends.mean()
        return "cylinder", np.column_stack([places[[0, -1]], ends])
    return "cone", np.column_stack([places[[0, -1]], ends])


def arc_of(points: FloatArray, limit: float) -> tuple[str, FloatArray] | None:
    """The sphere or torus within a limit of (n, 2) points, or None."""
    scale = float(np.linalg.norm(points[-1] - points[0]))
    middle = points.mean(axis=0)
    start = np.linalg.lstsq(
        np.column_stack([2 * (points - middle), np.ones(len(points))]),
        ((points - middle) ** 2).sum(axis=1),
        rcond=None,
    )[0]
    center = middle + start[:2]
    radius = float(np.sqrt(max(start[2] + start[:2] @ start[:2], 1e-12)))
    if radius > MAX_ARC * scale:
        return None
    is_sphere = abs(center[1]) < CENTERED * radius

    def off(x: FloatArray) -> FloatArray:
        distances: FloatArray = np.hypot(points[:, 0] - x[0], points[:, 1] - x[2:3].sum()) - x[1]
        return distances

    start = np.array([center[0], radius] if is_sphere else [center[0], radius, center[1]])
    found = least_squares(off, start)
    if np.sqrt(np.mean(found.fun**2)) > limit:
        return None
    center = np.array([found.x[0], found.x[2:3].sum()])
    away = points[[0, len(points) // 2, -1]] - center
    ends = center + found.x[1] * away / np.linalg.norm(away, axis=1, keepdims=True)
    ends[:, 1] = np.where(points[[0, len(points) // 2, -1], 1] == 0, 0, np.maximum(ends[:, 1], 0))
    return ("sphere" if is_sphere else "torus"), ends


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
