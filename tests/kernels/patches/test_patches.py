"""The kernels of patches against plain numpy."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from colmap_edges.kernels import _kernels

SIZE = (60, 80)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def two_views(rng):
    """Rotations, translations, focal lengths, principal points and smooth pictures."""
    rotations = Rotation.from_rotvec(rng.normal(0, 0.03, (2, 3))).as_matrix()
    translations = rng.normal(0, 0.15, (2, 3))
    focals, principals = rng.uniform(70, 90, 2), np.array([40.0, 30]) + rng.normal(0, 2, (2, 2))
    grays = [gaussian_filter(rng.uniform(0, 255, SIZE), 1.5) for _ in range(2)]
    grays = [np.clip(128 + 4 * (gray - 128), 0, 255).astype(np.uint8) for gray in grays]
    return rotations, translations, focals, principals, grays


def scene_of(rotations, translations, focals, principals, grays):
    neighbors = np.array([1, 0], np.int32)
    given = (rotations, translations, focals, principals, grays)
    return _kernels.PatchScene(*given, np.array([0, 1, 2]), neighbors, 6)


def correlation(views, pixel, plane):
    """Correlation of the window of view 0 at a pixel with view 1, by way of world points."""
    rotations, translations, focals, principals, grays = views
    dy, dx = np.mgrid[-3:4, -3:4]
    inverse = plane[0] + plane[1] * dx + plane[2] * dy
    x, y = pixel[0] + dx, pixel[1] + dy
    local = np.stack([x + 0.5, y + 0.5], -1) - principals[0]
    local = np.concatenate([local / focals[0], np.ones((7, 7, 1))], -1) / inverse[..., None]
    world = (local - translations[0]) @ rotations[0]
    other = world @ rotations[1].T + translations[1]
    at = focals[1] * other[..., :2] / other[..., 2:] + principals[1] - 0.5
    if (at < 0).any() or (at >= np.array(SIZE[::-1]) - 1).any() or (other[..., 2] <= 0).any():
        return -1.0
    own = grays[0][y, x].ravel().astype(np.float64)
    theirs = map_coordinates(grays[1].astype(np.float64), [at[..., 1], at[..., 0]], order=1)
    return float(np.corrcoef(own, theirs.ravel())[0, 1])


def test_correlations_are_those_of_numpy(rng):
    views = two_views(rng)
    pixels = rng.integers((3, 3), (77, 57), (200, 2)).astype(np.int32)
    planes = np.column_stack([rng.uniform(0.2, 0.6, 200), rng.normal(0, 0.004, (200, 2))])
    found = scene_of(*views).correlations(0, 1, pixels, planes, 0.0)
    expected = [correlation(views, *pair) for pair in zip(pixels, planes, strict=True)]
    assert np.mean(np.array(expected) > -1) > 0.3
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_windows_of_plain_pictures_do_not_correlate(rng):
    *views, grays = two_views(rng)
    plain = [np.full_like(gray, 100) for gray in grays]
    plane = np.array([[0.3, 0, 0]])
    found = scene_of(*views, plain).correlations(0, 1, np.array([[40, 30]], np.int32), plane, 1.0)
    np.testing.assert_array_equal(found, -1)


def test_wrong_arrays_are_told(rng):
    *views, grays = two_views(rng)
    with pytest.raises(ValueError, match="hold a window"):
        scene_of(*views, [gray[:5] for gray in grays])
    scene = scene_of(*views, grays)
    sites, none = np.ones((2, 2), np.uint8), np.zeros((2, 2, 1, 3), np.float32)
    with pytest.raises(ValueError, match="sites differ"):
        scene.search(0, sites, none, 0.1, 1, 1.0, 0.2, 1, 0.7, 0)
    with pytest.raises(ValueError, match="out of range"):
        scene.search(2, sites, none, 0.1, 1, 1.0, 0.2, 1, 0.7, 0)


def first_hits(triangles, rays):
    """(R,) inverse depths of the nearest triangles along rays of depth 1, by brute force."""
    inverse = np.zeros(len(rays))
    for triangle in triangles:
        shares = rays @ np.linalg.pinv(triangle.T).T  # ray = sum of shares of the corners
        hit = (shares >= 0).all(axis=1)
        inverse[hit] = np.maximum(inverse[hit], shares[hit].sum(axis=1))
    return inverse


def test_depths_of_a_mesh_are_those_of_rays(rng):
    rotation, translation = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix(), [0.1, 0.2, 0.3]
    local = rng.normal(0, 0.7, (40, 3, 3)) + rng.choice([-3, 0, 5, 9], (40, 1, 1)) * [[[0, 0, 1]]]
    vertices = (local.reshape(-1, 3) - translation) @ rotation
    faces = np.arange(120, dtype=np.int32).reshape(-1, 3)
    rays = rng.uniform(-0.7, 0.7, (300, 2))
    found, hit = _kernels.mesh_depths(
        np.array([rotation]), np.array([translation]), vertices, faces, np.array([0, 300]), rays, 2
    )
    expected = first_hits(local, np.column_stack([rays, np.ones(300)]))
    assert 0.3 < np.mean(expected > 0) < 1
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    np.testing.assert_array_equal(hit >= 0, expected > 0)
    for i in np.flatnonzero(hit >= 0):
        alone = first_hits(local[hit[[i]]], np.append(rays[i], 1)[None])
        np.testing.assert_allclose(alone, expected[i], rtol=1e-9)
