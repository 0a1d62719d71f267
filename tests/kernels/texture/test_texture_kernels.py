"""Kernels of textures against plain numpy."""

from itertools import product

import numpy as np
import pytest

from colmap_edges.kernels import _kernels


def weights_at(corners, at):
    """Barycentric coordinates of points (N, 2) in a triangle (3, 2)."""
    system = np.vstack([corners.T, np.ones(3)])
    return np.linalg.solve(system, np.vstack([at.T, np.ones(len(at))])).T


def pixel_centers(rows, columns):
    grid = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    return np.column_stack([axis.ravel() for axis in grid])


@pytest.fixture
def triangles():
    rng = np.random.default_rng(5)
    pixels = rng.uniform(-5, 35, (60, 2))
    faces = rng.permutation(60).reshape(-1, 3).astype(np.int32)
    return pixels, rng.uniform(0.1, 1, 60), faces


def test_depths_are_those_of_the_nearest_triangle(triangles):
    pixels, inverses, faces = triangles
    inverses[faces[0, 0]] = np.nan  # not drawn
    found = _kernels.draw_depths(pixels, inverses, faces, 24, 30)
    at, expected = pixel_centers(24, 30), np.zeros(24 * 30)
    for face in faces[1:]:
        weights = weights_at(pixels[face], at)
        inside = (weights >= 0).all(axis=1)
        expected[inside] = np.maximum(expected, weights @ inverses[face])[inside]
    np.testing.assert_allclose(found.ravel(), expected, rtol=1e-5, atol=1e-7)


def test_shares_count_hidden_and_masked_pixels(triangles):
    pixels, inverses, _ = triangles
    face = np.array([[0, 1, 2]], np.int32)
    pixels[:3], inverses[:3] = [(2, 2), (26, 2), (2, 22)], 0.5
    nearest = np.full((24, 30), 0.5, np.float32)
    nearest[:, :8] = 0.9  # a body in front
    usable = np.ones((24, 30), np.uint8)
    usable[:5] = 0
    around, picture = np.full_like(nearest, 0.9), np.ones((24, 30, 4), np.float32)
    picture[:, :, 1] = np.arange(30)
    given = (nearest, around, picture, usable, 0.01, 3.0)
    areas, shares, means = _kernels.tally_faces(pixels, inverses, face, *given)
    at = pixel_centers(24, 30)
    inside = (weights_at(pixels[:3], at) >= 0).all(axis=1)
    seen = inside & (at[:, 0] > 8) & (at[:, 1] > 5)
    assert areas[0] == pytest.approx(240)
    np.testing.assert_allclose(shares[0], [seen.sum() / inside.sum(), 0], atol=1e-6)
    assert means[0, 1] == pytest.approx((at[inside, 0] - 0.5).mean(), rel=1e-5)


def test_colours_are_linear_in_triangles_and_go_on_around_them():
    corners = np.array([[(4, 4), (24, 4), (4, 20)]], float)
    colors = np.array([[(0, 10, 20), (100, 10, 20), (0, 90, 20)]], np.float32)
    picture, covered = np.full((24, 30, 3), 50, np.uint8), np.zeros((24, 30), np.uint8)
    _kernels.add_colors(corners, colors, 2.0, picture, covered)
    at = pixel_centers(24, 30)
    weights = weights_at(corners[0], at)
    inside = (weights >= 0).all(axis=1)
    expected = 50 + weights @ colors[0]
    np.testing.assert_allclose(picture.reshape(-1, 3)[inside], expected[inside], atol=0.51)
    np.testing.assert_array_equal(covered.ravel() == 1, inside)
    assert covered[3, 10] == 2 and picture[3, 10, 2] == 70
    assert covered[1, 10] == 0 and picture[1, 10, 2] == 50
    places, owners, found = _kernels.pixels_of_triangles(corners, 24, 30, 0.0)
    np.testing.assert_array_equal(np.sort(places), np.flatnonzero(inside))
    np.testing.assert_allclose(found, weights[places], atol=1e-9)
    assert not owners.any()


def test_labels_of_a_tree_are_the_best_ones():
    rng = np.random.default_rng(8)
    pairs = np.array([(0, 1), (1, 2), (1, 3), (3, 4), (3, 5)], np.int32)
    for _ in range(20):
        labels = [np.sort(rng.choice(4, rng.integers(1, 4), replace=False)) for _ in range(6)]
        costs = [rng.uniform(0, 3, len(each)) for each in labels]
        offsets = np.concatenate([[0], np.cumsum([len(each) for each in labels])])
        chosen = _kernels.label_views(
            offsets, np.concatenate(labels).astype(np.int32), np.concatenate(costs), pairs, 1.0, 10
        )

        def energy(choice, labels=labels, costs=costs):
            own = [each[k] for each, k in zip(labels, choice, strict=True)]
            data = sum(each[k] for each, k in zip(costs, choice, strict=True))
            return data + sum(own[a] != own[b] for a, b in pairs)

        best = min(map(energy, product(*(range(len(each)) for each in labels))))
        assert energy(chosen) == pytest.approx(best)


def test_nodes_without_candidates_have_no_label():
    offsets = np.array([0, 0, 1], np.int64)
    pairs = np.array([(0, 1)], np.int32)
    found = _kernels.label_views(offsets, np.zeros(1, np.int32), np.zeros(1), pairs, 1.0, 3)
    assert found.tolist() == [-1, 0]
    with pytest.raises(ValueError, match="unknown node"):
        _kernels.label_views(offsets, np.zeros(1, np.int32), np.zeros(1), pairs + 1, 1.0, 3)
