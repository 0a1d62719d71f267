import shutil
import struct
import subprocess
from pathlib import Path

import curves
import numpy as np
import pycolmap
import pytest
import scenes

from colmap_edges.colmap.model import (
    camera_parameter_counts,
    load_model,
    model_from_reconstruction,
    observation_residuals,
    points_of,
)
from colmap_edges.colmap.writing import extend_reconstruction, write_model
from colmap_edges.core.view import rows_by_view
from colmap_edges.errors import ColmapEdgesError

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

needs_colmap = pytest.mark.skipif(
    shutil.which("colmap") is None, reason="COLMAP's executable is not installed"
)


def extended_by_pycolmap(model, edges):
    """What `write_model` writes, by pycolmap's own one-point-at-a-time API."""
    reconstruction = pycolmap.Reconstruction(model.reconstruction)
    errors = observation_residuals(model, edges)
    for i in range(edges.num_points):
        rows = slice(edges.observations.offsets[i], edges.observations.offsets[i + 1])
        track = pycolmap.Track()
        for v, xy in zip(
            edges.observations.views[rows], edges.observations.pixels[rows], strict=True
        ):
            image = reconstruction.images[model.views[v].image_id]
            track.add_element(image.image_id, len(image.points2D))
            image.points2D.append(pycolmap.Point2D(xy))
        point3D_id = reconstruction.add_point3D(edges.points[i], track, edges.colors[i])
        reconstruction.points3D[point3D_id].error = errors[rows].mean()
    return reconstruction


def snapshot(reconstruction):
    """Everything of a reconstruction as comparable values."""
    points = {
        i: (
            tuple(p.xyz),
            tuple(p.color),
            p.error,
            [(e.image_id, e.point2D_idx) for e in p.track.elements],
        )
        for i, p in reconstruction.points3D.items()
    }
    images = {
        i: (
            image.name,
            image.cam_from_world().matrix().tolist(),
            [(tuple(p.xy), p.point3D_id) for p in image.points2D],
        )
        for i, image in reconstruction.images.items()
    }
    cameras = {i: (c.model.name, tuple(c.params)) for i, c in reconstruction.cameras.items()}
    return cameras, images, points


@pytest.mark.parametrize("kind", ["BIN", "TXT", "memory"])
def test_points_and_tracks_equal_pycolmaps(scene, tmp_path, kind):
    given = pycolmap.Reconstruction(scene.reconstruction)
    given.points3D[max(given.points3D)].color = (1, 2, 3)
    for image_id in list(given.images)[:2]:
        given.deregister_frame(given.images[image_id].frame_id)
    for image in given.images.values():  # features that observe no point
        image.points2D.append(pycolmap.Point2D(np.array([1.5, 2.5])))
    if kind == "memory":
        model = model_from_reconstruction(given)
    else:
        (given.write_binary if kind == "BIN" else given.write_text)(str(tmp_path))
        model = load_model(tmp_path)
    assert len(model.views) == len(scene.reconstruction.images) - 2
    assert model.point3D_ids.tolist() == sorted(given.points3D)
    for row, point3D_id in enumerate(model.point3D_ids):
        point = given.points3D[point3D_id]
        np.testing.assert_allclose(model.points3D_xyz[row], point.xyz, rtol=1e-15)
        assert model.points3D_rgb[row].tolist() == point.color.tolist()
        rows = slice(*model.track_offsets[row : row + 2])
        images = [model.views[view].image_id for view in model.track_views[rows]]
        seen = {e.image_id: e.point2D_idx for e in point.track.elements}
        assert sorted(images) == sorted(seen)
        for image_id, pixel in zip(images, model.track_points2D[rows], strict=True):
            xy = given.images[image_id].points2D[seen[image_id]].xy
            np.testing.assert_allclose(pixel, xy, rtol=1e-15)


