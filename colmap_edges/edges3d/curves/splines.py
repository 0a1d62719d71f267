"""Cubic B-splines with as few knots as the points ask for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.interpolate import BSpline

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.curves3d import DEGREE
from colmap_edges.edges3d.curves.stacks import Stack, costs_of, softened, solved

FREEDOM = 3  # of a control point; and one more of the spline: where along the edge it ends
ROUNDS = 3  # of weighting, and of moving the places of points along the curve
GROWTH = 1.35  # from one number of control points that is tried to the next
MIN_SPAN = 2.5  # points for each control point at least


@dataclass(frozen=True, kw_only=True)
class SplineFit:
    """One spline.

    Attributes:
        knots: (m + 4,) from 0 to about the length of the curve.
        control: (m, 3) control points.
        squares: (n,) squared distances of the points.
        sigmas: (m,) deviations of the control points in each direction.
        cost: sum of bounded squares plus the price of its parameters.
    """

    knots: FloatArray
    control: FloatArray
    squares: FloatArray
    sigmas: FloatArray
    cost: float


def fit_spline(
    points: FloatArray,
    weights: FloatArray,
    log_count: float,
    share: float,
    correlation: float,
    most: float,
) -> SplineFit | None:
    """Fit the spline of least cost (BIC) to (n, 3) points in their order.

    Args:
        points: the points.
        weights: (n,) one over the squares of their deviations.
        log_count: what a parameter costs.
        share: what the squares of residuals are divided by.
        correlation: number of successive points that say as much as one.
        most: cost that it must be below.

    Returns:
        The spline, None where none costs less.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    places = np.concatenate([[0], np.cumsum(steps)])
    best, size, before = None, DEGREE + 1, np.inf
    while size * MIN_SPAN <= len(points) and spline_price(size, log_count) < most:
        fit = spline_of(points, weights, places, size)
        cost = float(costs_of(weights * fit.squares, share, correlation).sum())
        cost += spline_price(size, log_count)
        if cost > before:
            break
        before = cost
        if cost < most:
            most = cost
            best = SplineFit(**{**vars(fit), "cost": cost})
        size = max(size + 1, round(size * GROWTH))
    return best


def smooth_squares(stack: Stack, degree: int) -> FloatArray:
    """(N,) squared distances of a stack's points from the polynomials of a degree through each.

    No spline of few control points is much nearer to them, so where these are too far, all are.
    """
    steps = np.linalg.norm(np.diff(stack.points, axis=0, prepend=stack.points[:1]), axis=1)
    along = np.cumsum(steps)
    first, last = along[stack.offsets[:-1]], along[stack.offsets[1:] - 1]
    half = np.maximum((last - first) / 2, 1e-300)
    rows = chebvander(((along - first[stack.owners]) / half[stack.owners] - 1), degree)
    weights = stack.weights
    for _ in range(2):
        matrices = stack.sums(np.einsum("i,ij,ik->ijk", weights, rows, rows))
        values = stack.sums(np.einsum("i,ij,ik->ijk", weights, rows, stack.points))
        _, inverses = solved(matrices, values[:, :, 0])
        found = np.einsum("ij,ijk->ik", rows, (inverses @ values)[stack.owners])
        squares: FloatArray = ((stack.points - found) ** 2).sum(axis=1)
        weights = softened(stack.weights, squares)
    return squares


def spline_price(size: int, log_count: float) -> float:
    """What the parameters of a spline of `size` control points cost."""
    return (FREEDOM * size + 1) * log_count


def spline_of(points: FloatArray, given: FloatArray, places: FloatArray, size: int) -> SplineFit:
    """The spline of `size` control points through (n, 3) points at (n,) ascending places."""
    shares = np.linspace(0, len(places) - 1, size - DEGREE + 1)[1:-1]
    inner = np.interp(shares, np.arange(len(places)), places)
    ends = np.full(DEGREE + 1, places[0]), np.full(DEGREE + 1, places[-1])
    knots = np.concatenate([ends[0], inner, ends[1]])
    basis = BSpline(knots, np.eye(size), DEGREE)
    weights, at = given, places
    for _ in range(ROUNDS):
        rows = basis(at)
        weighted = weights[:, None] * rows
        matrix = rows.T @ weighted
        matrix += 1e-12 * np.trace(matrix) / size * np.eye(size)
        inverse = np.linalg.inv(matrix)
        control = inverse @ (weighted.T @ points)
        squares, along = distances_of(rows @ control, points)
        weights = softened(given, squares)
        at = np.clip(at + along, places[0], places[-1])  # nearer to where the points are nearest
    sigmas = np.sqrt(np.diag(inverse))
    return SplineFit(knots=knots, control=control, squares=squares, sigmas=sigmas, cost=np.inf)


def distances_of(found: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) squared distances of (n, 3) points across a curve through (n, 3) ones found on it.

    Also (n,) how far along it they are from those.
    """
    tangents = np.gradient(found, axis=0)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
    off = points - found
    along: FloatArray = np.einsum("ij,ij->i", off, tangents)
    return np.maximum(np.einsum("ij,ij->i", off, off) - along**2, 0), along
