"""Cubic B-splines with as few knots as the points ask for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.curves3d import DEGREE
from colmap_edges.edges3d.curves.stacks import costs_of, softened

FREEDOM = 3  # of a control point; and one more of the spline: where along the edge it ends
ROUNDS = 2  # of weighting
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
    best, size, rises = None, DEGREE + 1, 0
    while size * MIN_SPAN <= len(points) and rises < 2 and spline_price(size, log_count) < most:
        fit = spline_of(points, weights, places, size)
        cost = float(costs_of(weights * fit.squares, share, correlation).sum())
        cost += spline_price(size, log_count)
        rises = 0 if cost < most else rises + 1
        if cost < most:
            most = cost
            best = SplineFit(**{**vars(fit), "cost": cost})
        size = max(size + 1, round(size * GROWTH))
    return best


def spline_price(size: int, log_count: float) -> float:
    """What the parameters of a spline of `size` control points cost."""
    return (FREEDOM * size + 1) * log_count


def spline_of(points: FloatArray, given: FloatArray, places: FloatArray, size: int) -> SplineFit:
    """The spline of `size` control points through (n, 3) points at (n,) ascending places."""
    inner = np.quantile(places, np.linspace(0, 1, size - DEGREE + 1)[1:-1])
    ends = np.full(DEGREE + 1, places[0]), np.full(DEGREE + 1, places[-1])
    knots = np.concatenate([ends[0], inner, ends[1]])
    rows = BSpline.design_matrix(places, knots, DEGREE).toarray()
    weights = given
    for _ in range(ROUNDS):
        weighted = weights[:, None] * rows
        matrix = rows.T @ weighted
        matrix += 1e-12 * np.trace(matrix) / size * np.eye(size)
        inverse = np.linalg.inv(matrix)
        control = inverse @ (weighted.T @ points)
        squares = squared_distances(BSpline(knots, control, DEGREE), rows @ control, places, points)
        weights = softened(given, squares)
    sigmas = np.sqrt(np.diag(inverse))
    return SplineFit(knots=knots, control=control, squares=squares, sigmas=sigmas, cost=np.inf)


def squared_distances(
    spline: BSpline, found: FloatArray, places: FloatArray, points: FloatArray
) -> FloatArray:
    """(n,) squared distances across the curve of (n, 3) points at (n,) places on it."""
    tangents = spline(places, 1)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
    off = points - found
    along = np.einsum("ij,ij->i", off, tangents)
    return np.maximum(np.einsum("ij,ij->i", off, off) - along**2, 0)
