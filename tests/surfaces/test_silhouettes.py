"""Points on silhouettes lie on smooth bodies, and are seen from where nothing is in between."""

from dataclasses import replace
from functools import cache

import numpy as np
import pycolmap
import pytest
from curves import looking
from solid_points import as_trimesh, fibonacci_sphere

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.images.background import NO_BACKGROUND_MASK, background_rays, masked_background
from colmap_edges.options import MeshingOptions
from colmap_edges.surfaces import mesher as meshing
from colmap_edges.surfaces.silhouettes import (
    Body,
    contour,
    contradicted_share,
    find_background,
    seeing,
    silhouette_points,
    spread,
    within,
)

RADIUS = 0.5
CORNERS = RADIUS * np.array([[-1, -1, -1], [1, 1, 1.0]]) / np.sqrt(3)  # two points known of it


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


@pytest.fixture(scope="module")
def on_silhouettes(ball):
    """Points on the ball's silhouettes; its views are every third of a model's."""
    return silhouette_points({3 * i: body for i, body in enumerate(ball)}, CORNERS)


def test_points_lie_on_a_ball_and_are_seen_from_outside(ball, on_silhouettes):
    found = on_silhouettes
    assert len(found.points) > 1000
    error = np.linalg.norm(found.points, axis=1) - RADIUS
    pixel = 4.0 / ball[0].view.focal_px
    assert abs(np.median(error)) < pixel
    assert np.percentile(np.abs(error), 95) < 2 * pixel
    assert len(found.track_offsets) == len(found.points) + 1
    assert found.track_offsets[-1] == len(found.track_views)
    assert np.diff(found.track_offsets).max() <= 8
    owners = np.repeat(np.arange(len(found.points)), np.diff(found.track_offsets))
    centers = np.array([body.view.center for body in ball])[found.track_views // 3]
    away = centers - found.points[owners]
    cosines = np.einsum("ij,ij->i", away, found.points[owners])
    assert (cosines > 0.45 * np.linalg.norm(away, axis=1) * RADIUS).all()


def test_points_make_the_mesh_of_a_ball(ball, on_silhouettes):
    """Two points known of it, and its silhouettes, are enough."""
    views = [body.view for body in ball]
    found = on_silhouettes._replace(track_views=on_silhouettes.track_views // 3)
    rays = background_rays(views, [masked_background(body.mask) for body in ball], True)
    centers = np.array([view.center for view in views])
    mesh = meshing.mesh_points(*found, centers, MeshingOptions(), background=rays)
    solid = as_trimesh(mesh)
    assert solid.is_watertight and solid.euler_number == 2
    assert solid.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.05)


def test_silhouettes_of_edges_are_left_out(ball):
    outline = ball[0].view
    pixels, outward = contour(ball[0], CORNERS, 10_000)
    assert np.linalg.norm(outward, axis=1) == pytest.approx(1)
    middle = outline.project(np.zeros((1, 3)))[0]
    away = pixels - middle
    assert (np.einsum("ij,ij->i", away, outward) > 0.95 * np.linalg.norm(away, axis=1)).all()
    directions = np.column_stack([(pixels - [320, 240]) / outline.focal_px, np.ones(len(pixels))])
    edge = outline.center + 4.0 * directions[: len(pixels) // 2] @ outline.rotation
    fewer, _ = contour(ball[0], edge, 10_000)
    assert 0.3 * len(pixels) < len(fewer) < 0.5 * len(pixels)
    distances = np.linalg.norm(fewer[:, None] - pixels[None, : len(pixels) // 2], axis=2)
    assert distances.min() > 10
    assert len(contour(ball[0], CORNERS, 7)[0]) == 7


def test_what_stands_between_hides_a_point():
    """Two balls side by side along x: their inner sides are not seen along x."""
    centers = np.array([[-0.8, 0, 0], [0.8, 0, 0]])

    def is_hit(origin, directions):
        return hits_ball(centers[0])(origin, directions) | hits_ball(centers[1])(origin, directions)

    views = [looking((x, -0.01, 0), index=i) for i, x in enumerate((-6.0, 6.0))] + views_around(30)
    bodies = [masked(view, is_hit) for view in views]
    points = np.array([[-0.3, 0, 0], [1.3, 0, 0]])
    normals = np.array([[1.0, 0, 0], [1.0, 0, 0]])
    origins = np.array([view.center for view in views])
    rows, columns = seeing(points, normals, origins, [body.eroded() for body in bodies], 1.5)
    assert 1 not in columns[rows == 0], "the other ball is in between"
    assert 1 in columns[rows == 1]
    assert 0 not in columns, "it looks at their other sides"


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
    pixels, _ = contour(small, CORNERS, 1000)
    large, _ = contour(ball[0], CORNERS, 10_000)
    nearest = np.linalg.norm(pixels[:, None] - large[None], axis=2).min(axis=1)
    assert nearest.max() < 3


def test_lenses_bend_silhouettes():
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 600.0, 640, 480)
    camera.params = [600.0, 320.0, 240.0, -0.2]
    views = []
    for view in views_around(30):
        fields = {**vars(view), "camera": camera}
        views.append(type(view)(**{name: fields[name] for name in view.__dataclass_fields__}))
    bodies = [masked(view, hits_ball(np.array([0.3, 0.2, 0.1]))) for view in views]
    found = silhouette_points(dict(enumerate(bodies)), CORNERS + np.array([0.3, 0.2, 0.1]))
    error = np.linalg.norm(found.points - [0.3, 0.2, 0.1], axis=1) - RADIUS
    assert len(found.points) > 1000
    assert np.percentile(np.abs(error), 95) < 2 * 4.0 / 600


def test_views_are_spread():
    directions = fibonacci_sphere(200)
    chosen = spread(directions * np.linspace(1, 5, 200)[:, None], 20)
    assert len(set(chosen.tolist())) == 20
    cosines = directions[chosen] @ directions[chosen].T - 2 * np.eye(20)
    assert np.degrees(np.arccos(cosines.max())) > 25
    np.testing.assert_array_equal(np.sort(spread(directions[:5], 20)), np.arange(5))


def test_nothing_known_or_seen_makes_no_points(ball):
    for bodies in ({}, {0: ball[0]}):
        assert len(silhouette_points(bodies, CORNERS).points) == 0
    blank = {i: Body(body.view, np.zeros_like(body.mask)) for i, body in enumerate(ball)}
    found = silhouette_points(blank, CORNERS)
    assert len(found.points) == 0
    np.testing.assert_array_equal(found.track_offsets, [0])


@pytest.fixture(scope="module")
def on_ball(ball, scene_model, scene_edges):
    """A model of the ball's views, with 3D edge points on the ball."""
    points = RADIUS * fibonacci_sphere(scene_edges.num_points)
    model = replace(scene_model, views=tuple(body.view for body in ball))
    return model, replace(scene_edges, points=points)


def test_rays_alone_where_nothing_more_is_known(ball, on_ball):
    """Without edges and SfM points, and where bodies are as bright as the backdrop."""
    model, edges = on_ball
    background_masks = [masked_background(body.mask) for body in ball]
    bright = [replace(each, body_pixels=np.array([100, 1])) for each in background_masks]
    bare = replace(model, points3D_xyz=np.zeros((0, 3)))
    model = replace(model, points3D_xyz=edges.points)
    for given, known, seen in (
        (bare, Edges3D.none(), background_masks),
        (model, edges, bright),
        (model, Edges3D.none(), bright),
    ):
        found = find_background(given, seen, False, known)
        assert len(found.rays.cameras) > 10_000
        assert len(found.silhouettes.points) == 0


def test_sfm_points_of_bodies_do_where_there_are_no_edges(ball, on_ball):
    """Points of what stands around do not count."""
    model, edges = on_ball
    background_masks = [masked_background(body.mask) for body in ball]
    around = 50.0 * fibonacci_sphere(10 * edges.num_points)
    some = np.concatenate([edges.points[::40], around])
    model = replace(model, points3D_xyz=some)
    found = find_background(model, background_masks, True, Edges3D.none())
    points = found.silhouettes.points
    assert len(points) > 500
    assert np.percentile(np.abs(np.linalg.norm(points, axis=1) - RADIUS), 95) < 0.02


def test_masks_of_nothing_are_not_believed(ball, on_ball, caplog):
    """Inverted masks of a scene that fills its images hide all of them."""
    model, edges = on_ball
    black = [masked_background(np.zeros((40, 60), bool))] * len(ball)
    assert find_background(model, black, True, edges) is None
    assert "masks hide all of every image" in caplog.text


def test_edges_and_contours_without_points_change_nothing(ball, on_ball):
    """Curves of which there are none come before the points of silhouettes."""
    few, (model, edges) = ball[::5], on_ball
    model = replace(model, views=tuple(body.view for body in few))
    background_masks = [masked_background(body.mask) for body in few]
    found = replace(
        find_background(model, background_masks, False, edges),
        silhouettes=silhouette_points(dict(enumerate(few)), CORNERS),
    )
    assert len(found.silhouettes.points) > 0
    none = Edges3D.none()
    alone = meshing.mesh(model, background=found)
    for curves in ({"edges": none}, {"contours": none}, {"edges": none, "contours": none}):
        same = meshing.mesh(model, background=found, **curves)
        np.testing.assert_array_equal(same.vertices, alone.vertices)
        np.testing.assert_array_equal(same.faces, alone.faces)


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
