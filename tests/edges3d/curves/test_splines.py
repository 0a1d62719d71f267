"""Splines of many stretches at once, against scipy's of each alone."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.curves3d import spline_points
from colmap_edges.edges3d.curves.noise import Noise
from colmap_edges.edges3d.curves.point_sequences import PointSequences
from colmap_edges.edges3d.curves.splines import DEGREE, basis_of, fit_splines, knots_of, splines_of

SIGMA = 1e-3


def wave(count, turns, seed):
    """Points of a curve with so many turns, with noise."""
    t = np.linspace(0, 1, count)
    points = np.column_stack([3 * t, np.sin(turns * t), 0.5 * np.cos(turns * t) * t])
    return points + np.random.default_rng(seed).normal(scale=SIGMA, size=points.shape)


def sequences_of(*curves):
    points = np.concatenate(curves)
    weights, lengths = np.full(len(points), SIGMA**-2), np.array([len(of) for of in curves])
    return PointSequences(points=points, weights=weights, offsets=offsets_of(lengths))


def test_basis_is_that_of_scipy():
    random = np.random.default_rng(0)
    each = [np.append(0, np.sort(random.uniform(0, 5, count - 1))) for count in (30, 17)]
    places, offsets = np.concatenate(each), np.array([0, 30, 47])
    for size in (4, 5, 9):
        knots = knots_of(places, offsets, size)
        owners = np.repeat([0, 1], [30, 17])
        found = basis_of(knots, owners, places)
        for row, (first, end) in enumerate(pairwise(offsets)):
            inner = knots[row, DEGREE + 1 : size]
            per_span = np.histogram(places[first:end], np.r_[0, inner, np.inf])[0]
            assert np.ptp(per_span) <= 1
            expected = BSpline(knots[row], np.eye(size), DEGREE)(places[first:end])
            np.testing.assert_allclose(found[first:end], expected, atol=1e-12)
            points = spline_points(knots[row], np.eye(size), places[first:end])
            np.testing.assert_allclose(points, expected, atol=1e-12)


def test_stretches_are_fitted_as_each_alone():
    curves = [wave(60, 5, 0), wave(25, 2, 1), wave(90, 9, 2)]
    together = splines_of(sequences_of(*curves), 7)
    for row, curve in enumerate(curves):
        knots, control, _, sigmas = splines_of(sequences_of(curve), 7)
        np.testing.assert_allclose(together[0][row], knots[0], rtol=1e-12)
        np.testing.assert_allclose(together[1][row], control[0], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(together[3][row], sigmas[0], rtol=1e-6)


def test_splines_cost_less_than_they_may():
    curves = [wave(120, 2, 0), wave(120, 6, 1), wave(6, 3, 2)]
    points = sequences_of(*curves)
    noise = Noise(sigmas=np.zeros(0), correlation=1.0)
    prices, most = np.full(3, 4.0), np.full(3, 2000.0)
    found = fit_splines(points, noise, prices, most)
    assert sorted(found) == [0, 1]  # six points are too few
    assert max(fit.cost for fit in found.values()) < 2000
    at = np.linspace(0, found[0].knots[-1], 2000)
    curve = BSpline(found[0].knots, found[0].control, DEGREE)(at)
    off = np.linalg.norm(curves[0][:, None] - curve, axis=2).min(axis=1)
    assert np.median(off) < 2 * SIGMA
    assert not fit_splines(points, noise, prices, np.full(3, 40.0))
