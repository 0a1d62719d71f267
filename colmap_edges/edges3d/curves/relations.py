"""Relations between curves that the data supports: parallel, perpendicular, coplanar, concentric.

Directions are those of lines and the normals of circles, ellipses and their arcs. Directions that
are equal within their standard deviations are made equal, the most certain first. A curve is
restored if its points then fit significantly worse.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.curves3d import LINE, SPLINE, Curves3D
from colmap_edges.core.polylines import unit
from colmap_edges.edges3d.curves.joints import foot_points
from colmap_edges.edges3d.curves.noise import Noise
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS

MAX_ANGLE = np.radians(5)  # maximum angle between directions made equal, whatever their deviations


def regularized(curves: Curves3D, points: FloatArray, noise: Noise) -> Curves3D:
    """Make curves parallel, perpendicular, coplanar and concentric if they are so within the noise.

    Args:
        curves: curves with ranges into `points`.
        points: (N, 3) edge points.
        noise: the noise of the points.
    """
    sizes = np.linalg.norm(curves.frames[:, 1:], axis=2)
    sized = (sizes[:, 0] > 0) & ((curves.kinds == LINE) | (sizes[:, 1] > 0))
    which = np.flatnonzero((curves.kinds != SPLINE) & np.isfinite(curves.direction_sigmas) & sized)
    if not len(which):
        return curves
    directions, groups = shared_directions(curves, which)
    moved = with_directions(curves, which, directions)
    moved = with_shared_axes_and_planes(moved, which, groups, directions)
    # The mean squared residual may grow by half, beyond what deviations explain.
    worse = residual_squares(moved, points, noise) > 1.5 * np.maximum(
        residual_squares(curves, points, noise), 1.0
    )
    frames = np.where(worse[:, None, None], curves.frames, moved.frames)
    return replace(curves, frames=frames)


def directions_of(curves: Curves3D, which: IntArray) -> FloatArray:
    """(n, 3) unit directions of lines, unit normals of other curves."""
    ways = unit(curves.frames[which, 1])
    return np.where((curves.kinds[which] == LINE)[:, None], ways, curves.normals[which])


def shared_directions(curves: Curves3D, which: IntArray) -> tuple[FloatArray, IntArray]:
    """(n, 3) directions, equal or perpendicular where they agree; (n,) groups of equal ones."""
    directions = directions_of(curves, which)
    sigmas = np.maximum(curves.direction_sigmas[which], 1e-12)
    groups = np.full(len(which), -1)
    means: list[FloatArray] = []
    spreads: list[float] = []
    for place in np.argsort(sigmas, kind="stable").tolist():
        if groups[place] >= 0:
            continue
        open_ = np.flatnonzero(groups < 0)
        cosines = directions[open_] @ directions[place]
        apart = np.arccos(np.minimum(np.abs(cosines), 1))
        limit = np.minimum(OUTLIER_SIGMAS * np.hypot(sigmas[open_], sigmas[place]), MAX_ANGLE)
        members = open_[(apart <= limit) | (open_ == place)]
        signs = np.sign(directions[members] @ directions[place])
        weights = signs / sigmas[members] ** 2
        groups[members] = len(means)
        mean = weights @ directions[members]
        means.append(mean / np.linalg.norm(mean))
        spreads.append(1 / np.sqrt((1 / sigmas[members] ** 2).sum()))
    shared = perpendicular(np.array(means), np.array(spreads), np.bincount(groups))
    aligned = shared[groups]
    aligned *= np.sign(np.einsum("ij,ij->i", aligned, directions))[:, None]
    return aligned, groups


def perpendicular(means: FloatArray, spreads: FloatArray, counts: IntArray) -> FloatArray:
    """(G, 3) directions of groups, made exactly perpendicular where they nearly are.

    In descending order of the numbers of curves, each direction is rotated to be perpendicular to
    at most two earlier ones.
    """
    turned = means.copy()
    done: list[int] = []
    for group in np.argsort(-counts, kind="stable").tolist():
        fixed: list[int] = []
        for other in done:
            off = abs(float(np.arcsin(np.clip(turned[group] @ turned[other], -1, 1))))
            limit = min(OUTLIER_SIGMAS * float(np.hypot(spreads[group], spreads[other])), MAX_ANGLE)
            square = all(abs(turned[other] @ turned[f]) < 1e-9 for f in fixed)
            if off <= limit and square and len(fixed) < 2:
                fixed.append(other)
        for other in fixed:
            turned[group] -= (turned[group] @ turned[other]) * turned[other]
        turned[group] /= np.linalg.norm(turned[group])
        if counts[group] > 1:
            done.append(group)
    return turned


def with_directions(curves: Curves3D, which: IntArray, directions: FloatArray) -> Curves3D:
    """Rotate curves to directions: lines about their midpoints, planes about their centres."""
    frames = curves.frames.copy()
    lines = curves.kinds[which] == LINE
    chosen, ways = which[lines], directions[lines]
    middle = frames[chosen, 0] + frames[chosen, 1] / 2
    length = np.linalg.norm(frames[chosen, 1], axis=1, keepdims=True)
    frames[chosen, 0], frames[chosen, 1] = middle - length / 2 * ways, length * ways
    chosen, normals = which[~lines], directions[~lines]
    sizes = np.linalg.norm(frames[chosen, 1:], axis=2)
    a = frames[chosen, 1]
    a = unit(a - np.einsum("ij,ij->i", a, normals)[:, None] * normals)
    frames[chosen, 1], frames[chosen, 2] = sizes[:, :1] * a, sizes[:, 1:] * np.cross(normals, a)
    return replace(curves, frames=frames)


def with_shared_axes_and_planes(
    curves: Curves3D, which: IntArray, groups: IntArray, directions: FloatArray
) -> Curves3D:
    """Move curves to a common axis or plane where they agree within the noise.

    Circles and arcs are moved to common axes; they, and lines in their planes, to common planes.
    """
    frames, lines = curves.frames.copy(), curves.kinds[which] == LINE
    for group in np.unique(groups[~lines]).tolist():
        normal = directions[groups == group][0]
        circular = (groups == group) & ~lines
        flat = lines & (np.abs(directions @ normal) < 1e-9)
        for members, on_axis in ((circular, True), (circular | flat, False)):
            chosen, straight = which[members], lines[members]
            middle = frames[chosen, 0] + np.where(straight[:, None], frames[chosen, 1] / 2, 0)
            places = np.outer(middle @ normal, normal)
            places = middle - places if on_axis else places
            column = np.where(straight | on_axis, 0, 1)
            sigmas = np.maximum(curves.position_sigmas[chosen, column], 1e-300)
            for part in agreeing(places, sigmas):
                mean = np.average(places[part], axis=0, weights=1 / sigmas[part] ** 2)
                frames[chosen[part], 0] += mean - places[part]
    return replace(curves, frames=frames)


def agreeing(places: FloatArray, sigmas: FloatArray) -> list[IntArray]:
    """Groups of (n, k) positions equal within (n,) standard deviations, the most certain first."""
    tree = cKDTree(places)
    left = np.ones(len(places), bool)
    found = []
    for place in np.argsort(sigmas, kind="stable").tolist():
        if not left[place]:
            continue
        reach = OUTLIER_SIGMAS * float(np.hypot(sigmas[place], sigmas[left].max()))
        near = np.array(sorted(tree.query_ball_point(places[place], reach)), dtype=np.int64)
        apart = np.linalg.norm(places[near] - places[place], axis=1)
        near = near[left[near] & (apart <= OUTLIER_SIGMAS * np.hypot(sigmas[near], sigmas[place]))]
        left[near] = False
        left[place] = False
        if len(near) > 1:
            found.append(near)
    return found


def residual_squares(curves: Curves3D, points: FloatArray, noise: Noise) -> FloatArray:
    """(C,) mean squared distances of points from their curves, in standard deviations.

    For ellipses, the distance from the point at the same angle; 0 for splines.
    """
    on_curves = noise.sequences(points, curves.ranges)
    owners = on_curves.owners
    feet = foot_points(curves.frames[owners], (curves.kinds == LINE)[owners], on_curves.points)
    squares = on_curves.weights * ((on_curves.points - feet) ** 2).sum(axis=1)
    means = on_curves.sums(np.minimum(squares, OUTLIER_SIGMAS**2)) / on_curves.lengths
    return np.where(curves.kinds == SPLINE, 0, means)
