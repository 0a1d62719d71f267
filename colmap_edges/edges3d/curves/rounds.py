"""Robust geometric least-squares fits of lines and circles, for many stretches at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.edges3d.curves.stacks import Stack, softened, solved

LINE_STEPS = 4  # iterations of the fit of a line
CIRCLE_STEPS = 6  # iterations of the fit of a circle


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Lines fitted to S sequences of points.

    Attributes:
        origins, directions: (S, 3) weighted mean of the points, and unit direction.
        squares: (N,) squared distances of the stack's points.
        middle_sigmas, direction_sigmas: (S,) standard deviations of the origin across the line, and
            of the direction (radians).
    """

    origins: FloatArray
    directions: FloatArray
    squares: FloatArray
    middle_sigmas: FloatArray
    direction_sigmas: FloatArray


@dataclass(frozen=True, kw_only=True)
class Circles:
    """Circles fitted to S sequences of points.

    Attributes:
        centers: (S, 3).
        axes: (S, 3, 3) unit rows: two in the plane, and its normal.
        radii: (S,).
        squares: (N,) squared distances of the stack's points.
        sigmas: (S, 4) standard deviations of the centre in the plane and across it, of the normal
            (radians), and of the radius.
    """

    centers: FloatArray
    axes: FloatArray
    radii: FloatArray
    squares: FloatArray
    sigmas: FloatArray


def fit_lines(stack: Stack) -> Lines:
    """Fit a line to every sequence by total least squares with robust weights (Huber)."""
    weights, owners = stack.weights, stack.owners
    for _ in range(LINE_STEPS):
        origins, vectors = principal_axes(stack, weights)
        directions = vectors[:, 2]
        q = stack.points - origins[owners]
        along = np.einsum("ij,ij->i", q, directions[owners])
        squares = np.maximum(0, np.einsum("ij,ij->i", q, q) - along**2)
        used, weights = weights, softened(stack.weights, squares)
    return Lines(
        origins=origins,
        directions=directions,
        squares=squares,
        middle_sigmas=1 / np.sqrt(stack.sums(used)),
        direction_sigmas=1 / np.sqrt(np.maximum(stack.sums(used * along**2), 1e-300)),
    )


def principal_axes(stack: Stack, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(S, 3) weighted means and (S, 3, 3) unit rows, the direction of largest spread last."""
    totals = stack.sums(weights)[:, None]
    origins = stack.sums(weights[:, None] * stack.points) / totals
    q = stack.points - origins[stack.owners]
    spread = stack.products(weights, q, q) / totals[:, :, None]
    return origins, np.swapaxes(np.linalg.eigh(spread)[1], 1, 2)


def fit_circles(stack: Stack) -> Circles:
    """Fit a circle to every sequence by Gauss-Newton, on distances in its plane and across it.

    To first order, the plane affects only the distances across it, and centre and radius only
    those in it, so each step solves two systems of three unknowns.
    """
    weights, owners = stack.weights, stack.owners
    centers, vectors = principal_axes(stack, weights)
    axes = np.stack([vectors[:, 2], vectors[:, 1], np.cross(vectors[:, 2], vectors[:, 1])], axis=1)
    centers, radii = algebraic_circles(stack, centers, axes)
    for _ in range(CIRCLE_STEPS):
        local = np.einsum("ijk,ik->ij", axes[owners], stack.points - centers[owners])
        distance = np.hypot(local[:, 0], local[:, 1])
        squares = (distance - radii[owners]) ** 2 + local[:, 2] ** 2
        weights = softened(stack.weights, squares)
        units = local[:, :2] / np.maximum(distance, 1e-300)[:, None]
        rows = np.column_stack([units, np.ones(len(units))])
        flat = np.column_stack([local[:, :2], np.ones(len(local))])
        inside, inside_inverse = least_squares(stack, weights, rows, distance - radii[owners])
        off, off_inverse = least_squares(stack, weights, flat, local[:, 2])
        limit = 0.5 * radii
        steps = np.clip(inside, -limit[:, None], limit[:, None])
        moved = np.column_stack([steps[:, :2], off[:, 2]])
        centers = centers + np.einsum("sji,sj->si", axes, moved)
        radii = radii + steps[:, 2]
        axes = tilted(axes, off[:, :2])
    return Circles(
        centers=centers,
        axes=axes,
        radii=radii,
        squares=squares,
        sigmas=circle_sigmas(inside_inverse, off_inverse),
    )


def circle_sigmas(inside: FloatArray, off: FloatArray) -> FloatArray:
    """(S, 4) standard deviations from (S, 3, 3) covariances in the plane and across it."""
    inside, off = (np.einsum("sii->si", each) for each in (inside, off))
    columns = (inside[:, :2].sum(axis=1) / 2, off[:, 2], off[:, :2].sum(axis=1) / 2, inside[:, 2])
    return np.asarray(np.sqrt(np.maximum(np.column_stack(columns), 0)))


def least_squares(
    stack: Stack, weights: FloatArray, rows: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(S, 3) weighted least-squares solutions for (N, 3) rows and (N,) values; covariances."""
    normal = stack.products(weights, rows, rows)
    return solved(normal, stack.sums((weights * values)[:, None] * rows))


def algebraic_circles(
    stack: Stack, origins: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Centres (S, 3) and radii (S,) by Kasa's linear fit in the planes through the origins."""
    owners = stack.owners
    local = np.einsum("ijk,ik->ij", axes[owners], stack.points - origins[owners])[:, :2]
    size = np.sqrt(stack.sums(stack.weights * (local**2).sum(axis=1)) / stack.sums(stack.weights))
    size = np.maximum(size, 1e-300)
    local = local / size[owners][:, None]
    rows = np.column_stack([2 * local, np.ones(len(local))])
    found, _ = least_squares(stack, stack.weights, rows, (local**2).sum(axis=1))
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
