"""The CAD objects: closed solids, known sharp curves, correct images."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

pytest.importorskip("manifold3d", reason="the objects are made with manifold3d")

from cad_objects.shading import CREASE, FOCAL, SIZE, brightness, make_model
from cad_objects.solids import OBJECTS
from cad_objects.true_curves import ARC, CIRCLE, ELLIPSE, LINE, curves_by_kind
from make_cad_objects import mesh_of, sharp_curves
from project import run_script
from scipy.spatial import cKDTree


def lengths_of(points, edges):
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


def test_curves_have_their_kind_and_radius():
    points, edges = sharp_curves(mesh_of("plate"))
    curves, kinds, radii = curves_by_kind(points, edges)
    assert curves.min() == 0 and curves.max() + 1 == len(kinds) == len(radii)
    holes = kinds == CIRCLE
    assert holes.sum() == 2 * 12 and set(kinds.tolist()) == {LINE, CIRCLE}
    np.testing.assert_allclose(radii[holes], 0.04, rtol=1e-6)
    assert np.isnan(radii[~holes]).all()
    points, edges = sharp_curves(mesh_of("tray"))
    _, kinds, radii = curves_by_kind(points, edges)
    assert (kinds == LINE).sum() == 16 and (kinds == CIRCLE).sum() == 4
    rounded = np.round(radii[kinds == ARC, 0], 2)
    assert sorted(set(rounded.tolist())) == [0.04, 0.1]
    points, edges = sharp_curves(trimesh.creation.cylinder(radius=1, height=1, sections=96))
    slanted = points * (1, 2, 1)
    assert curves_by_kind(slanted, edges)[1].tolist() == [ELLIPSE, ELLIPSE]
    np.testing.assert_allclose(curves_by_kind(slanted, edges)[2], [[2, 1], [2, 1]], rtol=1e-6)


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


def test_objects_are_written_small(tmp_path):
    name = next(iter(OBJECTS))
    small = ("--names", name, "--num_views", 3, "--size", 48)
    run_script("make_cad_objects.py", "--output_path", tmp_path, *small)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    folder = tmp_path / name
    model = pycolmap.Reconstruction(folder / "sparse")
    mesh = trimesh.load(folder / "surface.ply", process=False)
    with np.load(folder / "curves.npz") as curves:
        points, edges = curves["points"], curves["edges"]
        assert len(curves["curves"]) == len(edges) and curves["curves"].max() < len(curves["kinds"])
    assert len(model.images) == 3 and len(edges) > 10
    for image in model.images.values():
        picture = cv2.imread(str(folder / "images" / image.name), cv2.IMREAD_GRAYSCALE)
        assert picture.shape == (image.camera.height, image.camera.width) == (48, 48)
        pixels = image.camera.img_from_cam(image.cam_from_world() * mesh.vertices)
        rows, columns = np.nonzero(picture < 240)
        assert abs(columns.min() - pixels[:, 0].min()) < 2
        assert abs(rows.max() + 1 - pixels[:, 1].max()) < 2
    assert edges.max() < len(points)
    assert cKDTree(mesh.vertices).query(points)[0].max() < 1e-6
