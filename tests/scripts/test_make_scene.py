"""The random scenes: truth, images and model agree, and the same seed gives the same scene."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pycolmap
import pytest
import trimesh

pytest.importorskip("manifold3d", reason="the scenes are made with manifold3d")

from project import run_script
from scipy import ndimage
from zoo import FAMILIES, cad
from zoo.camera import Grid, Place, Rig, View, draw_camera
from zoo.casting import Caster
from zoo.geometry import Body, Surface, unite
from zoo.light import Light, Stage, illuminate, plain
from zoo.make import draw_settings, exposed, free_views, make_scene
from zoo.materials import Material, blotches
from zoo.render import GAMMA, Sensor, see, write_image
from zoo.solids import box
from zoo.truth import find_curves, in_image, seen_by

SMALL = {"size": (160, 120), "num_views": 14}
SEED = 6  # of scenes with points in every family


@pytest.fixture(scope="module", params=FAMILIES)
def made(request, tmp_path_factory):
    """The folder of a small scene of each family."""
    folder = tmp_path_factory.mktemp(request.param)
    make_scene(request.param, SEED, folder, **SMALL)
    return folder


def true_views(folder):
    """The true cameras of a scene."""
    truth = json.loads((folder / "true_cameras.json").read_text())
    camera = pycolmap.Camera(
        camera_id=1,
        **{key: truth[key] for key in ("model", "width", "height", "params")},
    )
    views = [
        View(name=name, cam_from_world=np.array(pose))
        for name, pose in truth["cam_from_world"].items()
    ]
    return camera, views


def read_surface(folder):
    mesh = trimesh.load(folder / "surface.ply", process=False)
    none = np.zeros(len(mesh.faces), np.int32)
    return Surface(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces), face_body=none)


def test_true_curves_lie_on_the_surface_and_are_seen(made):
    camera, views = true_views(made)
    surface = read_surface(made)
    with np.load(made / "curves.npz") as data:
        curves = dict(data)
    points, edges, visible = curves["points"], curves["edges"], curves["visible"]
    assert len(edges) > 50 and visible.shape == (len(edges), len(views))
    assert curves["view_names"].tolist() == [view.name for view in views]
    assert np.array_equal(np.unique(edges), np.arange(len(points)))
    assert len(curves["kind"]) == len(curves["curve_id"]) == len(curves["curves"]) == len(edges)
    assert curves["curves"].max() < len(curves["kinds"]) == len(curves["radii"])
    assert visible.sum(axis=1).min() >= 2
    again = seen_by(Caster(surface), points[edges].mean(axis=1), Rig(camera, views))
    assert (again == visible).mean() > 0.98
    triangles, size = surface.vertices[surface.faces], np.ptp(surface.vertices, axis=0).max()
    for point in points[:: len(points) // 10]:
        nearest = trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
        assert np.linalg.norm(nearest - point, axis=1).min() < 1e-5 * size


def test_model_agrees_with_the_truth(made):
    camera, views = true_views(made)
    caster = Caster(read_surface(made))
    record = json.loads((made / "scene.json").read_text())
    model = pycolmap.Reconstruction(made / "sparse")
    assert model.num_reg_images() == len(views)
    assert model.cameras[1].params.tolist() == camera.params.tolist()
    assert 0 < model.num_points3D() <= record["num_points"]
    assert 0.2 < model.compute_mean_reprojection_error() < 1.5
    errors, shifts = [], []
    for view in views:
        image = next(image for image in model.images.values() if image.name == view.name)
        found = [point for point in image.points2D if point.has_point3D()]
        assert all(model.points3D[p.point3D_id].track.length() >= 3 for p in found)
        if not found:
            continue
        xyz = np.array([model.points3D[point.point3D_id].xyz for point in found])
        pose = pycolmap.Rigid3d(view.cam_from_world)
        pixels = np.array([camera.img_from_cam(local) for local in pose * xyz])
        shifts.append(pixels - [point.xy for point in found])
        rays = xyz - view.centre()
        errors.append(np.abs(caster.hits(view.centre(), rays)[1] - 1))
    assert np.median(np.linalg.norm(np.concatenate(shifts), axis=1)) < 1.5
    assert np.median(np.concatenate(errors)) < 0.03  # of the distance: views are 160 pixels wide


def test_images_show_the_scene(made):
    record = json.loads((made / "scene.json").read_text())
    assert record["family"] in FAMILIES and record["seed"] == SEED
    camera, views = true_views(made)
    caster = Caster(read_surface(made))
    at = Grid.of(camera).centers[::7]
    for view in views:
        picture = cv2.imread(str(made / "images" / view.name))
        assert picture.shape == (120, 160, 3)
        assert picture.std() > 8
        rays = view.rays(at)
        faces, distance = caster.hits(view.centre(), rays)
        assert (faces >= 0).mean() > 0.05
        assert (np.einsum("ij,ij->i", rays, caster.normals[faces])[faces >= 0] < 0).mean() > 0.999
        assert distance.min() > 0.05 * record["extent"]


def test_the_same_seed_gives_the_same_bytes(tmp_path, hash_folder):
    small = ("--size", "96x64", "--num_views", 3)
    run_script("make_scene.py", "smooth", 6, "--output_path", tmp_path / "a", *small)
    make_scene("smooth", 6, tmp_path / "b", size=(96, 64), num_views=3)
    assert hash_folder(tmp_path / "a") == hash_folder(tmp_path / "b")
    make_scene("smooth", 2, tmp_path / "c", size=(96, 64), num_views=3)
    assert hash_folder(tmp_path / "c") != hash_folder(tmp_path / "b")
    bad = run_script("make_scene.py", "cad", 0, "--output_path", tmp_path, "--size", "9", code=2)
    assert "9 is no size" in bad.stderr


def across(picture, pixels, reach, step):
    """Where light changes most, across segments (N, 2, 2), and by how much."""
    along = pixels[:, 1] - pixels[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    offsets = np.arange(-reach, reach + step / 2, step)
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    places = pixels.mean(axis=1)[:, None] + offsets[:, None] * normals[:, None] - 0.5
    values = ndimage.map_coordinates(picture, places[..., ::-1].transpose(2, 0, 1), order=3)
    change = np.abs(np.gradient(values, step, axis=1))
    return offsets[change[:, 2:-2].argmax(axis=1) + 2], change.max(axis=1)


def test_images_change_most_at_the_true_curves(tmp_path):
    random = np.random.default_rng([2, FAMILIES.index("cad")])
    settings, stage = draw_settings(random, 3), cad.make(random)
    camera = draw_camera(random, (480, 360), wide=False)
    surface = unite(stage.bodies)
    rig = Rig(camera, free_views(random, stage, settings, camera, Caster(surface)))
    curves = find_curves(surface, stage.bodies, rig, 0.01)
    lit = exposed(illuminate(stage, surface, camera), rig, 95)
    sensor = Sensor(gain=0.4, blur_px=0.5, noise=0, shot_noise=0, quality=0)
    found = []
    for v, view in enumerate(rig.views):
        light = see(lit, view, Grid.of(camera))
        write_image(tmp_path / "image.png", light, sensor, random)
        picture = (cv2.imread(str(tmp_path / "image.png")) / 255.0) ** GAMMA
        smooth = ndimage.gaussian_filter(picture.sum(axis=2), 0.8)
        points = curves.points[curves.edges[curves.visible[:, v]]]
        local = view.local(points)
        pixels = camera.img_from_cam(local.reshape(-1, 3)).reshape(-1, 2, 2)
        offset, change = across(smooth, pixels, 1.5, 0.05)
        found.append(offset[change > 0.1])
    found = np.concatenate(found)
    assert len(found) > 1000
    assert np.median(np.abs(found)) < 0.1
    assert abs(np.median(found)) < 0.03


def test_light_of_an_open_plane_and_of_one_in_the_shadow():
    floor, board = box((-2, 2), (-2, 2), (-0.2, 0)), box((-0.5, 0.5), (-0.5, 0.5), (0.5, 0.6))
    light = Light(position=np.array([0, 0, 40.0]), radius=0.5, strength=0.6, ambient=0.5, below=0.4)
    stage = Stage(
        bodies=[Body("floor", "m", floor), Body("board", "m", board)],
        materials={"m": Material(albedo=(0.5, 0.5, 0.5))},
        light=light, place=Place(middle=np.zeros(3), extent=2.0), background=plain((1, 1, 1)),
    )  # fmt: skip
    camera = pycolmap.Camera(model="PINHOLE", width=200, height=150, params=[200, 200, 100, 75])
    lit = illuminate(stage, unite(stage.bodies), camera)
    places, up = lit.caster.surface.vertices, lit.vectors[:, 2] > 0.9
    board = up & (places[:, 2] > 0.5)
    np.testing.assert_allclose(lit.vectors[board, 3], 1)
    expected = 0.5 * (0.4 + 0.6 * (1 + 2 / 3) / 2)  # the mean over the upper half space by cosine
    np.testing.assert_allclose(lit.vectors[board, 4], expected, rtol=0.02)
    below = up & (np.abs(places) < (0.3, 0.3, 0.1)).all(axis=1)
    assert below.any() and lit.vectors[below, 3].max() == 0
    assert lit.vectors[below, 4].max() < 0.55 * expected


def test_blotches_have_unit_deviation_and_fade_with_the_footprint():
    places = np.random.default_rng(1).uniform(0, 20, (20000, 3))
    field = blotches(places, 0.5, 3, np.zeros(len(places)))
    assert abs(field.mean()) < 0.05
    assert field.std() == pytest.approx(1, abs=0.1)
    assert blotches(places, 0.5, 3, np.full(len(places), 1.0)).std() < 0.05


def test_points_before_the_camera_are_in_the_image_whatever_its_distortion():
    shown = np.indices((71, 95)).reshape(2, -1).T[:, ::-1] + 0.5  # all but the margin
    inside = shown[(shown > 1).all(axis=1)]
    for seed in range(20):
        camera = draw_camera(np.random.default_rng(seed), (96, 72), wide=True)
        local = np.column_stack([camera.cam_from_img(inside), np.ones(len(inside))])
        assert in_image(camera, 3 * local).all()
        assert not in_image(camera, -3 * local).any()
        assert not in_image(camera, np.array([[40.0, 0, 1], [0, -40, 1]])).any()  # not folded back
