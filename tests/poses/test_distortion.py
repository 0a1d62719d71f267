from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scenes import add_point, look_at

from colmap_edges.colmap.lenses import adjusted, has_one_coefficient
from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.evaluation.metrics.poses import TrueCameras, pose_errors
from colmap_edges.options import BundleAdjustmentOptions, PipelineOptions
from colmap_edges.pipeline.found import lens_stage
from colmap_edges.pipeline.read import median_residual
from colmap_edges.poses import distortion
from colmap_edges.poses.distortion import refine_distortion
from colmap_edges.runtime.stages import Stages

OPTIONS = BundleAdjustmentOptions()
COEFFICIENTS = (-0.06, 0.045)  # of a video camera


def observe(made, num_points, noise_px=0.3):
    """Add points of a facade and a street to a reconstruction with images, seen with noise."""
    rng = np.random.default_rng(0)
    for xyz in rng.uniform([-8, -0.5, -1.5], [8, 0.5, 3.5], (num_points, 3)):
        seen = [(i, image.project_point(xyz)) for i, image in made.images.items()]
        seen = [
            (i, at + rng.normal(0, noise_px, 2))
            for i, at in seen
            if at is not None and (at > 0).all() and (at < [1920, 1080]).all()
        ]
        if len(seen) >= 2:
            add_point(made, xyz, seen)


def street(coefficients, num_cameras=1):
    """A facade seen from a path along it by one or more cameras, in turn."""
    made = pycolmap.Reconstruction()
    model = "RADIAL" if len(coefficients) > 1 else "SIMPLE_RADIAL"
    for camera_id in range(1, num_cameras + 1):
        made.add_camera_with_trivial_rig(
            pycolmap.Camera(
                camera_id=camera_id,
                model=model,
                width=1920,
                height=1080,
                params=[1160, 960, 540, *coefficients],
            )
        )
    for number in range(12):
        center = np.array([0.8 * number - 4.4, -4 + 0.3 * (number % 3), 1 + 0.2 * (number % 2)])
        ahead = np.array([0.3 * (number % 4) - 0.45, 1, 0])
        pose = look_at(center, center + ahead, 0.02 * number)
        image = pycolmap.Image(f"{number:02d}.jpg", [], number % num_cameras + 1, number + 1)
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.column_stack(pose)))
    observe(made, 900)
    return made


def mapped(truth):
    """The reconstruction as it is with COLMAP's default camera model."""
    found = pycolmap.Reconstruction(truth)
    for camera in found.cameras.values():
        camera.model, camera.params = pycolmap.CameraModelId.SIMPLE_RADIAL, camera.params[:4]
    pycolmap.bundle_adjustment(found, pycolmap.BundleAdjustmentOptions(print_summary=False))
    return found


@pytest.fixture(scope="module")
def truth():
    return street(COEFFICIENTS)


@pytest.fixture(scope="module")
def model(truth):
    return model_from_reconstruction(mapped(truth))


def true_cameras(reconstruction):
    poses = {i.name: i.cam_from_world().matrix() for i in reconstruction.images.values()}
    return TrueCameras(cam_from_world=poses, camera=reconstruction.cameras[1])


def test_a_missing_coefficient_is_found(truth, model):
    cameras = true_cameras(truth)
    before = [view.camera.params.tolist() for view in model.views]
    refined, stats = refine_distortion(model, OPTIONS)
    assert stats["refined"]
    assert stats["held_out_gain"] == pytest.approx(0.6, abs=0.2)
    for view in refined.views:
        assert view.camera.model.name == "RADIAL"
        np.testing.assert_allclose(view.camera.params, [1160, 960, 540, *COEFFICIENTS], atol=0.3)
        np.testing.assert_allclose(view.camera.params[3:], COEFFICIENTS, atol=1e-3)
    assert median_residual(model) > 0.7
    assert median_residual(refined) < 0.3
    turns, shifts = np.divide(
        pose_errors(refined.reconstruction, cameras), pose_errors(model.reconstruction, cameras)
    )
    assert turns < 0.2
    assert shifts < 0.2
    # The given model is as it was.
    assert [view.camera.params.tolist() for view in model.views] == before
    assert all(map(has_one_coefficient, model.views))
    assert model.reconstruction.cameras[1].model.name == "SIMPLE_RADIAL"


