"""Robust geometric least-squares fits of lines, circles and tangent arcs, for many at once."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.edges3d.curves.point_sequences import Fits, PointSequences


def fit_lines(points: PointSequences) -> Fits:
    """Fit a line to every sequence by total least squares with robust weights (Huber)."""
    weights = points.weights
    for _ in range(4):
        origins, vectors = points.principal_axes(weights)
        directions = vectors[:, 2]
        q = points.points - origins[points.owners]
        along = np.einsum("ij,ij->i", q, directions[points.owners])
        squares = np.maximum(0, np.einsum("ij,ij->i", q, q) - along**2)
        used, weights = weights, points.robust_weights(squares)
    middle = 1 / np.sqrt(points.sums(used))
    turn = 1 / np.sqrt(np.maximum(points.sums(used * along**2), 1e-300))
    return Fits(
        frames=np.stack([origins, directions, 0 * origins], axis=1),
        sigmas=np.column_stack([middle, middle, turn, 0 * middle, 0 * middle]),
        squares=squares,
    )


def fit_circles(points: PointSequences) -> Fits:
    """Fit a circle to every sequence by Gauss-Newton, on distances in its plane and across it.

    To first order, the plane affects only the distances across it, and centre and radius only
    those in it, so each step solves two systems of three unknowns.
    """
    owners = points.owners
    centers, axes = points.planes(points.weights)
    centers, radii = algebraic_circles(points, centers, axes)
    for _ in range(6):
        local = points.coordinates(centers, axes)
        distance = np.hypot(local[:, 0], local[:, 1])
        squares = (distance - radii[owners]) ** 2 + local[:, 2] ** 2
        weights = points.robust_weights(squares)
        units = local[:, :2] / np.maximum(distance, 1e-300)[:, None]
        rows = np.column_stack([units, np.ones(len(units))])
        flat = np.column_stack([local[:, :2], np.ones(len(local))])
        inside, inside_inverse = points.least_squares(weights, rows, distance - radii[owners])
        off, off_inverse = points.least_squares(weights, flat, local[:, 2])
        limit = 0.5 * radii
        steps = np.clip(inside, -limit[:, None], limit[:, None])
        moved = np.column_stack([steps[:, :2], off[:, 2]])
        centers = centers + np.einsum("sji,sj->si", axes, moved)
        radii = radii + steps[:, 2]
        axes = tilted(axes, off[:, :2])
    half = radii[:, None, None] * axes[:, :2]
    return Fits(
        frames=np.concatenate([centers[:, None], half], axis=1),
        sigmas=circle_sigmas(inside_inverse, off_inverse),
        squares=squares,
    )


def circle_sigmas(inside: FloatArray, off: FloatArray) -> FloatArray:
    """(S, 5) standard deviations from (S, 3, 3) covariances in the plane and across it."""
    inside, off = (np.einsum("sii->si", each) for each in (inside, off))
    center, radius = inside[:, :2].sum(axis=1) / 2, inside[:, 2]
    columns = (center, off[:, 2], off[:, :2].sum(axis=1) / 2, radius, radius)
    return np.asarray(np.sqrt(np.maximum(np.column_stack(columns), 0)))


def algebraic_circles(
    points: PointSequences, origins: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Centres (S, 3) and radii (S,) by Kasa's linear fit in the planes through the origins."""
    weights = points.weights
    local = points.coordinates(origins, axes)[:, :2]
    size = np.sqrt(points.sums(weights * (local**2).sum(axis=1)) / points.sums(weights))
    size = np.maximum(size, 1e-300)
    local = local / size[points.owners][:, None]
    rows = np.column_stack([2 * local, np.ones(len(local))])
    found, _ = points.least_squares(weights, rows, (local**2).sum(axis=1))
    radii = np.sqrt(np.maximum(found[:, 2] + (found[:, :2] ** 2).sum(axis=1), 1e-12))
    moved = np.einsum("sji,sj->si", axes[:, :2], found[:, :2] * size[:, None])
    return origins + moved, radii * size


def tilted(axes: FloatArray, slopes: FloatArray) -> FloatArray:
    """(S, 3, 3) axes of planes with (S, 2) slopes along the first two axes."""
    slopes = np.clip(slopes, -1, 1)
    first = axes[:, 0] + slopes[:, :1] * axes[:, 2]
    second = axes[:, 1] + slopes[:, 1:] * axes[:, 2]
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    normal = np.cross(first, second)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], axis=1)


def fit_tangent_arcs(
    points: PointSequences, corners: FloatArray, axes: FloatArray, slopes: FloatArray
) -> Fits:
    """Fit the radius of an arc that is tangent to two lines to every sequence.

    Args:
        points: the sequences.
        corners: (S, 3) meeting points of the lines.
        axes: (S, 2, 3) unit directions from the corner to the centre, and along the arc's middle.
        slopes: (S,) distances of the centre from the corner, in radii.

    Returns:
        The arcs; only the deviations of their radii are known, others are 0. Deviations are
        1e300 where no radius is positive.
    """
    away = points.points - corners[points.owners]
    aside, ahead = np.einsum("nki,ni->kn", axes[points.owners], away)
    off = (away**2).sum(axis=1) - aside**2 - ahead**2
    # The middle of the arc is (slope - 1) radii from the corner.
    radii = np.minimum.reduceat(np.abs(aside), points.offsets[:-1]) / (slopes - 1)
    change_of_radii = np.zeros(points.size)
    for _ in range(9):
        radii = radii + change_of_radii
        across = aside - (slopes * radii)[points.owners]
        distance = np.maximum(np.hypot(across, ahead), 1e-300)
        rest = distance - radii[points.owners]
        change = -slopes[points.owners] * across / distance - 1
        information = np.maximum(points.sums(points.weights * change**2), 1e-300)
        change_of_radii = -points.sums(points.weights * change * rest) / information
    centers = corners + (slopes * radii)[:, None] * axes[:, 0]
    half = radii[:, None, None] * axes * np.array([[-1], [1]])
    sigmas = np.where(radii > 0, 1 / np.sqrt(information), 1e300)
    return Fits(
        frames=np.concatenate([centers[:, None], half], axis=1),
        sigmas=sigmas[:, None] * [0.0, 0.0, 0.0, 1.0, 1.0],
        squares=rest**2 + np.maximum(off, 0),
    )
