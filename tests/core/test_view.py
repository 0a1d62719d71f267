"""Which points are in the images of many views, against one view after another."""

from dataclasses import replace

import curves as known
import numpy as np
import pycolmap
import pytest

from colmap_edges.core import view as of_views
from colmap_edges.core.view import in_images


def test_points_in_the_images():
    views = known.row(2, step=1.0, depth=5.0)  # 640 x 480 pixels at 600: 5.33 by 4 wide at z = 0
    points = np.array(
        [(0, 0, 0), (2.6, 0, 0), (-2.6, 0, 0), (0, 1.99, 0), (0, 2.01, 0), (0, 0, -6.0)]
    )
    shown = [view.project(points)[0] for view in views]
    assert np.isfinite(shown[0][:5]).all()
    assert in_images(views, points).sum(axis=0).tolist() == [2, 2, 1, 2, 0, 0]
    assert in_images([], points).shape == (0, 6)
    assert in_images(views, np.zeros((0, 3))).shape == (2, 0)


@pytest.mark.parametrize("group_size", [1, 100, 5000])
def test_views_of_several_cameras_together_and_one_by_one(group_size, monkeypatch):
    monkeypatch.setattr(of_views, "GROUP_SIZE", group_size)
    cameras = [
        pycolmap.Camera(camera_id=index, model=model, width=640, height=480, params=params)
        for index, (model, params) in enumerate(
            (("SIMPLE_PINHOLE", [600, 320, 240]), ("SIMPLE_RADIAL", [400, 300, 250, -0.1]))
        )
    ]
    ring = known.ring(9, arc_deg=200)
    views = [replace(view, camera=cameras[index % 2]) for index, view in enumerate(ring)]
    points = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    expected = [view.holds(*view.project(points)) for view in views]
    assert 0.1 < np.mean(expected) < 0.9
    np.testing.assert_array_equal(in_images(views, points), expected)


@pytest.mark.parametrize(
    ("lens", "params", "fold"),
    [
        ("SIMPLE_RADIAL", (-0.116,), (1 / (3 * 0.116)) ** 0.5),
        ("SIMPLE_RADIAL", (0.1,), np.inf),
        ("OPENCV", (-0.1, 0.0, 0.0, 0.0), (1 / 0.3) ** 0.5),
        ("OPENCV_FISHEYE", (0.0, 0.0, 0.0, 0.0), np.inf),
    ],
)
def test_rays_beyond_the_fold_of_a_lens_are_not_in_the_image(lens, params, fold):
    camera = pycolmap.Camera.create_from_model_name(1, lens, 500.0, 640, 480)
    plain = len(camera.params) - len(params)
    camera.params = [*camera.params[:plain], *params]
    view = known.make_view(np.eye(3), np.zeros(3), camera=camera)
    assert view.fold == pytest.approx(fold, rel=0.05)
    tangents = np.array([0.1, 0.5, 3.5])
    points = np.column_stack([tangents, np.zeros(3), np.ones(3)])
    pixels, depths = view.project(points)
    assert np.isfinite(pixels[:, 0]).tolist() == (tangents < fold).tolist()
    inside = [True, True, False]
    assert view.holds(pixels, depths).tolist() == in_images([view], points)[0].tolist() == inside
