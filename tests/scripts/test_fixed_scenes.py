"""The fixed rooms and CAD objects: closed surfaces, free cameras, known curves, correct images."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh

pytest.importorskip("manifold3d", reason="the scenes are made with manifold3d")

from project import run_script
from scipy.spatial import cKDTree
from zoo.camera import Grid, pinhole
from zoo.casting import Caster
from zoo.curves import ARC, CIRCLE, ELLIPSE, LINE, curves_by_kind
from zoo.fixed import ObjectLit, all_around, mesh_of, sharp_curves
from zoo.geometry import Body, unite
from zoo.machined import OBJECTS
from zoo.materials import blotches
from zoo.plans import MATERIALS, ROOMS, Room, downlight
from zoo.radiosity import illuminate
from zoo.render import see
from zoo.solids import box


@pytest.fixture(scope="module", params=ROOMS)
def room(request):
    return ROOMS[request.param]()


def test_rooms_are_closed_and_cameras_stand_free_inside(room):
    surface = unite(room.bodies)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight and mesh.volume > 0
    caster = Caster(surface)
    assert len(room.views) >= 40
    rays = np.random.default_rng(0).normal(size=(2000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for view in room.views:
        faces, distance = caster.hits(view.centre(), rays)
        hit = faces >= 0
        assert hit.mean() > 0.95  # but for a skylight
        assert distance.min() > 0.15
        assert (np.einsum("ij,ij->i", caster.normals[faces], rays)[hit] < 0).all()


def test_rooms_are_mostly_plain(room):
    """At most 15 % of what the cameras see has texture."""
    surface = unite(room.bodies)
    caster = Caster(surface)
    contrast = np.array([MATERIALS[body.material].contrast for body in room.bodies])
    pixels = np.random.default_rng(0).uniform(-1, 1, (500, 2)) * (0.74, 0.56)
    seen = []
    for view in room.views:
        faces, _ = caster.hits(view.centre(), view.rays(pixels))
        seen.append(contrast[surface.face_body[faces[faces >= 0]]] > 0.1)
    assert 0.005 < np.concatenate(seen).mean() < 0.15


def test_light_in_a_closed_box_is_that_of_a_furnace():
    """Where all walls reflect alike, bounces multiply what falls in by 1 / (1 - albedo)."""
    shell = box((-1.2, 1.2), (-1.2, 1.2), (-1.2, 1.2)) - box((-1, 1), (-1, 1), (-1, 1))
    lamp = downlight(0, 0, 0.95, 0.3, 2.0)
    room = Room(bodies=[Body(name="room", material="ceiling", solid=shell)], lamps=[lamp], views=[])
    surface = unite(room.bodies, longest=0.3)
    lit = illuminate(surface, room, bounces=30)
    centers = lit.caster.surface.corners.mean(axis=1)
    inside = (np.abs(centers) < 1.1).all(axis=1)
    area = np.linalg.norm(lit.caster.surface.crosses, axis=1)[inside] / 2
    falls = lit.vectors[lit.corners].mean(axis=1)[inside]
    power = np.pi * falls.T @ area  # all that falls on the walls
    sent = np.pi * lamp.radiance * 0.6**2
    albedo = np.array(MATERIALS["ceiling"].albedo)
    np.testing.assert_allclose(power, sent / (1 - albedo), rtol=0.06)
    outside = lit.vectors[lit.corners].mean(axis=1)[(np.abs(centers) > 1.15).any(axis=1)]
    assert outside.max() == 0


def test_shadows_fall_behind_bodies():
    floor = box((-2, 2), (-2, 2), (-0.2, 0))
    board = box((-0.5, 0.5), (-0.5, 0.5), (0.5, 0.6))
    bodies = [Body(name=str(i), material="wall", solid=s) for i, s in enumerate((floor, board))]
    room = Room(bodies=bodies, lamps=[downlight(0, 0, 2.0, 0.05, 50.0)], views=[])
    lit = illuminate(unite(bodies, longest=0.06), room, bounces=0)
    caster = lit.caster
    starts = np.array([(0, 0, 0.3), (1.3, 0, 0.3), (0, 0, 1.0)])
    _, distance = caster.hits(starts, np.tile((0.0, 0, -1), (3, 1)))
    np.testing.assert_allclose(distance, [0.3, 0.3, 0.4], atol=1e-9)
    down = np.array([[0, 0, -1.0]])
    found = np.concatenate(
        [lit.shade(face, start, down, where)[0] for start in starts
         for _, face, where in [caster.seen(start, down)]]
    )  # fmt: skip
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


def read_scene(folder, num_views, size):
    """The model, true mesh, points and edges of curves, and pictures by name of a small scene."""
    model = pycolmap.Reconstruction(folder / "sparse")
    mesh = trimesh.load(folder / "surface.ply", process=False)
    with np.load(folder / "curves.npz") as data:
        curves = dict(data)
    assert model.num_reg_images() == num_views
    assert curves["edges"].max() < len(curves["points"])
    pictures = {i.name: cv2.imread(str(folder / "images" / i.name)) for i in model.images.values()}
    assert all(picture.shape == (*size[::-1], 3) for picture in pictures.values())
    return model, mesh, curves, pictures


def test_a_room_is_written_small(tmp_path, hash_folder):
    small = ("--num_views", 3, "--size", "96x72", "--output_path")
    run_script("make_scene.py", "rooms", "corridor", *small, tmp_path / "a")
    _, mesh, curves, pictures = read_scene(tmp_path / "a", 3, (96, 72))
    assert cKDTree(curves["points"]).query(mesh.vertices)[0].min() < 1e-5
    for picture in pictures.values():
        assert 60 < np.median(picture) < 220
        assert picture.std() > 10
    run_script("make_scene.py", "rooms", "corridor", *small, tmp_path / "b")
    assert hash_folder(tmp_path / "a" / "images") == hash_folder(tmp_path / "b" / "images")
    run_script("make_scene.py", "rooms", "corridor", "--seed", 1, *small, tmp_path / "c")
    assert hash_folder(tmp_path / "a" / "images") != hash_folder(tmp_path / "c" / "images")


def test_scenes_that_are_not_there_are_refused(tmp_path):
    for family, scene, known in (
        ("rooms", "kitchen", "living, attic, corridor, a seed"),
        ("smooth", "can", "a seed"),
        ("demo", "3", "geometry, images, sparse, all"),
    ):
        done = run_script("make_scene.py", family, scene, "--output_path", tmp_path / "x", code=2)
        assert f"{family} has no scene {scene}; give {known}" in " ".join(done.stderr.split())
    assert not (tmp_path / "x").exists()


def lengths_of(points, edges):
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


def test_curves_have_their_kind_and_radius():
    points, edges = sharp_curves(mesh_of(OBJECTS["plate"]()))
    curves, kinds, radii = curves_by_kind(points, edges)
    assert curves.min() == 0 and curves.max() + 1 == len(kinds) == len(radii)
    holes = kinds == CIRCLE
    assert holes.sum() == 2 * 12 and set(kinds.tolist()) == {LINE, CIRCLE}
    np.testing.assert_allclose(radii[holes], 0.04, rtol=1e-6)
    assert np.isnan(radii[~holes]).all()
    points, edges = sharp_curves(mesh_of(OBJECTS["tray"]()))
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
    mesh = mesh_of(OBJECTS[name]())
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
    views = all_around(50)
    centers = np.array([view.centre() for view in views])
    np.testing.assert_allclose(np.linalg.norm(centers, axis=1), 4)
    assert np.linalg.norm(centers.mean(axis=0)) < 0.1
    for view in views:
        np.testing.assert_allclose(view.cam_from_world[:, 3], (0, 0, 4), atol=1e-9)


def test_images_show_a_box_where_the_camera_sees_it():
    mesh = trimesh.creation.box((0.6, 0.8, 1))
    camera, view = pinhole((800, 800), 1111), all_around(50)[19]
    light = see(ObjectLit.of(mesh), view, Grid.of(camera))[..., 0]
    corners = camera.img_from_cam(view.local(mesh.vertices))
    rows, columns = np.nonzero(light < 1 - 1e-6)
    # A pixel is touched where the box reaches into it, so that the outermost are cut by its bounds.
    np.testing.assert_array_equal([columns.min(), rows.min()], np.floor(corners.min(axis=0)))
    np.testing.assert_array_equal([columns.max(), rows.max()], np.floor(corners.max(axis=0)))
    inside = light[light < 1 - 1e-6]
    assert len(np.unique(np.round(inside, 3))) >= 3  # its faces differ


def test_objects_are_written_small(tmp_path):
    small = ("--num_views", 3, "--size", "48x48", "--output_path", tmp_path)
    run_script("make_scene.py", "cad", "bracket", *small)
    model, mesh, curves, pictures = read_scene(tmp_path, 3, (48, 48))
    assert len(curves["edges"]) > 10
    assert len(curves["curves"]) == len(curves["edges"])
    assert curves["curves"].max() < len(curves["kinds"])
    for image in model.images.values():
        pixels = image.camera.img_from_cam(image.cam_from_world() * mesh.vertices)
        rows, columns = np.nonzero(pictures[image.name][..., 0] < 240)
        assert abs(columns.min() - pixels[:, 0].min()) < 2
        assert abs(rows.max() + 1 - pixels[:, 1].max()) < 2
    assert cKDTree(mesh.vertices).query(curves["points"])[0].max() < 1e-6