@pytest.mark.parametrize("output_type", ["BIN", "TXT"])
def test_write_equals_pycolmaps_own_api(scene_model, scene_edges, tmp_path, output_type):
    ids = write_model(scene_model, scene_edges, tmp_path / "ours", output_type)
    reference = extended_by_pycolmap(scene_model, scene_edges)
    ours = pycolmap.Reconstruction(str(tmp_path / "ours"))
    assert ours.is_valid()
    for found, expected in zip(snapshot(ours), snapshot(reference), strict=True):
        assert found.keys() == expected.keys()
    cameras, images, points = snapshot(ours)
    expected_cameras, expected_images, expected_points = snapshot(reference)
    assert cameras == expected_cameras
    for i, (name, pose, points2D) in expected_images.items():
        assert images[i][0] == name
        np.testing.assert_allclose(images[i][1], pose, rtol=0, atol=1e-12)
        assert [p[1] for p in images[i][2]] == [p[1] for p in points2D]
        np.testing.assert_allclose(
            [p[0] for p in images[i][2]], [p[0] for p in points2D], rtol=1e-15, atol=0
        )
    for i, (xyz, color, error, track) in expected_points.items():
        np.testing.assert_allclose(points[i][0], xyz, rtol=1e-14, atol=1e-15)
        np.testing.assert_allclose(points[i][2], error, rtol=1e-9)
        assert points[i][1] == color
        assert points[i][3] == track
    assert {tuple(ours.points3D[i].xyz) for i in ids} == set(map(tuple, scene_edges.points))


def test_errors_are_colmaps_own(scene_model, scene_edges, tmp_path):
    ids = write_model(scene_model, scene_edges, tmp_path / "out")
    ours = pycolmap.Reconstruction(str(tmp_path / "out"))
    written = [ours.points3D[i].error for i in ids]
    ours.update_point_3d_errors()
    np.testing.assert_allclose(written, [ours.points3D[i].error for i in ids], atol=1e-9)


def test_input_points_poses_and_intrinsics_stay(scene_model, scene_edges, tmp_path):
    write_model(scene_model, scene_edges, tmp_path / "out")
    ours = load_model(tmp_path / "out")
    count = len(scene_model.point3D_ids)
    np.testing.assert_array_equal(ours.point3D_ids[:count], scene_model.point3D_ids)
    np.testing.assert_allclose(
        ours.points3D_xyz[:count], scene_model.points3D_xyz, rtol=0, atol=1e-12
    )
    for mine, theirs in zip(ours.views, scene_model.views, strict=True):
        np.testing.assert_allclose(mine.rotation, theirs.rotation, rtol=0, atol=1e-12)
        np.testing.assert_allclose(mine.translation, theirs.translation, rtol=0, atol=1e-12)
        np.testing.assert_allclose(mine.camera.params, theirs.camera.params, rtol=0, atol=1e-12)
    old = {i: [tuple(p.xy) for p in im.points2D] for i, im in iter_images(scene_model)}
    new = {i: [tuple(p.xy) for p in im.points2D] for i, im in iter_images(ours)}
    assert all(new[i][: len(old[i])] == old[i] for i in old)


def iter_images(model):
    return model.reconstruction.images.items()


def test_full_disk_while_points_are_read_is_one_clear_error(scene):
    class OnFullDisk:
        """Writes what fits, and says nothing, as pycolmap does."""

        def write_binary(self, folder):
            scene.reconstruction.write_binary(folder)
            path = Path(folder) / "points3D.bin"
            path.write_bytes(path.read_bytes()[:1000])

    with pytest.raises(ColmapEdgesError, match=r"the disk is full .* TMPDIR"):
        points_of(OnFullDisk())


def test_extending_leaves_the_reconstruction_alone(scene_model, scene_edges):
    before = snapshot(scene_model.reconstruction)
    extended, ids = extend_reconstruction(scene_model, scene_edges)
    assert snapshot(scene_model.reconstruction) == before
    assert len(extended.points3D) == len(before[2]) + len(ids)


def test_write_into_a_model_without_points(scene, tmp_path):
    bare = pycolmap.Reconstruction(scene.reconstruction)
    for point3D_id in list(bare.point3D_ids()):
        bare.delete_point3D(point3D_id)
    (tmp_path / "bare").mkdir()
    bare.write(str(tmp_path / "bare"))
    model = load_model(tmp_path / "bare")
    edges = scenes.true_edges(model, scene, spacing=0.2)
    ids = write_model(model, edges, tmp_path / "out")
    assert sorted(pycolmap.Reconstruction(str(tmp_path / "out")).point3D_ids()) == ids.tolist()


