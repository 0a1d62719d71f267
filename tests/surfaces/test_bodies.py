"""Bodies before a background, by masks that other views may contradict."""

from dataclasses import replace
from functools import cache

import numpy as np
import pycolmap
import pytest
from curves import looking
from solid_points import fibonacci_sphere

from colmap_edges.images.background import NO_BACKGROUND_MASK, masked_background
from colmap_edges.surfaces.bodies import (
    Body,
    contradicted_share,
    find_background,
    spread,
    within,
)

RADIUS = 0.5


def views_around(count=60, distance=4.0):
    """Views from all around, none straight from above or below."""
    centers = distance * fibonacci_sphere(count + 4)[2:-2]
    return [looking(center, index=i) for i, center in enumerate(centers)]


def masked(view, is_hit):
    """The body that a view sees, by what every pixel's line of sight meets."""
    camera = view.camera
    local = lines_of_sight(camera.model.name, camera.width, camera.height, *camera.params)
    return Body(view, is_hit(view.center, local @ view.rotation).reshape(view.height, view.width))


@cache
def lines_of_sight(model, width, height, *params):
    """Directions of all pixels of a camera, row by row."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    camera = pycolmap.Camera(model=model, width=width, height=height, params=params)
    rays = camera.cam_from_img(np.column_stack([x.ravel(), y.ravel()]))
    return np.column_stack([rays, np.ones(width * height)])


def hits_ball(center, radius=RADIUS):
    """Whether lines of sight meet a ball."""

    def is_hit(origin, directions):
        along = directions @ (center - origin) / np.linalg.norm(directions, axis=1)
        return np.sum((center - origin) ** 2) - along**2 < radius**2

    return is_hit


@pytest.fixture(scope="module")
def ball():
    """Views of a ball around the origin and what they see of it."""
    return [masked(view, hits_ball(np.zeros(3))) for view in views_around()]


def test_within_is_what_no_view_sees_before_the_background(ball):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (5000, 3))
    inside = within(ball, points)
    distance = np.linalg.norm(points, axis=1)
    assert inside[distance < RADIUS - 0.01].all()
    assert not inside[distance > 1.1 * RADIUS].any()
    np.testing.assert_array_equal(within(ball[:0], points), True)


def test_a_view_says_nothing_of_what_it_does_not_see(ball):
    view = ball[0].view
    behind = 3 * view.center
    beside = view.center + view.rotation.T @ np.array([50.0, 0, 1])
    assert ball[0].holds(np.array([behind, beside, np.zeros(3)])).all()
    assert not ball[0].holds(np.array([[0.9, 0.9, 0.9], [-0.9, 0.9, -0.9]])).any()


def test_masks_may_be_smaller_than_images(ball):
    small = Body(ball[0].view, ball[0].mask[1::2, 1::2])
    points = np.random.default_rng(0).uniform(-1, 1, (5000, 3))
    differ = small.holds(points) != ball[0].holds(points)
    assert differ.mean() < 0.01


def test_views_are_spread():
    directions = fibonacci_sphere(200)
    chosen = spread(directions * np.linspace(1, 5, 200)[:, None], 20)
    assert len(set(chosen.tolist())) == 20
    cosines = directions[chosen] @ directions[chosen].T - 2 * np.eye(20)
    assert np.degrees(np.arccos(cosines.max())) > 25
    np.testing.assert_array_equal(np.sort(spread(directions[:5], 20)), np.arange(5))


@pytest.fixture(scope="module")
def on_ball(ball, scene_model, scene_edges):
    """A model of the ball's views, with 3D edge points on the ball."""
    points = RADIUS * fibonacci_sphere(scene_edges.num_points)
    model = replace(scene_model, views=tuple(body.view for body in ball))
    return model, replace(scene_edges, points=points)


def test_masks_of_nothing_are_not_believed(ball, on_ball, caplog):
    """Inverted masks of a scene that fills its images hide all of them."""
    model, edges = on_ball
    black = [masked_background(np.zeros((40, 60), bool))] * len(ball)
    assert find_background(model, black, True, edges) is None
    assert "masks hide all of every image" in caplog.text


def test_frames_around_images_are_no_background(ball, on_ball, caplog):
    """What a fisheye lens shows is framed by black; but points project there."""
    x, y = np.meshgrid(np.arange(640) - 320, np.arange(480) - 240)
    frame = masked_background(x**2 + y**2 < 60**2)
    known = [masked_background(body.mask) for body in ball]
    framed = [Body(body.view, frame.body()) for body in ball]
    assert contradicted_share(ball, on_ball[1].points) < 0.001
    assert contradicted_share(framed, on_ball[1].points) > 0.5
    assert find_background(on_ball[0], known, False, on_ball[1])
    assert find_background(on_ball[0], [frame] * len(ball), False, on_ball[1]) is None
    assert not caplog.records
    assert find_background(on_ball[0], [frame] * len(ball), True, on_ball[1])
    assert "it is meant for masks that hide nothing but the background" in caplog.text


def test_a_body_of_the_colour_of_the_backdrop_in_one_view_is_no_background(ball, on_ball):
    """A quarter of the ball is white, before white, in one of its views: 0.3 % of all points."""
    model, edges = on_ball
    masks = [masked_background(body.mask) for body in ball]
    rows, columns = np.nonzero(ball[3].mask)
    white = np.zeros_like(ball[3].mask)
    white[: int(np.median(rows)), : int(np.median(columns))] = True
    masks[3] = masked_background(ball[3].mask & ~white)
    bodies = [Body(body.view, mask.body()) for body, mask in zip(ball, masks, strict=True)]
    assert 0.001 < contradicted_share(bodies, edges.points) < 0.01
    assert find_background(model, masks, False, edges) is None
    assert find_background(model, masks, True, edges)


def test_masks_come_back_as_they_were(ball):
    background_mask = masked_background(ball[0].mask)
    np.testing.assert_array_equal(background_mask.body(), ball[0].mask)
    wide = masked_background(np.arange(4001) < np.full((100, 1), 2000))
    assert wide.body().shape == (50, 2000)
    assert wide.body().mean() == pytest.approx(0.5, abs=1e-3)
    assert not masked_background(np.ones((40, 60), bool)).is_seen
    assert NO_BACKGROUND_MASK.body().size == 0
