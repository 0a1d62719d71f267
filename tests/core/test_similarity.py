"""Similarity transforms of points, edges and curves."""

import numpy as np
import pytest
from curve_edges import one_of_each_kind

from colmap_edges.core.curves3d import KINDS
from colmap_edges.core.similarity import Similarity, to_z_up
from colmap_edges.edges3d.curves.fitting import fit_curves


@pytest.fixture
def moved():
    """Some transform."""
    rotation = to_z_up(np.array([0.3, -0.8, 0.4]))
    return Similarity(scale=2.5, rotation=rotation, translation=np.array([10.0, -3.0, 7.0]))


@pytest.mark.parametrize(
    "up", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -3, 0), (1, 2, 3), (1e-7, 0, -1)]
)
def test_up_becomes_z(up):
    rotation = to_z_up(np.array(up, float))
    np.testing.assert_allclose(rotation @ up, [0, 0, np.linalg.norm(up)], atol=1e-6)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_transforms_chain(moved):
    points = np.random.default_rng(0).normal(0, 3, (20, 3))
    by_hand = [2.5 * moved.rotation @ point + moved.translation for point in points]
    np.testing.assert_allclose(moved.points(points), by_hand, atol=1e-12)
    twice = moved.after(moved).points(points)
    np.testing.assert_allclose(twice, moved.points(moved.points(points)), atol=1e-12)


def test_a_shift_alone_keeps_every_bit():
    points = np.array([[356000.123, 5712000.456, 100.789]])
    np.testing.assert_array_equal(Similarity.identity().points(points), points)
    shift = Similarity(scale=1.0, rotation=np.eye(3), translation=np.array([0, 0, -100.0]))
    np.testing.assert_array_equal(shift.points(points), points - [0, 0, 100])


def test_curves_of_every_kind_move_with_their_edges(moved):
    edges = one_of_each_kind()
    curves = fit_curves(edges)
    assert [KINDS[kind] for kind in curves.kinds] == list(KINDS)
    there = moved.curves(curves)
    there.check("curves", moved.edges(edges))
    points, owners = curves.sampled_evenly(20)
    np.testing.assert_allclose(there.sampled_evenly(20)[0], moved.points(points), atol=1e-9)
    np.testing.assert_allclose(there.lengths(), 2.5 * curves.lengths())
    np.testing.assert_allclose(there.radii, 2.5 * curves.radii)
    np.testing.assert_allclose(there.position_sigmas, 2.5 * curves.position_sigmas)
    assert len(owners) == 6 * 21