def test_the_model_stays_in_its_place(model):
    refined, _ = refine_distortion(model, OPTIONS)
    moved = refined.points3D_xyz - model.points3D_xyz
    near = np.linalg.norm(moved, axis=1) < 0.1
    assert near.mean() > 0.95
    assert np.linalg.norm(np.median(moved, axis=0)) < 3e-3  # 1 pixel is 4e-3
    # The reconstruction that is written says the same.
    written = model_from_reconstruction(refined.reconstruction)
    np.testing.assert_allclose(written.points3D_xyz, refined.points3D_xyz)
    np.testing.assert_allclose(written.camera_centers, refined.camera_centers)
    np.testing.assert_array_equal(written.views[0].camera.params, refined.views[0].camera.params)


def test_units_and_origin_do_not_matter(model):
    change = pycolmap.Sim3d(1e3, pycolmap.Rotation3d(np.array([0.2, 0.5, 1.0])), [4e6, -2e5, 5e6])
    elsewhere = pycolmap.Reconstruction(model.reconstruction)
    elsewhere.transform(change)
    here, _ = refine_distortion(model, OPTIONS)
    there, _ = refine_distortion(model_from_reconstruction(elsewhere), OPTIONS)
    expected = np.array([change * center for center in here.camera_centers])
    np.testing.assert_allclose(there.camera_centers, expected, atol=1)  # a thousandth of the unit
    np.testing.assert_allclose(
        there.views[0].camera.params[3:], here.views[0].camera.params[3:], atol=1e-4
    )


@pytest.mark.parametrize("made", [street, lambda of: mapped(street(of))])
def test_a_lens_with_one_coefficient_stays(made):
    model = model_from_reconstruction(made(COEFFICIENTS[:1]))
    found, stats = refine_distortion(model, OPTIONS)
    assert found is model
    assert not stats["refined"]
    assert abs(stats["held_out_gain"]) < 0.01


@pytest.mark.parametrize("num_views", [6, 8])
def test_part_of_the_views_tells_of_the_lens(model, num_views, monkeypatch):
    monkeypatch.setattr(distortion, "MAX_VIEWS", num_views)
    part = distortion.best_connected(model)
    assert len(part.views) == num_views
    assert distortion.held_out_gain(model, OPTIONS) == pytest.approx(0.75, abs=0.15)
    # Points move, though views that were left out observe them, too.
    found = adjusted(part, second=True)
    assert (found.points3D_xyz != part.points3D_xyz).any(axis=1).all()
    np.testing.assert_allclose(found.views[0].camera.params[3:], COEFFICIENTS, atol=2e-3)


def test_each_camera_has_its_lens():
    model = model_from_reconstruction(mapped(street(COEFFICIENTS, num_cameras=3)))
    refined, _ = refine_distortion(model, OPTIONS)
    params = np.array([refined.reconstruction.cameras[number].params for number in (1, 2, 3)])
    np.testing.assert_allclose(params[:, 3:], np.tile(COEFFICIENTS, (3, 1)), atol=2e-3)
    assert len(np.unique(params[:, 0])) == 3


def test_other_camera_models_stay(truth):
    mixed = pycolmap.Reconstruction(truth)
    model = model_from_reconstruction(mixed)  # RADIAL
    stages = Stages()
    assert lens_stage(model, PipelineOptions(), stages) is model
    assert not stages.records()


def test_few_or_no_points_tell_nothing(model):
    for count in (0, 20):
        few = model.selected(np.arange(len(model.point3D_ids)) < count)
        assert refine_distortion(few, OPTIONS)[0] is few


