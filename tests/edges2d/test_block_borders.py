"""Steps at borders of JPEG's blocks in simulated compression, and tables against Pillow's."""

from io import BytesIO

import cv2
import numpy as np
import pytest

from colmap_edges.edges2d.block_borders import (
    ALONG,
    off_block_borders,
    quantisation_of,
    step_sigma,
)
from colmap_edges.edges2d.detection import detect_chains
from colmap_edges.options import DetectionOptions


def wall(shape=(480, 640), noise=1.0, seed=0):
    """A wall with soft shadows, (H, W)."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    light = 120 + 40 * np.sin(rows / 90) * np.cos(columns / 110) + 0.05 * columns
    return light + np.random.default_rng(seed).normal(0, noise, shape)


def compressed(gray, quality):
    """The image (H, W) as a JPEG file decodes it, and the file's bytes (B,)."""
    picture = np.clip(gray.round(), 0, 255).astype(np.uint8)
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].ravel()
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), data


def seen(gray, quality):
    """Chains of the compressed image, and which of their points are no steps of quantisation."""
    image, data = compressed(gray, quality)
    chains = detect_chains(image, DetectionOptions())
    return chains, off_block_borders(chains, data, 1.0)


@pytest.mark.parametrize("quality", [30, 50, 75, 95])
def test_tables_are_those_of_the_file(quality):
    _, data = compressed(wall(), quality)
    table = quantisation_of(data)
    images = pytest.importorskip("PIL.Image", reason="the tables are read with Pillow, too")
    expected = np.array(images.open(BytesIO(data.tobytes())).quantization[0]).reshape(8, 8)
    np.testing.assert_array_equal(table[list(ALONG[0])], expected[0])
    np.testing.assert_array_equal(table[list(ALONG[1])], expected[:, 0])


def test_files_without_tables_have_none():
    _, data = compressed(wall(), 50)
    assert quantisation_of(np.frombuffer(b"\x89PNG\r\n\x1a\n", np.uint8)) is None
    for end in (2, 20, 40):  # cut before the table ends
        assert quantisation_of(data[:end]) is None


def test_steps_at_borders_are_as_large_as_rounding_makes_them():
    table = np.array([16.0, 11, 10, 16, 24, 40, 51, 61])
    random = np.random.default_rng(0)
    errors = random.uniform(-0.5, 0.5, (20000, 2, 8)) * table
    waves = np.cos((2 * np.arange(8)[:, None] + 1) * np.arange(8) * np.pi / 16) / 2
    waves[:, 0] = np.sqrt(1 / 8)
    rows = errors @ waves.T / np.sqrt(8)  # the mean over a block's 8 rows
    assert step_sigma(table) == pytest.approx((rows[:, 1, 0] - rows[:, 0, 7]).std(), rel=0.03)


def test_walls_keep_hardly_any_chain_of_strong_compression():
    chains, kept = seen(wall(), 30)
    assert len(chains.points) > 1000
    assert kept.mean() < 0.35


@pytest.mark.parametrize("quality", [30, 75, 95])
def test_lines_stay_wherever_they_lie(quality):
    gray = wall()
    for column in range(40, 600, 27):  # 27 has no common factor with 8
        gray[100:400, column : column + 13] += 30
    chains, kept = seen(gray, quality)
    upright = np.abs(chains.normals[:, 0]) > 0.99
    contrast = np.diff(chains.sides.astype(int), axis=1)[:, 0]
    assert kept[upright & (contrast > 20)].mean() > 0.99


def test_images_without_excess_keep_all():
    gray = wall()
    for column in range(40, 600, 27):
        gray[100:400, column : column + 13] += 3
    _, kept = seen(gray, 98)
    assert kept.all()
