"""Faint chains: straight edges of a few intensity levels, and none in noise."""

import cv2
import numpy as np
import pytest

from colmap_edges.core.arrays import owners_of
from colmap_edges.edges2d.detection import detect_chains, detect_pixel_chains, resized
from colmap_edges.edges2d.faint_chains import faint_pixel_chains, without_stairs
from colmap_edges.options import DetectionOptions

HEIGHT, WIDTH = 240, 320
NOISES = 4.0
NONE = np.zeros((0, 2))


def picture(gray, noise=1.0, seed=0):
    """Gray of an image with the noise of a sensor, as whole levels."""
    random = np.random.default_rng(seed)
    gray = cv2.GaussianBlur(gray, (0, 0), 0.8) + random.normal(0, noise, gray.shape)
    return np.clip(np.rint(gray), 0, 255).astype(np.uint8)


def half_plane(contrast, slope=0.2, middle=160.0):
    """An edge of some gray levels at x = middle + slope (y - 120), in OpenCV's pixels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    far = (x - middle - slope * (y - 120)) / np.hypot(1, slope)
    return 120 + contrast * np.clip(far + 0.5, 0, 1)


@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_finds_an_edge_that_the_detector_does_not(scale):
    image = picture(half_plane(5.0))
    strong, _ = detect_pixel_chains(resized(image, scale), 12)
    assert len(strong) < 30
    points, offsets = faint_pixel_chains(image, scale, NONE, NOISES)
    off = (points[:, 0] / scale - 160 - 0.2 * (points[:, 1] / scale - 120)) / np.hypot(1, 0.2)
    assert np.mean(np.abs(off) < 1) > 0.9
    assert len(np.unique(np.rint(points[np.abs(off) < 1, 1] / scale))) > 0.7 * HEIGHT
    assert np.diff(offsets).min() >= 24 * scale / np.sqrt(2)


def test_its_places_are_sub_pixel():
    chains = detect_chains(picture(half_plane(5.0)), DetectionOptions())
    x, y = chains.points.T - 0.5
    off = (x - 160 - 0.2 * (y - 120)) / np.hypot(1, 0.2)
    near = np.abs(off) < 2
    assert near.sum() > 0.7 * HEIGHT
    assert np.median(np.abs(off[near])) < 0.3


def test_noise_and_rounding_give_no_faint_edges():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for image in (
        picture(np.full((HEIGHT, WIDTH), 120.0), noise=1.0),
        picture(np.full((HEIGHT, WIDTH), 120.0), noise=6.0),
        np.rint(100 + 0.05 * x + 0.02 * y).astype(np.uint8),
    ):
        assert len(faint_pixel_chains(image, 1.0, NONE, NOISES)[0]) < 60


def test_edges_found_before_are_not_found_again():
    image = picture(half_plane(60.0))
    strong, _ = detect_pixel_chains(image, 12)
    assert len(strong) > 0.8 * HEIGHT
    assert len(faint_pixel_chains(image, 1.0, strong, NOISES)[0]) < 30


def test_leaves_faint_curves_and_texture():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    blobs = 120 + 5.0 * ((np.hypot(x % 40 - 20, y % 40 - 20) < 9).astype(float))
    assert len(faint_pixel_chains(picture(blobs), 1.0, NONE, NOISES)[0]) == 0


def test_offsets_of_chains_that_follow_each_other():
    image = picture(half_plane(5.0, middle=80.0) + half_plane(5.0, middle=240.0) - 120)
    points, offsets = faint_pixel_chains(image, 1.0, NONE, NOISES)
    assert offsets[0] == 0 and offsets[-1] == len(points)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    within = np.diff(owners_of(offsets)) == 0
    assert steps[within].max() < 2 and len(offsets) > 2


def test_steps_of_a_staircase_lose_their_corners():
    stairs = np.zeros((6, 6), bool)
    for i in range(5):
        stairs[i, i] = stairs[i, i + 1] = True
    thin = without_stairs(stairs)
    assert thin.sum() < stairs.sum()
    assert cv2.connectedComponents(thin, connectivity=8)[0] == 2


def test_none_are_looked_for():
    image, options = picture(half_plane(5.0)), DetectionOptions(faint_noises=0.0)
    assert len(detect_chains(image, options).points) < 30


def test_leaves_images_whose_texture_is_as_strong_as_the_detectors_edges():
    image = picture(half_plane(25.0), noise=12.0)
    assert len(faint_pixel_chains(image, 1.0, NONE, NOISES)[0]) == 0
