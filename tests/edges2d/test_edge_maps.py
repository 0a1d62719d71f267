"""Conversion of edge images of other detectors to chains."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from colmap_edges.edges2d.detection import detect_chains, detect_pixel_chains, resized
from colmap_edges.edges2d.edge_maps import crests_of, pixel_chains_of, thinned
from colmap_edges.images.edge_maps import EdgeMap, decode_edge_map
from colmap_edges.images.files import CompanionFile
from colmap_edges.options import DetectionOptions

WIDTH, HEIGHT = 120, 90
DISC = (55.3, 44.6), 30.0  # centre in COLMAP's pixels, radius


def disc_image():
    """(H, W) uint8 photograph of a dark disc, each pixel a mean over its area."""
    fine_x, fine_y = ((np.arange(8 * size) + 0.5) / 8 for size in (WIDTH, HEIGHT))
    (x, y), radius = DISC
    dark = np.hypot(fine_x[None] - x, fine_y[:, None] - y) < radius
    share = dark.reshape(HEIGHT, 8, WIDTH, 8).mean(axis=(1, 3))
    light = share * (60 / 255) ** 2.2 + (1 - share) * (200 / 255) ** 2.2
    return np.rint(255 * light ** (1 / 2.2)).astype(np.uint8)


def distances():
    """(H, W) of the centre of each pixel from the disc's border."""
    y, x = np.indices((HEIGHT, WIDTH)) + 0.5
    (center_x, center_y), radius = DISC
    return np.abs(np.hypot(x - center_x, y - center_y) - radius)


def decoded(picture):
    data = cv2.imencode(".png", picture)[1].ravel()
    view = SimpleNamespace(name="a.jpg", width=WIDTH, height=HEIGHT, scale=1.0)
    return decode_edge_map(CompanionFile("edge image", Path("a.jpg.png"), "a.jpg", data), view)


def chains_from(edge_map, scale=1.0, min_points=12):
    linked = pixel_chains_of(edge_map, (WIDTH, HEIGHT), scale, min_points)
    return detect_chains(disc_image(), DetectionOptions(), scale, linked)


def radii(chains, scale=1.0):
    center, radius = DISC
    return np.linalg.norm(chains.points / scale - center, axis=1) - radius


