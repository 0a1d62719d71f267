"""The layers of the report's pictures."""

import cv2
import numpy as np
import pytest

from colmap_edges.report.pictures import layer, one_colored_png

COLOR = (10, 160, 255)


@pytest.mark.parametrize("bits", [1, 2, 4])
@pytest.mark.parametrize("width", [1, 7, 16])
def test_png_of_one_colour_is_read_back(bits, width):
    opacity = np.random.default_rng(0).integers(0, 1 << bits, (5, width)).astype(np.uint8)
    read = cv2.imdecode(
        np.frombuffer(one_colored_png(opacity, bits, COLOR), np.uint8), cv2.IMREAD_UNCHANGED
    )
    assert read.shape == (5, width, 4)
    assert (read[..., :3] == COLOR).all()
    np.testing.assert_array_equal(read[..., 3], 255 * opacity.astype(int) // ((1 << bits) - 1))


def test_layer_draws_lines_on_transparency():
    data = layer([np.array([[2.5, 4.5], [18.5, 4.5]])], 1.0, (10, 20), COLOR)
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert (read[4, 4:17, 3] == 255).all()
    assert read[[0, 1, 8, 9], :, 3].max() == 0


def test_layer_without_lines_is_transparent():
    read = cv2.imdecode(np.frombuffer(layer([], 1.0, (4, 6), COLOR), np.uint8), -1)
    assert read.shape == (4, 6, 4)
    assert read[..., 3].max() == 0
