"""Ranges of values of the nearest points, against distances to all points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


def ranges_reference(points, values, places, num_nearest):
    distances = np.linalg.norm(points[None] - places[:, None], axis=2)
    near = values[np.argsort(distances, axis=1)[:, :num_nearest]]
    return np.column_stack([near.min(axis=1), near.max(axis=1)])


@given(
    st.integers(0, 2**31),
    st.integers(1, 300),
    st.integers(1, 20),
    st.floats(0.5, 200),
    st.sampled_from(["even", "clusters", "row"]),
)
def test_same_as_all_distances(seed, count, num_nearest, cell, kind):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-50, 50, (count, 2))
    if kind == "clusters":
        points = np.array([[-50.0, 10], [50, 20]])[rng.integers(0, 2, count)] + points / 100
    if kind == "row":
        points[:, 1] = 7
    cell = max(cell, 100 / count)
    values, places = rng.normal(size=count), rng.uniform(-70, 70, (40, 2))
    found = _kernels.nearest_ranges(points, values, places, cell, num_nearest)
    np.testing.assert_array_equal(found, ranges_reference(points, values, places, num_nearest))


def test_unusable_arguments():
    points, values, places = np.zeros((3, 2)), np.zeros(3), np.zeros((1, 2))
    assert _kernels.nearest_ranges(points, values, places[:0], 1.0, 2).shape == (0, 2)
    far = np.array([[0, 0], [0, 0], [np.inf, 0]])
    for arguments in (
        (points[:0], values[:0], places, 1.0, 2),
        (points, values[:2], places, 1.0, 2),
        (points, values, places, 0.0, 2),
        (points, values, places, 1.0, 0),
        (far, values, places, 1.0, 2),
    ):
        with pytest.raises(ValueError):
            _kernels.nearest_ranges(*arguments)
