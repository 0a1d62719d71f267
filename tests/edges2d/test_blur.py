"""Estimation of edge blur, on steps blurred by a Gaussian of known width."""

import numpy as np
import pytest
from scipy.special import ndtr

from colmap_edges.edges2d.blur import REACH_PX, STEP_PX, blur_of_edges, profiles_across

SIZE = 64
DARK, BRIGHT = 40.0, 200.0


def step_image(sigma, angle=0.3, dark=DARK, bright=BRIGHT):
    """A straight step through the middle, and (N, 2) points on it with their (N, 2) normals."""
    normal = np.array([np.cos(angle), np.sin(angle)])
    rows, columns = np.indices((SIZE, SIZE)) + 0.5
    distance = (columns - SIZE / 2) * normal[0] + (rows - SIZE / 2) * normal[1]
    gray = np.rint(dark + (bright - dark) * ndtr(distance / sigma)).astype(np.uint8)
    along = np.arange(-20, 21)[:, None] * np.array([-normal[1], normal[0]])
    return gray, SIZE / 2 + along, np.tile(normal, (41, 1))


@pytest.mark.parametrize("sigma", [0.5, 0.7, 0.8, 1.0])
@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 2.0, -2.5])
def test_blur_of_a_step_is_that_of_its_gaussian(sigma, angle):
    assert blur_of_edges(*step_image(sigma, angle)) == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4])
def test_more_blur_is_found_as_more_though_profiles_end(angle):
    """Where a profile ends within a wide step, its blur is taken for less than it is."""
    sigmas = np.array([0.5, 1.0, 1.5, 2.0, 2.5])
    found = [blur_of_edges(*step_image(sigma, angle)) for sigma in sigmas]
    assert (np.diff(found) > 0.1).all()
    assert (found[1:] <= sigmas[1:]).all()


def test_blur_hardly_depends_on_contrast():
    found = [blur_of_edges(*step_image(0.8, dark=60, bright=b)) for b in (220, 140, 100)]
    assert max(found) < 1.05 * min(found)


def test_the_strongest_edges_count():
    sharp, points, normals = step_image(0.8)
    soft, *_ = step_image(2.0, dark=100, bright=130)
    both = np.hstack([sharp, soft])
    # Two weak profiles for each strong one. Those are chosen anew among all of them, so that the
    # median moves a little, and with OpenCV's interpolation; the soft edges' 2 px are far away.
    weak_points = np.tile(points + np.array([SIZE, 0]), (2, 1))
    found = blur_of_edges(both, np.vstack([points, weak_points]), np.tile(normals, (3, 1)))
    assert found == pytest.approx(blur_of_edges(sharp, points, normals), rel=0.05)


def test_where_there_are_no_edges_there_is_no_blur():
    none = np.zeros((0, 2))
    flat, points, normals = np.full((SIZE, SIZE), 90, np.uint8), *step_image(1.0)[1:]
    assert blur_of_edges(flat, none, none) == 0
    assert blur_of_edges(flat, points, normals) < 0.05  # rounding of the interpolation
    gray = step_image(1.0)[0]
    assert blur_of_edges(gray, points, -normals) == 0  # dark and bright exchanged: no edge at all


def test_profiles_read_grays_at_pixel_centres():
    rows, columns = np.indices((40, 60))
    gray = (2 * columns + 3 * rows).astype(np.uint8)
    points = np.array([(20.5, 15.5), (30.0, 12.25)])
    normals = np.array([(1.0, 0.0), (0.0, -1.0)])
    profiles = profiles_across(gray, points, normals)
    offsets = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    assert profiles.shape == (2, 33)
    np.testing.assert_allclose(profiles[0], 2 * (20 + offsets) + 3 * 15, atol=0.1)
    np.testing.assert_allclose(profiles[1], 2 * 29.5 + 3 * (11.75 - offsets), atol=0.2)
    whole = np.flatnonzero(offsets % 1 == 0)  # no interpolation there
    np.testing.assert_allclose(profiles[0, whole], 2 * (20 + offsets[whole]) + 45)


def test_beyond_the_border_the_last_pixel_goes_on():
    gray = np.full((20, 20), 50, np.uint8)
    gray[:, 0] = 90
    (profile,) = profiles_across(gray, np.array([(0.5, 10.5)]), np.array([(-1.0, 0.0)]))
    assert profile[-10:] == pytest.approx(90)
    assert profile[0] == pytest.approx(50)
