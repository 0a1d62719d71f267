"""Fits of cubic B-splines with as few knots as the points require."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.curves3d import DEGREE
from colmap_edges.core.polylines import unit
from colmap_edges.edges3d.curves.noise import Noise
from colmap_edges.edges3d.curves.point_sequences import PointSequences


@dataclass(frozen=True, kw_only=True)
class SplineFit:
    """A fitted cubic B-spline.

    Attributes:
        knots: (m + 4,) from 0 to about the length of the curve.
        control: (m, 3) control points.
        sigmas: (m,) standard deviations of the control points in each coordinate.
        cost: sum of truncated squared residuals plus the cost of its parameters.
    """

    knots: FloatArray
    control: FloatArray
    sigmas: FloatArray
    cost: float


def fit_splines(
    points: PointSequences, noise: Noise, prices: FloatArray, max_costs: FloatArray
) -> dict[int, SplineFit]:
    """Fit the spline of least cost (BIC) to each of S sequences of points.

    Args:
        points: the sequences.
        noise: the noise of edge points.
        prices: (S,) cost of one parameter.
        max_costs: (S,) upper limits of the costs.

    Returns:
        Splines by index of the sequence; only those below the limits.
    """
    lengths, most = points.lengths, max_costs.copy()
    before = np.full(points.size, np.inf)
    found: dict[int, SplineFit] = {}
    rows, size = np.arange(points.size), DEGREE + 1
    while True:
        # At least 2.5 points per control point.
        rows = rows[size * 2.5 <= lengths[rows]]
        rows = rows[num_parameters(size) * prices[rows] < most[rows]]
        if not len(rows):
            return found
        part = points.select(rows)
        knots, control, squares, sigmas = splines_of(part, size)
        costs = noise.costs(part, squares) + num_parameters(size) * prices[rows]
        for at in np.flatnonzero(costs < np.minimum(most, before)[rows]).tolist():
            found[int(rows[at])] = SplineFit(
                knots=knots[at], control=control[at], sigmas=sigmas[at], cost=float(costs[at])
            )
        going_on = costs <= before[rows]
        before[rows], most[rows] = costs, np.minimum(most[rows], costs)
        rows = rows[going_on]
        size = max(size + 1, round(size * 1.35))


def num_parameters(size: int) -> int:
    """Number of parameters of a spline with `size` control points; one is its end on the edge."""
    return 3 * size + 1


def splines_of(
    points: PointSequences, size: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit splines with `size` control points to all sequences of points.

    Returns:
        (S, size + 4) knots, (S, size, 3) control points, (N,) squared distances of the points, and
        (S, size) standard deviations of the control points.
    """
    offsets, owners = points.offsets, points.owners
    places = lengths_along(points)
    knots = knots_of(places, offsets, size)
    weights, at = points.weights, places
    for _ in range(3):  # reweighting, and updates of the parameters of points
        rows = basis_of(knots, owners, at)
        matrices = points.products(weights, rows, rows)
        traces = np.trace(matrices, axis1=1, axis2=2)
        matrices += 1e-12 * traces[:, None, None] / size * np.eye(size)
        inverses = np.linalg.inv(matrices)
        control = inverses @ points.products(weights, rows, points.points)
        squares, along = distances_of(np.einsum("ij,ijk->ik", rows, control[owners]), points)
        weights = points.robust_weights(squares)
        # Move parameters towards the foot points.
        at = np.clip(at + along, 0, knots[owners, -1])
    sigmas = np.sqrt(np.einsum("sii->si", inverses))
    return knots, control, squares, sigmas


def lengths_along(points: PointSequences) -> FloatArray:
    """(N,) arc length of each point along the polyline of its sequence."""
    along = np.zeros(len(points.points))
    along[1:] = np.cumsum(np.linalg.norm(np.diff(points.points, axis=0), axis=1))
    return along - along[points.offsets[:-1]][points.owners]


def knots_of(places: FloatArray, offsets: IntArray, size: int) -> FloatArray:
    """(S, size + 4) knots with equal numbers of the (N,) parameters between them."""
    last = (offsets[1:] - 1 - offsets[:-1])[:, None]
    inner = last * np.linspace(0, 1, size - DEGREE + 1)[1:-1]
    left = np.minimum(inner.astype(np.int64), last - 1)
    low, high = (places[offsets[:-1, None] + left + step] for step in (0, 1))
    ends = (
        np.zeros((len(last), DEGREE + 1)),
        np.repeat(places[offsets[1:, None] - 1], DEGREE + 1, 1),
    )
    return np.concatenate([ends[0], low + (inner - left) * (high - low), ends[1]], axis=1)


def basis_of(knots: FloatArray, owners: IntArray, at: FloatArray) -> FloatArray:
    """(N, m) B-splines with (S, m + 4) knots at (N,) parameters (de Boor's recursion)."""
    size = knots.shape[1] - DEGREE - 1
    inner = knots[:, DEGREE + 1 : size]
    spans = DEGREE + (at[:, None] >= inner[owners]).sum(axis=1)
    near = knots[owners[:, None], spans[:, None] + np.arange(1 - DEGREE, DEGREE + 1)]
    values = np.ones((len(at), 1))
    for degree in range(1, DEGREE + 1):
        low = near[:, DEGREE - degree : DEGREE]
        high = near[:, DEGREE : DEGREE + degree]
        shares = values / np.maximum(high - low, 1e-300)
        values = np.zeros((len(at), degree + 1))
        values[:, :-1] += shares * (high - at[:, None])
        values[:, 1:] += shares * (at[:, None] - low)
    rows = np.zeros((len(at), size))
    np.put_along_axis(rows, spans[:, None] + np.arange(-DEGREE, 1), values, axis=1)
    return rows


def distances_of(found: FloatArray, points: PointSequences) -> tuple[FloatArray, FloatArray]:
    """(N,) squared distances of points across curves, from (N, 3) points on these curves.

    Also (N,) their signed distances along the curves.
    """
    each = np.arange(len(found))
    first, last = points.offsets[:-1][points.owners], points.offsets[1:][points.owners] - 1
    tangents = unit(found[np.minimum(each + 1, last)] - found[np.maximum(each - 1, first)])
    off = points.points - found
    along: FloatArray = np.einsum("ij,ij->i", off, tangents)
    return np.maximum(np.einsum("ij,ij->i", off, off) - along**2, 0), along
