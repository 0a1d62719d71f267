"""Robust geometric least-squares fits of ellipses, for many stretches at once."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.core.polylines import unit
from colmap_edges.edges3d.curves.point_sequences import Fits, PointSequences


def fit_ellipses(points: PointSequences) -> Fits:
    """Fit an ellipse to every sequence, by distances in its plane and across it."""
    owners = points.owners
    origins, axes = points.planes(points.weights)
    local = points.coordinates(origins, axes)
    rows = np.column_stack([local[:, :2], np.ones(len(local))])
    flat_weights = points.robust_weights(local[:, 2] ** 2)
    slopes, flat_inverse = points.least_squares(flat_weights, rows, local[:, 2])
    height = local[:, 2] - np.einsum("ij,ij->i", rows, slopes[owners])
    shapes, found = algebraic_ellipses(points, local[:, :2])
    for _ in range(10):
        distances, jacobian = residuals(shapes[owners], local[:, :2])
        weights = points.robust_weights(distances**2 + height**2)
        moves, inverse = points.least_squares(weights, jacobian, distances)
        # A step changes the radii by at most 0.3 of the smaller one.
        limit = 0.3 * np.abs(shapes[:, 2:4]).min(axis=1, keepdims=True)
        shapes = shapes + np.clip(moves, -limit, limit)
        radii = np.sort(np.abs(shapes[:, 2:4]), axis=1)
        # Flatter ellipses are double lines.
        found &= np.isfinite(shapes).all(axis=1) & (radii[:, 1] < 20.0 * radii[:, 0])
        shapes[~found] = (0, 0, 1, 1, 0)
    distances, _ = residuals(shapes[owners], local[:, :2])
    inside, off = (np.einsum("sii->si", each) for each in (inverse, flat_inverse))
    variances = [inside[:, :2].mean(axis=1), off[:, 2], off[:, :2].mean(axis=1), *inside[:, 2:4].T]
    frames, sigmas = frames_of(shapes, slopes, origins, axes, np.sqrt(np.abs(variances)).T)
    sigmas[~found] = np.inf
    return Fits(frames=frames, squares=distances**2 + height**2, sigmas=sigmas)


def frames_of(
    shapes: FloatArray,
    slopes: FloatArray,
    origins: FloatArray,
    axes: FloatArray,
    sigmas: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(S, 3, 3) centres and half axes in space, the longer first, and (S, 5) sigmas in that order.

    Args:
        shapes: (S, 5) centre, radii and rotation angle in the planes.
        slopes: (S, 3) slopes of the planes along the first two axes, and height at the origins.
        origins: (S, 3) origins of these coordinates.
        axes: (S, 3, 3) their axes.
        sigmas: (S, 5) as in `Fits`, with the radii in the order of `shapes`.
    """
    turn = shapes[:, 4]
    ways = np.stack([np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)], axis=1)
    ways = ways.reshape(-1, 2, 2)
    lifted = np.concatenate(
        [ways, np.einsum("sij,sj->si", ways, slopes[:, :2])[:, :, None]], axis=2
    )
    lifted[:, 0] /= np.linalg.norm(lifted[:, 0], axis=1, keepdims=True)
    along = np.einsum("si,si->s", lifted[:, 0], lifted[:, 1])
    lifted[:, 1] -= along[:, None] * lifted[:, 0]
    lifted[:, 1] /= np.linalg.norm(lifted[:, 1], axis=1, keepdims=True)
    half = np.einsum("sij,sjk->sik", np.abs(shapes[:, 2:4, None]) * lifted, axes)
    height = np.einsum("si,si->s", slopes[:, :2], shapes[:, :2]) + slopes[:, 2]
    centers = np.column_stack([shapes[:, :2], height])
    frames = np.concatenate([(origins + np.einsum("sj,sjk->sk", centers, axes))[:, None], half], 1)
    swapped = np.abs(shapes[:, 2]) < np.abs(shapes[:, 3])
    frames[swapped] = frames[swapped][:, [0, 2, 1]]
    sigmas[swapped] = sigmas[swapped][:, [0, 1, 2, 4, 3]]
    return frames, sigmas


