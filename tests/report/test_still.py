from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.report.contents import Contents
from colmap_edges.report.still import EDGE_BGR, SIZE_PX, draw_faces_and_edges, still_picture
from colmap_edges.report.viewpoint import FOV, Viewpoint, fitted, viewpoint
from colmap_edges.surfaces.mesh import Mesh

# Looks along +z from the origin, y downwards.
AHEAD = Viewpoint(eye=np.zeros(3), focus=np.array([0, 0, 2.0]), up=np.array([0, -1.0, 0]))


def wall(depth):
    """A square of two triangles across the line of sight."""
    corners = np.array([[-1, -1, depth], [1, -1, depth], [1, 1, depth], [-1, 1, depth]], float)
    return Mesh(
        vertices=corners,
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        point3D_ids=np.full(4, -1),
        colors=np.full((4, 3), 128, np.uint8),
    )


def line(depth):
    """One edge from left to right."""
    points = np.array([[-0.5, 0, depth], [0.5, 0, depth]], float)
    return Edges3D.of_polylines(points, np.array([2]))


@pytest.mark.parametrize(("edge_depth", "seen"), [(1.5, True), (2.0, True), (2.5, False)])
def test_edges_on_or_before_a_surface_are_seen_and_others_not(edge_depth, seen):
    canvas = np.full((200, 320, 3), 255, np.uint8)
    contents = SimpleNamespace(mesh=wall(2.0), edges=line(edge_depth))
    draw_faces_and_edges(canvas, contents, AHEAD)
    assert (canvas == EDGE_BGR).all(axis=2).any() == seen
    focal = 100 / np.tan(FOV / 2)
    assert (canvas[100, :, 0] < 255).sum() == pytest.approx(2 * focal / 2.0, abs=3)


def test_points_behind_the_eye_are_not_drawn():
    canvas = np.full((200, 320, 3), 255, np.uint8)
    draw_faces_and_edges(canvas, SimpleNamespace(mesh=wall(-2.0), edges=line(-1.0)), AHEAD)
    assert (canvas == 255).all()


def test_fitted_view_contains_its_points():
    points = np.random.default_rng(0).normal((5, 2, 9), (3, 1, 0.5), (500, 3))
    found = fitted(points, AHEAD, 1.6)
    right, down, depth = ((points - found.eye) @ found.axes.T).T
    inside = (np.abs(right) < 1.6 * np.tan(FOV / 2) * depth) & (
        np.abs(down) < np.tan(FOV / 2) * depth
    )
    assert inside.mean() > 0.97
    assert np.ptp(right / depth) > 1.6 * np.tan(FOV / 2)  # and fills much of the picture


def test_a_scene_is_seen_as_its_photographs_show_it(scene_model):
    contents = Contents(model=scene_model)
    view = viewpoint(contents, 1.6)
    counts = np.bincount(scene_model.track_views, minlength=len(scene_model.views))
    best = scene_model.views[int(counts.argmax())]
    assert view.axes[2] @ best.rotation[2] == pytest.approx(1)
    assert not view.is_inside
    picture = cv2.imdecode(np.frombuffer(still_picture(contents), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (SIZE_PX[1], SIZE_PX[0], 3)
    assert (picture < 200).any(axis=2).mean() > 0.001


def test_an_eye_within_the_scene_stays_there(scene_model):
    around = np.random.default_rng(0).normal(0, 1, (400, 3)) + scene_model.camera_centers[0]
    everywhere = SimpleNamespace(
        views=scene_model.views,
        camera_centers=scene_model.camera_centers,
        points3D_xyz=around,
        track_offsets=np.arange(401),
        track_views=np.zeros(400, np.int32),
    )
    view = viewpoint(SimpleNamespace(model=everywhere, edges=None), 1.6)
    assert view.is_inside
    np.testing.assert_array_equal(view.eye, scene_model.camera_centers[0])
