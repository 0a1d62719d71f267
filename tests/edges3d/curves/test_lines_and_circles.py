"""Lines, circles and tangent arcs are fitted to many sequences of points at once."""

import numpy as np
from curve_edges import arc, frame, segment

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges3d.curves.lines_and_circles import fit_circles, fit_lines, fit_tangent_arcs
from colmap_edges.edges3d.curves.point_sequences import PointSequences

SIGMA = 1e-3


def sequences_of(*curves, noise=0.0):
    points, lengths = np.concatenate(curves), np.array([len(curve) for curve in curves])
    points = points + np.random.default_rng(0).normal(scale=noise, size=points.shape)
    weights = np.full(len(points), SIGMA**-2)
    return PointSequences(points=points, weights=weights, offsets=offsets_of(lengths))


def test_exact_points_give_exact_lines_and_circles():
    lines = fit_lines(
        sequences_of(segment((0, 0, 0), (3, 0, 0), 9), segment((1, 1, 0), (1, 1, 5), 20))
    )
    np.testing.assert_allclose(np.abs(lines.frames[:, 1]), [[1, 0, 0], [0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(lines.frames[:, 0], [[1.5, 0, 0], [1, 1, 2.5]], atol=1e-9)
    axes = frame(3)
    short = arc(np.ones(3), axes, (2, 2), 0, 60, 12)
    long = arc(np.zeros(3), axes, (0.5, 0.5), 20, 340, 40)
    circles = fit_circles(sequences_of(short, long))
    np.testing.assert_allclose(circles.frames[:, 0], [[1, 1, 1], [0, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(circles.frames[:, 1:], axis=2), [[2, 2], [0.5, 0.5]])
    np.testing.assert_allclose(np.abs(np.cross(*circles.frames[1, 1:]) @ axes[2]), 0.25)
    assert max(lines.squares.max(), circles.squares.max()) < 1e-12


def test_deviations_are_those_of_the_errors():
    turns = [arc(np.zeros(3), np.eye(3), (1, 1), 0, 120, 30)] * 400
    circles = fit_circles(sequences_of(*turns, noise=SIGMA))
    errors = np.linalg.norm(circles.frames[:, 1], axis=1) - 1
    np.testing.assert_allclose(np.median(circles.sigmas[:, 3]), errors.std(), rtol=0.15)


def test_arcs_tangent_to_two_lines_have_a_radius_only():
    # In the corner of the x and y axes, with the centre on the diagonal.
    points = sequences_of(arc(np.array([0.3, 0.3, 0]), np.eye(3), (0.3, 0.3), 190, 260, 5))
    inward, along = np.array([1, 1, 0]) / np.sqrt(2), np.array([-1, 1, 0]) / np.sqrt(2)
    axes = np.array([[inward, along]])
    arcs = fit_tangent_arcs(points, np.zeros((1, 3)), axes, np.array([np.sqrt(2)]))
    np.testing.assert_allclose(arcs.frames[0, 0], [0.3, 0.3, 0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(arcs.frames[0, 1:], axis=1), [0.3, 0.3])
    assert arcs.sigmas[0, 3] < 10 * SIGMA
