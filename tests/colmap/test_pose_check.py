"""Poses that contradict the points of their model, and frames that are older than the images."""

import shutil
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from colmap_edges.colmap.model import load_model, model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError

MOVE = pycolmap.Sim3d(2.5, pycolmap.Rotation3d(np.array([0, 0.6, 0, 0.8])), np.array([1.0, -3, 4]))
SHARED = Path(__file__).parents[3] / "shared"


@pytest.fixture
def reconstruction(small):
    return pycolmap.Reconstruction(str(small[1]))


def written(reconstruction, folder, kind="bin"):
    folder.mkdir()
    (reconstruction.write_binary if kind == "bin" else reconstruction.write_text)(str(folder))
    return folder


def stale(reconstruction, folder, kind):
    """A model changed by a program that does not know rigs and frames."""
    written(reconstruction, folder, kind)
    before = written(reconstruction, folder.parent / "before", kind)
    reconstruction.transform(MOVE)
    reconstruction.write_text(str(folder)) if kind == "txt" else reconstruction.write(str(folder))
    for name in ("rigs", "frames"):
        shutil.copy(before / f"{name}.{kind}", folder)
    return folder


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_frames_older_than_images_are_named(reconstruction, tmp_path, kind):
    folder = stale(reconstruction, tmp_path / "model", kind)
    message = rf"frames\.{kind} and images\.{kind} hold different poses of 6 images, and those of "
    with pytest.raises(
        ColmapEdgesError, match=message + rf"images.*delete frames\.{kind} and rigs"
    ):
        load_model(folder)
    for name in ("rigs", "frames"):
        (folder / f"{name}.{kind}").unlink()
    assert len(load_model(folder).views) == 6


def test_images_older_than_frames_do_not_matter(reconstruction, tmp_path):
    folder = written(reconstruction, tmp_path / "model")
    data = (folder / "images.bin").read_bytes()
    first = reconstruction.images[1].cam_from_world().translation
    moved = struct.pack("<3d", *(first + 1))
    assert data.count(first.tobytes()) == 1
    (folder / "images.bin").write_bytes(data.replace(first.tobytes(), moved))
    assert len(load_model(folder).views) == 6


def test_different_poses_without_points_cannot_be_decided(reconstruction, tmp_path):
    for point3D_id in list(reconstruction.points3D):
        reconstruction.delete_point3D(point3D_id)
    folder = stale(reconstruction, tmp_path / "model", "bin")
    with pytest.raises(ColmapEdgesError, match="there are no points3D to tell which"):
        load_model(folder)


def test_poses_of_another_model_are_refused(reconstruction):
    for frame in reconstruction.frames.values():
        turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0, 0, 0.6, 0.8])), np.ones(3))
        frame.rig_from_world = turn * frame.rig_from_world
    with pytest.raises(ColmapEdgesError, match="poses of 6 of 6 images do not fit the points3D"):
        model_from_reconstruction(reconstruction)


def test_one_edited_pose_is_left_out_and_named(reconstruction):
    frame = reconstruction.frames[reconstruction.images[1].frame_id]
    frame.rig_from_world = pycolmap.Rigid3d(frame.rig_from_world.rotation, np.zeros(3))
    model = model_from_reconstruction(reconstruction)
    assert model.contradicted_names == (reconstruction.images[1].name,)
    assert len(model.views) == 5
    assert reconstruction.images[1].name not in [view.name for view in model.views]
    assert model.track_views.max() == 4


@pytest.mark.parametrize("noise_px", [0.0, 3.0])
@pytest.mark.parametrize("stated", [-1.0, 0.0, 0.3])
def test_noise_is_no_contradiction(reconstruction, noise_px, stated):
    rng = np.random.default_rng(0)
    for image in reconstruction.images.values():
        for point in image.points2D:
            point.xy = point.xy + rng.normal(0, noise_px, 2)
    for point in reconstruction.points3D.values():
        point.error = stated
    assert len(model_from_reconstruction(reconstruction).views) == 6


def test_errors_that_the_model_states_are_no_contradiction(reconstruction):
    """Points off by 40 px, as the model says."""
    for image in reconstruction.images.values():
        for point in image.points2D:
            point.xy = point.xy + 40
    for point in reconstruction.points3D.values():
        point.error = 40.0
    assert len(model_from_reconstruction(reconstruction).views) == 6


@pytest.mark.parametrize("kind", ["bin", "txt"])
@pytest.mark.parametrize("gone", [True, False])
def test_frames_of_other_images_are_named(reconstruction, tmp_path, kind, gone):
    """Images deleted or added by a program that does not know frames."""
    folder = written(reconstruction, tmp_path / "model", kind)
    reconstruction.deregister_frame(reconstruction.images[3].frame_id)
    fewer = written(reconstruction, tmp_path / "fewer", kind)
    for name in ("images", "points3D") if gone else ("frames",):
        shutil.copy(fewer / f"{name}.{kind}", folder)
    fault = "lists image 3, which is not in" if gone else "does not list image 3, which is in"
    with pytest.raises(ColmapEdgesError, match=rf"frames\.{kind} {fault} images\.{kind}.*delete"):
        load_model(folder)


@pytest.mark.parametrize("name", ["rigs", "frames"])
def test_rigs_without_frames_are_named(reconstruction, tmp_path, name):
    folder = written(reconstruction, tmp_path / "model")
    (folder / f"{name}.bin").unlink()
    with pytest.raises(ColmapEdgesError, match=rf"needs {name}\.bin beside it"):
        load_model(folder)


def test_tracks_of_other_points_are_named(reconstruction, tmp_path):
    folder = written(reconstruction, tmp_path / "model")
    data = bytearray((folder / "points3D.bin").read_bytes())
    image_id, index = struct.unpack_from("<II", data, 8 + 51)
    struct.pack_into("<I", data, 8 + 51 + 4, index + 1 if index == 0 else 0)
    (folder / "points3D.bin").write_bytes(data)
    with pytest.raises(ColmapEdgesError, match=rf"of image {image_id}, which observes another"):
        load_model(folder)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are not there")
def test_real_models_are_read_without_a_complaint():
    folders = sorted(path.parent for path in (SHARED / "data").glob("**/images.bin"))
    assert folders
    for folder in folders:
        assert not load_model(folder).contradicted_names
