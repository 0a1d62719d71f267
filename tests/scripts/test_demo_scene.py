"""The demo scene of the project: consistency of model, images and ground truth."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh
from project import DEMO
from scipy import ndimage
from scipy.spatial import cKDTree


@pytest.fixture(scope="module")
def model() -> pycolmap.Reconstruction:
    return pycolmap.Reconstruction(DEMO / "sparse")


@pytest.fixture(scope="module")
def surface() -> trimesh.Trimesh:
    return trimesh.load(DEMO / "surface.ply", process=False)


@pytest.fixture(scope="module")
def curves() -> dict[str, np.ndarray]:
    with np.load(DEMO / "curves.npz") as data:
        return dict(data)


@pytest.fixture(scope="module")
def truth() -> dict:
    return json.loads((DEMO / "true_cameras.json").read_text())


def views(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    return sorted(model.images.values(), key=lambda image: image.name)


def true_pose(truth: dict, name: str) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(np.array(truth["cam_from_world"][name]))


def visible(surface: trimesh.Trimesh, centre: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Tell which points on the surface no part of the surface hides from `centre`."""
    rays = points - centre
    hit, ray, _ = surface.ray.intersects_location(
        np.repeat(centre[None], len(rays), axis=0), rays, multiple_hits=False
    )
    seen = np.ones(len(points), bool)
    depth = np.linalg.norm(hit - centre, axis=1) / np.linalg.norm(rays[ray], axis=1)
    seen[ray] = depth > 1 - 1e-3
    return seen


def edge_distance(path: Path) -> np.ndarray:
    """Distance in pixels of every pixel of an image to its nearest Canny edge."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return ndimage.distance_transform_edt(cv2.Canny(grey, 20, 60) == 0)


def sample(field: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Read a field at COLMAP pixel positions (N, 2); positions outside it are left out."""
    column, row = np.floor(pixels).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < field.shape[1]) & (row < field.shape[0])
    return field[row[inside], column[inside]]


def test_every_image_is_registered_and_has_its_cameras_size(model):
    files = sorted(path.name for path in (DEMO / "images").iterdir())
    assert [image.name for image in views(model)] == files
    assert model.num_reg_images() == len(files) >= 24
    for image in views(model):
        camera = model.cameras[image.camera_id]
        height, width = cv2.imread(str(DEMO / "images" / image.name)).shape[:2]
        assert (camera.width, camera.height) == (width, height)


def test_images_are_well_exposed(model):
    for image in views(model):
        grey = cv2.imread(str(DEMO / "images" / image.name), cv2.IMREAD_GRAYSCALE)
        assert 60 < grey.mean() < 190, image.name
        assert grey.std() > 20, image.name
        assert np.mean(grey >= 254) < 0.02, image.name
        assert np.mean(grey <= 1) < 0.02, image.name


def test_sparse_model_is_dense_and_accurate(model):
    assert model.num_points3D() >= 3000
    assert model.compute_mean_reprojection_error() < 1.0
    assert model.compute_mean_track_length() > 3.0


def test_camera_centres_lie_on_the_true_ones(model, truth):
    for image in views(model):
        true = true_pose(truth, image.name)
        centre = true.inverse().translation
        distance = np.linalg.norm(centre)
        assert np.linalg.norm(image.projection_center() - centre) < 2e-3 * distance
        turn = image.cam_from_world().rotation * true.rotation.inverse()
        assert np.degrees(turn.angle()) < 0.1


def test_points_project_alike_through_true_and_found_cameras(model, truth):
    camera = pycolmap.Camera(
        model=truth["model"], width=truth["width"], height=truth["height"], params=truth["params"]
    )
    points = np.array([point.xyz for point in model.points3D.values()])
    for image in views(model):
        expected = camera.img_from_cam(true_pose(truth, image.name) * points)
        found = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * points)
        assert np.median(np.linalg.norm(found - expected, axis=1)) < 1.0, image.name


def test_sfm_points_lie_on_the_true_surface(model, surface):
    image = views(model)[5]
    points = np.array([model.points3D[p.point3D_id].xyz for p in image.points2D if p.has_point3D()])
    centre = image.projection_center()
    hit, ray, _ = surface.ray.intersects_location(
        np.repeat(centre[None], len(points), axis=0), points - centre, multiple_hits=False
    )
    error = np.linalg.norm(hit - points[ray], axis=1) / np.linalg.norm(hit - centre, axis=1)
    assert len(ray) > 0.9 * len(points)
    assert np.median(error) < 2e-3


def test_visible_true_curves_fall_on_image_edges(model, surface, curves):
    on_edge, beside = [], []
    for image in views(model):
        points = curves["points"][visible(surface, image.projection_center(), curves["points"])]
        pixels = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * points)
        distance = edge_distance(DEMO / "images" / image.name)
        on_edge.append(sample(distance, pixels))
        beside.append(sample(distance, pixels + 6.0))
        assert len(on_edge[-1]) > 5000, image.name
        assert np.median(on_edge[-1]) < 1.5, image.name
    assert np.mean(np.concatenate(on_edge) <= 2.0) > 0.8
    assert np.mean(np.concatenate(beside) <= 2.0) < 0.4


def test_surface_is_closed_and_every_sharp_edge_is_a_curve(surface, curves):
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume > 0
    sharp = np.degrees(surface.face_adjacency_angles) > 26.0
    middles = surface.vertices[surface.face_adjacency_edges[sharp]].mean(axis=1)
    spacing = np.linalg.norm(np.diff(curves["points"][curves["edges"]], axis=1), axis=2).max()
    distance, _ = cKDTree(curves["points"]).query(middles)
    assert distance.max() < spacing


def test_curves_are_chains_of_known_kind(curves):
    assert curves["points"].dtype == np.float64
    assert curves["edges"].dtype == np.int32
    assert curves["edges"].min() >= 0
    assert np.array_equal(np.unique(curves["edges"]), np.arange(len(curves["points"])))
    assert set(curves["kind_names"][curves["kind"]]) == {"crease", "contact", "texture"}
    for index in np.unique(curves["curve_id"]):
        own = curves["curve_id"] == index
        assert len(np.unique(curves["kind"][own])) == 1
        assert np.bincount(curves["edges"][own].ravel()).max() <= 2


def test_smooth_bodies_carry_no_crease(surface, curves):
    names = curves["body_names"][curves["face_body"]]
    assert len(names) == len(surface.faces)
    crease = np.flatnonzero(curves["kind_names"] == "crease")[0]
    points = curves["points"][np.unique(curves["edges"][curves["kind"] == crease])]
    for name in ("pear", "sphere", "torus"):
        own = surface.vertices[np.unique(surface.faces[names == name])]
        inside = np.all((points > own.min(axis=0)) & (points < own.max(axis=0)), axis=1)
        assert not inside.any(), name


def test_demo_data_stays_small_in_the_repository():
    files = [path for path in DEMO.rglob("*") if path.is_file()]
    assert sum(len(zlib.compress(path.read_bytes())) for path in files) < 6_000_000