def test_outliers_do_no_harm(model):
    rng = np.random.default_rng(1)
    bad = rng.random(len(model.track_views)) < 0.1
    pixels = model.track_points2D + bad[:, None] * rng.uniform(-50, 50, model.track_points2D.shape)
    spoiled = pycolmap.Reconstruction(model.reconstruction)
    for row, (point, view) in enumerate(zip(model.track_points, model.track_views, strict=True)):
        image = spoiled.images[model.views[view].image_id]
        track = spoiled.points3D[model.point3D_ids[point]].track
        index = next(e.point2D_idx for e in track.elements if e.image_id == image.image_id)
        image.points2D[index].xy = pixels[row]
    refined, stats = refine_distortion(model_from_reconstruction(spoiled), OPTIONS)
    assert stats["refined"]
    np.testing.assert_allclose(refined.views[0].camera.params[3:], COEFFICIENTS, atol=2e-3)


def test_a_lens_that_folds_within_the_image_is_not_taken(model, monkeypatch):
    def folding(few, *, second):
        found = adjusted(few, second=second)
        if second:
            for view in found.views:
                view.camera.params = [*view.camera.params[:3], -0.06, -0.6]
        return found

    monkeypatch.setattr(distortion, "held_out_gain", lambda *_: 1.0)
    monkeypatch.setattr(distortion, "adjusted", folding)
    found, stats = refine_distortion(model, OPTIONS)
    assert found is model
    assert not stats["refined"]


def test_copies_of_images_have_the_lens_of_their_originals(model):
    copied = pycolmap.Reconstruction(model.reconstruction)
    lens = copied.cameras[1]
    copied.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=2, model=lens.model, width=1920, height=1080, params=lens.params)
    )
    pose = copied.images[1].cam_from_world()
    copied.add_image_with_trivial_frame(pycolmap.Image("copy.jpg", [], 2, 99), pose)
    whole = model_from_reconstruction(copied)
    index = next(i for i, view in enumerate(whole.views) if view.name == "copy.jpg")
    alone = replace(whole.without_views(np.array([index])), copies=(("copy.jpg", "00.jpg"),))
    refined, _ = refine_distortion(alone, OPTIONS)
    camera = refined.reconstruction.cameras[2]
    assert camera.model.name == "RADIAL"
    np.testing.assert_array_equal(camera.params, refined.reconstruction.cameras[1].params)
    images = {image.name: image for image in refined.reconstruction.images.values()}
    np.testing.assert_allclose(
        images["copy.jpg"].cam_from_world().matrix(), images["00.jpg"].cam_from_world().matrix()
    )


def test_a_rig_keeps_its_size():
    reconstruction = street(COEFFICIENTS, num_cameras=1)
    made = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    lens = reconstruction.cameras[1]
    for camera_id in (1, 2):
        made.add_camera(
            pycolmap.Camera(
                camera_id=camera_id, model="RADIAL", width=1920, height=1080, params=lens.params
            )
        )
    beside = pycolmap.Rigid3d(np.column_stack([np.eye(3), [0.3, 0.0, 0.0]]))
    rig.add_ref_sensor(made.cameras[1].sensor_id)
    rig.add_sensor(made.cameras[2].sensor_id, beside)
    made.add_rig(rig)
    for number, image in sorted(reconstruction.images.items()):
        frame = pycolmap.Frame(frame_id=number, rig_id=1)
        frame.rig_from_world = image.cam_from_world()
        names = {1: f"{number:02d}_left.jpg", 2: f"{number:02d}_right.jpg"}
        pair = [pycolmap.Image(names[c], [], c, 2 * number + c) for c in (1, 2)]
        for one in pair:
            frame.add_data_id(one.data_id)
        made.add_frame(frame)
        for one in pair:
            one.frame_id = number
            made.add_image(one)
        made.register_frame(number)
    observe(made, 500)
    model = model_from_reconstruction(mapped(made))
    refined, stats = refine_distortion(model, OPTIONS)
    assert stats["refined"]
    assert median_residual(refined) < 0.33 < 0.6 < median_residual(model)

    def sizes(of):
        by_name = {view.name: view.center for view in of.views}
        return [
            np.linalg.norm(by_name[n] - by_name[n.replace("left", "right")])
            for n in by_name
            if "left" in n
        ]

    np.testing.assert_allclose(sizes(refined), sizes(model), rtol=1e-6)
