"""Which observations are of points that nearer ones hide."""

import curves as known
import numpy as np
import pytest

from colmap_edges.colmap import model
from colmap_edges.core.arrays import owners_of
from colmap_edges.edges3d.chains.occlusion import find_hidden
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


def brute_force(pixels, depths, margins, curves, radius_px, slope):
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    counted = (apart <= radius_px) & (curves[:, None] != curves[None])
    gap = depths[:, None] - depths[None]
    limit = slope * (apart + 1) * depths[:, None] + margins[:, None] + margins[None]
    return (counted & (gap > limit)).sum(axis=1), (counted & (np.abs(gap) <= limit)).sum(axis=1)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("num_threads", [1, 2])
def test_counts_are_those_of_all_pairs(seed, num_threads):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 400))
    pixels = rng.uniform(-60, 60, (count, 2))
    pixels[rng.random(count) < 0.1] = pixels[0]
    depths = rng.choice([5.0, 5.05, 7.0], count) + rng.normal(0, 0.02, count)
    margins = rng.uniform(0, 0.03, count)
    curves = rng.integers(0, 20, count)
    arguments = (pixels, depths, margins, curves, float(rng.uniform(1, 20)), 1e-3)
    nearer, agreeing = _kernels.count_around(*arguments, num_threads)
    expected = brute_force(*arguments)
    assert np.array_equal(nearer, expected[0])
    assert np.array_equal(agreeing, expected[1])


def test_points_far_from_the_image_are_counted_alike():
    rng = np.random.default_rng(9)
    pixels = rng.choice([-1e6, 0.0, 1e6], (60, 2)) + rng.uniform(-2, 2, (60, 2))
    depths, margins = rng.uniform(5, 6, 60), np.full(60, 0.1)
    arguments = (pixels, depths, margins, np.arange(60), 2.0, 1e-3)
    counts, expected = _kernels.count_around(*arguments, 2), brute_force(*arguments)
    assert np.array_equal(counts[0], expected[0]) and np.array_equal(counts[1], expected[1])
    assert expected[0].any() and expected[1].any()


def test_points_of_no_curve_hide_others_and_are_not_asked_about():
    rng = np.random.default_rng(3)
    pixels, depths = rng.uniform(-20, 20, (300, 2)), rng.uniform(5, 6, 300)
    curves = np.where(rng.random(300) < 0.5, -1, np.arange(300))
    arguments = (pixels, depths, np.full(300, 0.01), curves, 8.0, 1e-3)
    alone = (*arguments[:3], np.arange(300), *arguments[4:])
    for found, expected in zip(
        _kernels.count_around(*arguments, 2), brute_force(*alone), strict=True
    ):
        np.testing.assert_array_equal(found, np.where(curves < 0, 0, expected))
        assert found.any()


def test_no_points_have_no_neighbors():
    none = np.zeros(0)
    counts = _kernels.count_around(none.reshape(0, 2), none, none, none.astype(np.int64), 5, 0.1, 1)
    assert [len(count) for count in counts] == [0, 0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pixels": np.full((2, 2), np.nan)}, "not finite"),
        ({"radius_px": 0.0}, "radius"),
        ({"depths": np.ones(3)}, "length"),
    ],
)
def test_bad_arrays_are_refused(change, message):
    arguments = {
        "pixels": np.zeros((2, 2)),
        "depths": np.ones(2),
        "margins": np.zeros(2),
        "curves": np.arange(2),
        "radius_px": 5.0,
        "slope": 0.1,
        "num_threads": 1,
    }
    with pytest.raises(ValueError, match=message):
        _kernels.count_around(**(arguments | change))


def lattice(height, step=0.02, half=0.3):
    """Points 2 to 3 px apart in the views of `known.row`, on a plane across its axes."""
    x, y = np.meshgrid(np.arange(-half, half, step), np.arange(-half, half, step))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, float(height))])


def seen_everywhere(points, views):
    """Observations of all points in all views."""
    count = len(points)
    return np.tile(np.arange(count), len(views)), np.repeat(np.arange(len(views)), count)


def hidden_points(model, points, sigmas=None, curves=None, radius_px=10.0):
    """(V, N) which points are hidden in which view."""
    sigmas = np.zeros(len(points)) if sigmas is None else sigmas
    curves = np.arange(len(points)) if curves is None else curves
    tracks = seen_everywhere(points, model.views)
    hidden = find_hidden(model, points, sigmas, curves, *tracks, radius_px, 1)
    return hidden.reshape(len(model.views), len(points))


def test_what_lies_behind_a_surface_is_hidden():
    front, behind = lattice(0.0), lattice(1.0, step=0.1, half=0.2)
    hidden = hidden_points(known.model_of(known.row(3, step=0.1)), np.concatenate([front, behind]))
    assert not hidden[:, : len(front)].any()
    assert hidden[:, len(front) :].all()


def test_sfm_points_hide_edge_points():
    front, behind = lattice(0.0), lattice(1.0, step=0.1, half=0.2)
    views = known.row(3, step=0.1)
    assert hidden_points(known.model_of(views, front), behind).all()
    assert not hidden_points(known.model_of(views), behind).any()


def test_the_list_of_sfm_observations_is_made_once_not_for_every_view(monkeypatch):
    asked = []
    listed = owners_of
    monkeypatch.setattr(model, "owners_of", lambda offsets: asked.append(1) or listed(offsets))
    seen = known.model_of(known.row(5, step=0.1), lattice(0.0))
    hidden_points(seen, lattice(1.0, step=0.1, half=0.2))
    assert len(asked) == 1


def test_a_slanted_surface_hides_nothing_of_itself():
    points = lattice(0.0)
    points[:, 2] = 2.5 * points[:, 0]  # 68 degrees off the image plane
    assert not hidden_points(known.model_of(known.row(3, step=0.1)), points).any()


def test_a_curve_does_not_hide_itself():
    points = np.concatenate([lattice(0.0), lattice(1.0, step=0.1, half=0.2)])
    curves = np.zeros(len(points), np.int64)
    assert not hidden_points(known.model_of(known.row(3, step=0.1)), points, curves=curves).any()


def test_uncertain_points_are_not_hidden():
    front, behind = lattice(0.0), lattice(1.0, step=0.1, half=0.2)
    sigmas = np.concatenate([np.zeros(len(front)), np.full(len(behind), 0.5)])
    points = np.concatenate([front, behind])
    assert not hidden_points(known.model_of(known.row(3, step=0.1)), points, sigmas).any()


def test_points_behind_the_camera_neither_hide_nor_are_hidden():
    points = np.concatenate([lattice(0.0), lattice(-20.0)])
    hidden = hidden_points(known.model_of(known.row(3, step=0.1)), points)
    assert not hidden.any()


@pytest.mark.parametrize("depth", [1e-300, 1e-14, 1e-7])
def test_points_beside_the_camera_neither_hide_nor_are_hidden(depth):
    views = known.row(2, step=0.1)
    beside = np.array([[1.0, 0.5, depth - 5.0], [1.0, 0.5, np.nextafter(-5.0, 0.0)]])
    points = np.concatenate([lattice(0.0), beside])
    assert not hidden_points(known.model_of(views, beside), points).any()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scale_does_not_matter(scale):
    points = np.concatenate([lattice(0.0), lattice(1.0, step=0.1, half=0.2)])
    views = known.row(2, step=0.1)
    expected = hidden_points(known.model_of(views), points)
    scaled = [
        known.make_view(view.rotation, scale * view.translation, i) for i, view in enumerate(views)
    ]
    assert np.array_equal(hidden_points(known.model_of(scaled), scale * points), expected)