@pytest.mark.parametrize("name", ["SIMPLE_RADIAL", "OPENCV", "OPENCV_FISHEYE"])
def test_residuals_are_zero_at_true_observations(name, tmp_path):
    scene = scenes.make_scene(num_views=3, camera_model=name)
    model = scenes.load_scene_model(scene, tmp_path)
    edges = scenes.true_edges(model, scene, spacing=0.3)
    assert np.nanmax(observation_residuals(model, edges)) < 1e-6


def test_parameter_counts_know_every_camera_model():
    counts = camera_parameter_counts()
    assert counts[int(pycolmap.CameraModelId.PINHOLE)] == 4
    assert counts[int(pycolmap.CameraModelId.FULL_OPENCV)] == 12


@pytest.mark.parametrize("name", ["cameras", "images", "points3D", "rigs", "frames"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.999])
def test_truncated_file_is_one_clear_error(scene_paths, tmp_path, name, share):
    folder = tmp_path / "sparse"
    shutil.copytree(scene_paths[1], folder)
    path = folder / f"{name}.bin"
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(ColmapEdgesError, match=rf"{name}\.bin is damaged") as caught:
        load_model(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D", "rigs", "frames"])
def test_trailing_bytes_and_absurd_counts(scene_paths, tmp_path, name):
    data = (scene_paths[1] / f"{name}.bin").read_bytes()
    for damaged in (data + b"\0", struct.pack("<Q", 2**63) + data[8:]):
        folder = tmp_path / str(len(damaged))
        shutil.copytree(scene_paths[1], folder)
        (folder / f"{name}.bin").write_bytes(damaged)
        with pytest.raises(ColmapEdgesError, match="damaged"):
            load_model(folder)


def test_track_into_nowhere(scene_paths, tmp_path):
    folder = tmp_path / "sparse"
    shutil.copytree(scene_paths[1], folder)
    path = folder / "points3D.bin"
    data = bytearray(path.read_bytes())
    data[8 + 51 + 4 : 8 + 51 + 8] = struct.pack("<I", 10**6)
    path.write_bytes(data)
    with pytest.raises(ColmapEdgesError, match="point2D that its image does not have"):
        load_model(folder)


@pytest.mark.parametrize("frames", [True, False])
def test_rotation_of_zeros(scene_paths, tmp_path, frames):
    """COLMAP takes it for no rotation, which would be wrong without a word."""
    folder = tmp_path / "sparse"
    shutil.copytree(scene_paths[1], folder)
    path, at = folder / ("frames.bin" if frames else "images.bin"), 16 if frames else 12
    data = bytearray(path.read_bytes())
    data[at : at + 32] = bytes(32)
    path.write_bytes(data)
    if not frames:  # as before rigs came
        (folder / "frames.bin").unlink()
        (folder / "rigs.bin").unlink()
    with pytest.raises(ColmapEdgesError, match="a rotation of zeros"):
        load_model(folder)


def test_name_that_is_not_utf8(scene_paths, tmp_path):
    folder = tmp_path / "sparse"
    shutil.copytree(scene_paths[1], folder)
    data = (folder / "images.bin").read_bytes()
    (folder / "images.bin").write_bytes(data.replace(b"view_002", b"view\xff002"))
    with pytest.raises(ColmapEdgesError, match="is not UTF-8") as caught:
        load_model(folder)
    assert "view\\xff002" in str(caught.value)


def test_images_and_points_of_different_models(scene_paths, tmp_path):
    folder = tmp_path / "sparse"
    shutil.copytree(scene_paths[1], folder)
    (folder / "points3D.bin").write_bytes(bytes(8))
    with pytest.raises(ColmapEdgesError, match="do not belong together"):
        load_model(folder)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ("focal", "camera of image view_001.png has the parameters 0"),
        ("one focal", "camera of image view_001.png has the parameters"),
        ("negative focal", "camera of image view_001.png has the parameters -"),
        ("params", "camera of image view_001.png has the parameters nan"),
        ("pose", "pose of image view_001.png is not finite"),
        ("point", "point3D 1 of the model is not finite"),
        ("pixel", "point2D of the model that observes a point3D is not finite"),
        ("name", "two images of the model are named same.png"),
    ],
)
def test_invalid_values_are_errors(scene, part, message):
    reconstruction = pycolmap.Reconstruction(scene.reconstruction)
    image = reconstruction.images[1]
    if part in ("focal", "one focal", "negative focal", "params"):
        params = np.array(image.camera.params)
        if part == "one focal":
            params[1] = 0
        elif part == "negative focal":
            params[:2] *= -1
        else:
            params[:2] = 0 if part == "focal" else np.nan
        reconstruction.cameras[1].params = params
    elif part == "pose":
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([0, np.nan, 0]))
        reconstruction.frames[image.frame_id].rig_from_world = pose
    elif part == "point":
        reconstruction.points3D[1].xyz = np.array([np.inf, 0, 0])
    elif part == "pixel":
        next(p for p in image.points2D if p.has_point3D()).xy = np.array([np.nan, 0])
    else:
        for image_id in (1, 2):
            reconstruction.images[image_id].name = "same.png"
    with pytest.raises(ColmapEdgesError, match=message):
        model_from_reconstruction(reconstruction)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D", "rigs", "frames"])