def residuals(shapes: FloatArray, plane: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (n,) of (n, 2) points from their (n, 5) ellipses; Jacobian (n, 5).

    Foot points are found by Newton's method on their angles.
    """
    a, b, turn = shapes[:, 2:].T
    c, s = np.cos(turn), np.sin(turn)
    x, y = (plane - shapes[:, :2]).T
    u, v = x * c + y * s, y * c - x * s
    t = np.arctan2(v * a, u * b)
    for _ in range(4):
        cos, sin = np.cos(t), np.sin(t)
        slope = (u - a * cos) * a * sin - (v - b * sin) * b * cos
        bend = (a * sin) ** 2 + (b * cos) ** 2 + (u - a * cos) * a * cos + (v - b * sin) * b * sin
        t = t - np.clip(slope / np.where(np.abs(bend) > 1e-300, bend, 1), -0.5, 0.5)
    cos, sin = np.cos(t), np.sin(t)
    normal = unit(np.column_stack([b * cos, a * sin]))
    p, q = normal.T
    distances = (u - a * cos) * p + (v - b * sin) * q
    columns = (p * c - q * s, p * s + q * c, p * cos, q * sin, q * a * cos - p * b * sin)
    return distances, np.column_stack(columns)


def algebraic_ellipses(points: PointSequences, plane: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Halir and Flusser's direct fits (1998) to sequences of (N, 2) points.

    Returns:
        (S, 5) centre, radii and rotation angle, and (S,) whether the conic is an ellipse.
    """
    ones = np.ones(len(plane))
    counts = points.sums(ones)
    size = np.sqrt(points.sums((plane**2).sum(axis=1)) / counts)
    size = np.maximum(size, 1e-300)
    x, y = (plane / size[points.owners][:, None]).T
    monomials = np.column_stack([x * x, x * y, y * y, x, y, ones])
    scatter = points.sums(np.einsum("ij,ik->ijk", monomials, monomials))
    mixed, flat = scatter[:, :3, 3:], scatter[:, 3:, 3:]
    flat = flat + 1e-12 * np.trace(flat, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    back = -np.linalg.solve(flat, np.swapaxes(mixed, 1, 2))
    reduced = scatter[:, :3, :3] + mixed @ back
    constraint = np.array([[0, 0, 0.5], [0, -1, 0], [0.5, 0, 0]])
    vectors = np.swapaxes(np.linalg.eig(constraint @ reduced)[1].real, 1, 2)
    level = 4 * vectors[:, :, 0] * vectors[:, :, 2] - vectors[:, :, 1] ** 2
    best = np.take_along_axis(vectors, np.argmax(level, axis=1)[:, None, None], axis=1)[:, 0]
    linear = np.einsum("sij,sj->si", back, best)
    form = np.stack([best[:, 0], best[:, 1] / 2, best[:, 1] / 2, best[:, 2]], 1).reshape(-1, 2, 2)
    found = level.max(axis=1) > 1e-12
    form[~found] = np.eye(2)
    center = -0.5 * np.linalg.solve(form, linear[:, :2, None])[:, :, 0]
    constant = np.einsum("si,sij,sj->s", center, form, center) - linear[:, 2]
    found &= np.abs(constant) > 1e-300
    values, axes = np.linalg.eigh(form / np.where(found, constant, 1)[:, None, None])
    found &= (values > 0).all(axis=1)
    radii = 1 / np.sqrt(np.where(found[:, None], values, 1))
    # Copies: functions of strided arrays may differ between runs in their last bits (NumPy 1.26).
    turn = np.arctan2(axes[:, 1, 0].copy(), axes[:, 0, 0].copy())
    shapes = np.column_stack([center * size[:, None], radii * size[:, None], turn])
    shapes[~found] = (0, 0, 1, 1, 0)
    return shapes, found
