"""Colours between pixels by hand."""

import numpy as np
import pytest

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


def test_bilinear_by_hand():
    gray = np.array([[0, 100], [50, 250]], np.uint8)
    image = np.ascontiguousarray(np.stack([gray, gray // 2, 0 * gray], axis=2))
    points = np.array([[0, 0], [1, 1], [0.5, 0], [0.5, 0.5], [-3, 9]])
    expected = np.array([0, 250, 50, 100, 50])
    found = _kernels.bilinear(image, points)
    assert found.tolist() == np.column_stack([expected, expected / 2, 0 * expected]).tolist()
    single_pixel = np.ascontiguousarray(image[:1, 1:])
    assert _kernels.bilinear(single_pixel, np.array([[0.4, 0.7]])).tolist() == [[100, 50, 0]]
    with pytest.raises(ValueError, match="empty"):
        _kernels.bilinear(image[:0], points)