def test_damaged_text_is_one_clear_error(scene, tmp_path, name):
    scene.reconstruction.write_text(str(tmp_path))
    path = tmp_path / f"{name}.txt"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    with pytest.raises(ColmapEdgesError) as caught:
        load_model(tmp_path)
    assert "\n" not in str(caught.value)


def test_folder_without_model(tmp_path):
    with pytest.raises(ColmapEdgesError, match="no readable COLMAP model"):
        load_model(tmp_path)


@needs_colmap
def test_debians_colmap_reads_the_model(scene_model, scene_edges, tmp_path):
    write_model(scene_model, scene_edges, tmp_path / "out")
    command = ["colmap", "model_analyzer", "--path", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    expected = len(scene_model.point3D_ids) + scene_edges.num_points
    assert f"Points: {expected}" in done.stdout + done.stderr


@needs_colmap
def test_debians_colmap_adjusts_the_model(scene_model, scene_edges, tmp_path):
    write_model(scene_model, scene_edges, tmp_path / "out")
    (tmp_path / "adjusted").mkdir()
    command = ["colmap", "bundle_adjuster", "--input_path", str(tmp_path / "out")]
    command += ["--output_path", str(tmp_path / "adjusted")]
    subprocess.run(command, capture_output=True, text=True, check=True)
    adjusted = pycolmap.Reconstruction(str(tmp_path / "adjusted"))
    assert len(adjusted.points3D) == len(scene_model.point3D_ids) + scene_edges.num_points
    assert adjusted.compute_mean_reprojection_error() < 1.0


def test_rows_by_view_are_those_of_each_view():
    views = np.random.default_rng(0).integers(0, 7, 50).astype(np.int32)
    views[views == 3] = 4
    found = rows_by_view(views, 9)
    assert len(found) == 9
    for view, rows in enumerate(found):
        assert rows.tolist() == np.flatnonzero(views == view).tolist()
    assert [len(rows) for rows in rows_by_view(np.zeros(0, np.int32), 2)] == [0, 0]


def test_view_holds_points_in_front_and_inside():
    view = curves.make_view(np.eye(3), np.zeros(3))
    pixels = np.array([[0, 0], [639, 479], [640, 0], [0, 480], [-1e-9, 5], [5, 5], [np.nan, 5]])
    depths = np.array([1, 1, 1, 1, 1, -1, 1.0])
    assert view.holds(pixels, depths).tolist() == [True, True] + 5 * [False]
    points = np.array([[0, 0, 2.0], [0, 0, -2], [2, 0, 2]])
    assert view.holds(*view.project(points)).tolist() == [True, False, False]
