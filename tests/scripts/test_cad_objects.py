"""CAD objects: their solids are closed, their sharp curves known, images show what cameras see."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

pytest.importorskip("manifold3d", reason="the objects are made with manifold3d")

from cad_objects.shading import CREASE, FOCAL, SIZE, brightness, make_model
from cad_objects.solids import OBJECTS
from make_cad_objects import mesh_of, sharp_curves


def lengths_of(points, edges):
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_are_closed_and_fill_the_unit_box(name):
    mesh = mesh_of(name)
    assert mesh.is_watertight and mesh.volume > 0
    np.testing.assert_allclose(mesh.bounds.mean(axis=0), 0.5, atol=1e-9)
    np.testing.assert_allclose(mesh.extents.max(), 1)


def test_sharp_curves_are_those_of_the_solid():
    points, edges = sharp_curves(trimesh.creation.box((1, 2, 3)))
    assert len(points) == 8 and len(edges) == 12
    assert lengths_of(points, edges).sum() == pytest.approx(4 * (1 + 2 + 3))
    smooth = trimesh.creation.cylinder(radius=1, height=1, sections=96)
    points, edges = sharp_curves(smooth)  # its two rims, not its sides
    assert lengths_of(points, edges).sum() == pytest.approx(4 * np.pi, rel=1e-3)


def test_views_look_at_the_origin_from_all_around():
    model = make_model()
    poses = [image.cam_from_world() for image in model.images.values()]
    centers = np.array([-pose.rotation.matrix().T @ pose.translation for pose in poses])
    np.testing.assert_allclose(np.linalg.norm(centers, axis=1), 4)
    assert np.linalg.norm(centers.mean(axis=0)) < 0.1
    for pose in poses:
        np.testing.assert_allclose(pose.translation, (0, 0, 4), atol=1e-9)


def test_images_show_a_box_where_the_camera_sees_it():
    mesh = trimesh.creation.box((0.6, 0.8, 1))
    smooth = trimesh.graph.smooth_shade(mesh, angle=CREASE)
    model = make_model()
    image = model.images[20]
    light = brightness(smooth, RayMeshIntersector(smooth), image)
    pose = image.cam_from_world()
    local = mesh.vertices @ pose.rotation.matrix().T + pose.translation
    corners = FOCAL * local[:, :2] / local[:, 2:] + SIZE / 2
    rows, columns = np.nonzero(light < 1 - 1e-6)
    # A pixel is touched where the box reaches into it, so that the outermost are cut by its bounds.
    np.testing.assert_array_equal([columns.min(), rows.min()], np.floor(corners.min(axis=0)))
    np.testing.assert_array_equal([columns.max(), rows.max()], np.floor(corners.max(axis=0)))
    inside = light[light < 1 - 1e-6]
    assert len(np.unique(np.round(inside, 3))) >= 3  # its faces differ