BINARY = (255 * (distances() < 0.6)).astype(np.uint8)
THICK = (255 * (distances() < 1.6)).astype(np.uint8)
SOFT = np.rint(230 * np.exp(-0.5 * (distances() / 1.8) ** 2)).astype(np.uint8)
NOISE = np.random.default_rng(0).integers(0, 25, SOFT.shape)
KINDS = {
    "a pixel wide": BINARY,
    "three pixels wide": THICK,
    "0 and 1": BINARY // 255,
    "16 bit": SOFT.astype(np.uint16) * 257,
    "color": np.dstack([BINARY] * 3),
    "black on white": 255 - BINARY,
    "soft": SOFT,
    "soft, black on white": 255 - SOFT,
    "soft and noisy": np.maximum(SOFT, NOISE).astype(np.uint8),
    "two strengths": np.where(np.arange(WIDTH) < 50, BINARY, BINARY // 2),
}


@pytest.mark.parametrize("scale", [1.0, 1.5])
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_edges_are_moved_to_where_the_photograph_has_them(kind, scale):
    """All round the disc, to a few hundredths of a pixel, whatever the edge image is like."""
    chains = chains_from(decoded(KINDS[kind]), scale)
    assert np.sqrt(np.mean(radii(chains, scale) ** 2)) < 0.07
    assert np.abs(radii(chains, scale)).max() < 0.3
    angles = np.sort(np.arctan2(*(chains.points / scale - DISC[0]).T))
    assert np.diff(angles).max() < np.radians(12)
    steps = np.linalg.norm(np.diff(chains.points, axis=0), axis=1)
    inside = np.setdiff1d(np.arange(len(steps)), chains.offsets[1:-1] - 1)
    assert 0.6 < np.median(steps[inside]) < 1.5
    outward = (chains.points / scale - DISC[0]) / DISC[1]
    assert np.einsum("ij,ij->i", chains.normals, outward).min() > 0.9


def test_intensities_decide_whether_an_edge_map_is_binary():
    told = {kind: decoded(picture).is_binary for kind, picture in KINDS.items()}
    soft = {"16 bit", "soft", "soft, black on white", "soft and noisy", "two strengths"}
    assert {kind for kind, is_binary in told.items() if not is_binary} == soft
    np.testing.assert_array_equal(decoded(255 - SOFT).strengths, decoded(SOFT).strengths)


@pytest.mark.parametrize("gray", [0, 255, 7])
def test_edge_images_of_one_gray_hold_no_edges(gray):
    edge_map = decoded(np.full((HEIGHT, WIDTH), gray, np.uint8))
    assert len(chains_from(edge_map).points) == 0
    empty = EdgeMap(np.zeros((HEIGHT, WIDTH), np.float32), is_binary=False)
    assert len(chains_from(empty).points) == 0


def test_weak_crests_stay_where_they_lead_to_strong_ones():
    y = np.arange(HEIGHT)[:, None]
    strengths = np.zeros((HEIGHT, WIDTH), np.float32)
    for row, (left, right) in {20: (1.0, 0.6), 45: (1.0, 1.0), 70: (0.1, 0.1)}.items():
        heights = np.where(np.arange(WIDTH) < 60, left, right)
        strengths = np.maximum(strengths, heights * np.exp(-0.5 * ((y - row) / 1.5) ** 2))
    found = crests_of(strengths.astype(np.float32))
    rows = np.flatnonzero(found.any(axis=1))
    assert rows.tolist() == [20, 45]
    assert found[20].sum() > WIDTH - 5


def test_lines_are_thinned_in_their_middle_and_up_to_the_border():
    edges = np.zeros((40, 60), bool)
    edges[18:21] = True
    thin = thinned(edges)
    assert (thin.astype(bool) & ~edges).sum() == 0
    assert set(np.flatnonzero(thin.any(axis=1))) == {19}
    assert thin[19].astype(bool).sum() >= 57


def test_short_chains_are_left_out():
    edges = np.zeros((HEIGHT, WIDTH), np.float32)
    edges[10, 10:30] = edges[30, 10:20] = 1
    pixels, offsets = pixel_chains_of(EdgeMap(edges, True), (WIDTH, HEIGHT), 1.0, 12)
    assert np.diff(offsets).tolist() == [20]
    np.testing.assert_array_equal(pixels[:, 1], 10)
    _, offsets = pixel_chains_of(EdgeMap(edges, True), (WIDTH, HEIGHT), 1.5, 12)
    assert np.diff(offsets).tolist() == [29, 15]  # pixels of the image as it is enlarged


def test_edge_images_of_the_enlarged_size_are_taken_as_they_are():
    """Of an image 1.5 times as large pixels are whole; those of its own size come between."""
    edges = np.zeros((135, 180), np.float32)
    edges[50, 20:90] = 1
    pixels, _ = pixel_chains_of(EdgeMap(edges, True), (WIDTH, HEIGHT), 1.5, 12)
    np.testing.assert_array_equal(pixels, [[x, 50] for x in range(20, 90)])
    half, _ = pixel_chains_of(EdgeMap(edges, True), (WIDTH, HEIGHT), 0.75, 12)
    np.testing.assert_allclose(half[:, 1], 24.75)
    np.testing.assert_allclose(half[[0, -1], 0], [9.75, 44.25])


@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_own_edges_come_back(scale):
    image = cv2.imread(
        str(sorted((Path(__file__).parents[1] / "data/demo/images").iterdir())[0]), 0
    )
    options = DetectionOptions()
    enlarged = resized(image, scale)
    pixels, offsets = detect_pixel_chains(enlarged, options.min_chain_points)
    own = detect_chains(image, options, scale, (pixels, offsets))
    strengths = np.zeros(enlarged.shape, np.float32)
    strengths[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] = 1
    linked = pixel_chains_of(EdgeMap(strengths, True), image.shape[::-1], scale, 12)
    back = detect_chains(image, options, scale, linked)
    precision = (cKDTree(own.points).query(back.points)[0] < 0.05).mean()
    recall = (cKDTree(back.points).query(own.points)[0] < 1).mean()
    assert 2 * precision * recall / (precision + recall) > 0.98
    for first, last in pairwise(linked[1]):
        assert np.abs(np.diff(linked[0][first:last], axis=0)).max() == 1
