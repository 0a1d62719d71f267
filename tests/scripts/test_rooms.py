"""The synthetic rooms: closed surfaces, free cameras, correct light and images."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh

pytest.importorskip("manifold3d", reason="the rooms are made with manifold3d")

from demo_scene.bodies import Body, box
from demo_scene.geometry import unite
from project import run_script
from rooms.light import Caster, illuminate
from rooms.materials import MATERIALS, blotches
from rooms.plans import ROOMS, Room, camera_centers, downlight
from scipy.spatial import cKDTree


@pytest.fixture(scope="module", params=ROOMS)
def room(request):
    return ROOMS[request.param]()


def test_rooms_are_closed_and_cameras_stand_free_inside(room):
    surface = unite(room.bodies)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight and mesh.volume > 0
    caster = Caster.of(surface)
    assert len(room.cameras) >= 40
    rays = np.random.default_rng(0).normal(size=(2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for center in camera_centers(room):
        faces, distance = caster.hits(np.broadcast_to(center, rays.shape), rays)
        hit = faces >= 0
        assert hit.mean() > 0.95  # but for a skylight
        assert distance.min() > 0.15
        assert (np.einsum("ij,ij->i", caster.normals[faces], rays)[hit] < 0).all()


def test_rooms_are_mostly_plain(room):
    """At most 15 % of what the cameras see has texture."""
    surface = unite(room.bodies)
    caster = Caster.of(surface)
    contrast = np.array([MATERIALS[body.material].contrast for body in room.bodies])
    pixels = np.random.default_rng(0).uniform(-1, 1, (500, 2)) * (0.74, 0.56)
    local = np.column_stack([pixels, np.ones(len(pixels))])
    seen = []
    for camera in room.cameras:
        rays = local @ camera.cam_from_world[:, :3]
        faces, _ = caster.hits(np.broadcast_to(camera.centre(), rays.shape), rays)
        seen.append(contrast[surface.face_body[faces[faces >= 0]]] > 0.1)
    assert 0.005 < np.concatenate(seen).mean() < 0.15


def test_light_in_a_closed_box_is_that_of_a_furnace():
    """Where all walls reflect alike, bounces multiply what falls in by 1 / (1 - albedo)."""
    shell = box((-1.2, 1.2), (-1.2, 1.2), (-1.2, 1.2)) - box((-1, 1), (-1, 1), (-1, 1))
    lamp = downlight(0, 0, 0.95, 0.3, 2.0)
    room = Room(
        bodies=[Body(name="room", material="ceiling", solid=shell)], lamps=[lamp], cameras=[]
    )
    surface = unite(room.bodies, longest=0.3)
    lit = illuminate(surface, room, bounces=30)
    corners = lit.caster.corners
    centers = corners.mean(axis=1)
    inside = (np.abs(centers) < 1.1).all(axis=1)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)[inside] / 2
    falls = lit.light[lit.keys].mean(axis=1)[inside]
    power = np.pi * falls.T @ area  # all that falls on the walls
    sent = np.pi * lamp.radiance * 0.6**2
    albedo = np.array(MATERIALS["ceiling"].albedo)
    np.testing.assert_allclose(power, sent / (1 - albedo), rtol=0.06)
    outside = lit.light[lit.keys].mean(axis=1)[(np.abs(centers) > 1.15).any(axis=1)]
    assert outside.max() == 0


def test_shadows_fall_behind_bodies():
    floor = box((-2, 2), (-2, 2), (-0.2, 0))
    board = box((-0.5, 0.5), (-0.5, 0.5), (0.5, 0.6))
    bodies = [Body(name=str(i), material="wall", solid=s) for i, s in enumerate((floor, board))]
    room = Room(bodies=bodies, lamps=[downlight(0, 0, 2.0, 0.05, 50.0)], cameras=[])
    lit = illuminate(unite(bodies, longest=0.06), room, bounces=0)
    caster = lit.caster
    starts = np.array([(0, 0, 0.3), (1.3, 0, 0.3), (0, 0, 1.0)])
    faces, distance = caster.hits(starts, np.tile((0.0, 0, -1), (3, 1)))
    np.testing.assert_allclose(distance, [0.3, 0.3, 0.4], atol=1e-9)
    found = lit.radiance(faces, starts - distance[:, None] * (0, 0, 1))
    squared = np.array([4, 1.3**2 + 4, 1.4**2])  # to the lamp
    cosine = np.array([2, 2, 1.4]) / np.sqrt(squared)
    expected = 50 * 0.1**2 * cosine**2 / squared / np.pi * (0, 1, 1)  # the first is in the shadow
    albedo = np.array(MATERIALS["wall"].albedo)
    # Smoothing against the noise of rays lowers the peak below the lamp.
    np.testing.assert_allclose(found, expected[:, None] * albedo, rtol=0.1, atol=1e-4)


def test_blotches_have_unit_deviation_and_are_smooth():
    places = np.random.default_rng(1).uniform(0, 20, (20000, 3))
    field = blotches(places, 0.5, seed=3)
    assert abs(field.mean()) < 0.05
    assert field.std() == pytest.approx(1, abs=0.05)
    near = blotches(places + np.array([1e-3, 0, 0]), 0.5, seed=3)
    assert np.abs(near - field).max() < 0.5


def test_a_room_is_written_small(tmp_path):
    small = ("--names", "corridor", "--num_views", 3, "--size", 96, 72, "--cut", 0.5)
    run_script("make_room.py", "--output_path", tmp_path / "a", *small)
    folder = tmp_path / "a" / "corridor"
    model = pycolmap.Reconstruction(folder / "sparse")
    assert model.num_reg_images() == 3
    mesh = trimesh.load(folder / "surface.ply", process=False)
    with np.load(folder / "curves.npz") as curves:
        points, edges = curves["points"], curves["edges"]
    assert edges.max() < len(points)
    assert cKDTree(points).query(mesh.vertices)[0].min() < 1e-5
    for image in model.images.values():
        picture = cv2.imread(str(folder / "images" / image.name))
        assert picture.shape == (72, 96, 3)
        assert 60 < np.median(picture) < 220
        assert picture.std() > 10
    run_script("make_room.py", "--output_path", tmp_path / "b", *small)
    for path in (folder / "images").iterdir():
        assert path.read_bytes() == (tmp_path / "b/corridor/images" / path.name).read_bytes()
