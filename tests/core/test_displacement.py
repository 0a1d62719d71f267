"""Edges of thin bars are at their true positions, although blur moves them apart."""

import numpy as np
import pytest
from scipy.special import ndtr

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

SIZE = 48
MIDDLE = 24.0


def profile(edges, blur):
    """(SIZE,) light of edges (place, change of light), blurred by a Gaussian."""
    x = np.arange(SIZE)
    return sum(change * ndtr((x - place) / blur) for place, change in edges)


def bar(place, width, fall, turned):
    """The edges of a bar: one that rises (falls, turned by -1), one `fall` times as high."""
    return [(place, turned), (place + width, -turned * fall)]


def seen_and_moved(edges, blur):
    """Where the first edge is seen, and where it is said to be, in rows of an image."""
    light = profile(edges, blur)
    image = np.tile(light, (5, 1)).astype(np.float32)
    place, change = edges[0]
    sign = np.sign(change)
    steepest = int(place) - 2 + np.argmax(sign * np.diff(light)[int(place) - 2 : int(place) + 3])
    points, normals = _kernels.refine_subpixel(image, np.array([[steepest, 2.0]]))
    np.testing.assert_allclose(normals, [[sign, 0]], atol=1e-6)
    moved = _kernels.undo_displacement(image, points, normals, blur)
    assert moved[0, 1] == points[0, 1] == 2
    return points[0, 0], moved[0, 0]


@pytest.mark.parametrize(
    ("blur", "width_in_blurs"),
    [
        (1.2, 1.5),
        (1.2, 2.0),
        (1.2, 2.5),
        (1.5, 1.5),
        (1.5, 2.0),
        (1.5, 2.5),
        (2.0, 1.5),
        (2.0, 2.0),
    ],
)
@pytest.mark.parametrize("fall", [0.4, 1.0, 1.8])
@pytest.mark.parametrize("turned", [1, -1])
def test_an_edge_of_a_bar_is_put_where_it_is(blur, width_in_blurs, fall, turned):
    """Wherever it lies between pixels, which alone leaves up to a quarter of a pixel."""
    seen_too_far, too_far = np.array(
        [
            [
                place - x
                for x in seen_and_moved(bar(place, blur * width_in_blurs, fall, turned), blur)
            ]
            for place in MIDDLE + np.arange(0, 1, 0.125)
        ]
    ).T
    assert seen_too_far.mean() > 0.06  # from the other edge
    assert abs(too_far.mean()) < max(0.5 * seen_too_far.mean(), 0.06)
    if width_in_blurs <= 2:
        assert np.abs(too_far).mean() < 0.8 * np.abs(seen_too_far).mean()


@pytest.mark.parametrize("blur", [1.2, 1.8])
def test_bars_thinner_than_the_blur_get_no_wider_and_do_not_turn_over(blur):
    for width in (0.3, 0.6, 1.0):
        left = [(MIDDLE, 1.0), (MIDDLE + width, -1.0)]
        right = [(MIDDLE + width, -1.0), (MIDDLE, 1.0)]
        (seen_left, is_left), (seen_right, is_right) = (
            seen_and_moved(edges, blur) for edges in (left, right)
        )
        assert seen_left < is_left < is_right < seen_right


@pytest.mark.parametrize(
    "others",
    [[], [(MIDDLE + 3, 0.7)], [(MIDDLE - 3, 0.7)], [(MIDDLE + 3, -0.1)], [(MIDDLE + 14, -1.0)]],
    ids=["alone", "rises before", "rises behind", "too faint", "too far"],
)
def test_other_edges_are_left_where_they_are_seen(others):
    seen, moved = seen_and_moved([(MIDDLE, 1.0), *others], 1.3)
    assert moved == seen


def test_between_two_falling_edges_both_count():
    edges = [(MIDDLE, 1.0), (MIDDLE + 3, -1.0), (MIDDLE - 3, -1.0)]
    seen, moved = seen_and_moved(edges, 1.3)
    assert moved == pytest.approx(seen, abs=1e-6) == MIDDLE


def test_flat_areas_borders_and_empty_input():
    flat = np.full((4, 4), 0.5, np.float32)
    points, normals = np.array([[0.0, 0], [3, 3], [1.5, 2]]), np.array([[1.0, 0], [0, 1], [0, 0]])
    np.testing.assert_array_equal(_kernels.undo_displacement(flat, points, normals, 1.0), points)
    none = np.zeros((0, 2))
    assert _kernels.undo_displacement(flat, none, none, 1.0).shape == (0, 2)


def test_bad_arguments_are_refused():
    image, points = np.zeros((4, 4), np.float32), np.zeros((2, 2))
    with pytest.raises(ValueError, match="blur must be greater"):
        _kernels.undo_displacement(image, points, points, 0.0)
    with pytest.raises(ValueError, match="differ in number"):
        _kernels.undo_displacement(image, points, points[:1], 1.0)
    with pytest.raises(ValueError, match="empty"):
        _kernels.undo_displacement(image[:0], points, points, 1.0)
