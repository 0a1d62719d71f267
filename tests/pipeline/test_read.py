"""Copies of images in a model are no further witnesses, by whatever name they come."""

import shutil

import numpy as np
import pycolmap
import pytest

from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.edges3d import AdjustedPoses
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.read import read_stage
from colmap_edges.pipeline.reconstruct import reconstruct
from colmap_edges.report.diagnosis import diagnose
from colmap_edges.runtime.stages import Stages


def with_copy(small, folder, name, motion=None, content=None):
    """The small scene with image 1 once more, under another name and with no points2D."""
    shutil.copytree(small[0], folder, dirs_exist_ok=True)
    reconstruction = pycolmap.Reconstruction(str(small[1]))
    first = reconstruction.images[1]
    pose = first.cam_from_world()
    copy = pycolmap.Image(name=name, camera_id=first.camera_id, image_id=100)
    reconstruction.add_image_with_trivial_frame(copy, pose * motion if motion else pose)
    source = folder / (content or first.name)
    if (folder / name).resolve() != source.resolve():
        shutil.copy(source, folder / name)
    return reconstruction, first.name


def shift(distance):
    return pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([distance, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("name", "motion", "content"),
    [
        ("a_copy.png", None, None),
        ("a_copy.png", shift(1e-12), "view_002.png"),  # the same pose is enough
        ("a_copy.png", shift(1e-3), None),  # the same file, mapped twice
        ("./view_001.png", None, None),  # one file by two names
    ],
)
def test_copies_are_left_out_and_named(small, tmp_path, name, motion, content):
    reconstruction, first = with_copy(small, tmp_path, name, motion, content)
    stages = Stages()
    model = read_stage(reconstruction, stages, tmp_path)
    assert model.copies == ((name, first),)
    assert len(model.views) == 6
    assert len(model.track_views) == len(read_stage(small[1], Stages()).track_views)
    texts = [finding.text for finding in diagnose(stages.records(), PipelineOptions())]
    assert any(f"{name} is one of {first}" in text for text in texts)


@pytest.mark.parametrize(
    ("name", "motion", "content"),
    [("other.png", shift(1e-3), "view_002.png"), ("other.png", shift(0.5), None)],
)
def test_other_images_stay(small, tmp_path, name, motion, content):
    reconstruction, _ = with_copy(small, tmp_path, name, motion, content)
    assert len(read_stage(reconstruction, Stages(), tmp_path).views) == 7


def test_one_file_at_two_poses_is_an_error(small, tmp_path):
    reconstruction, _ = with_copy(small, tmp_path, "./view_001.png", shift(0.5))
    with pytest.raises(ColmapEdgesError, match="are one file at two poses"):
        read_stage(reconstruction, Stages(), tmp_path)


def test_copies_move_with_their_originals(small, tmp_path):
    reconstruction, first = with_copy(small, tmp_path, "a_copy.png")
    model = read_stage(reconstruction, Stages(), tmp_path)
    motions = np.tile(np.eye(3, 4), (6, 1, 1))
    motions[:, 0, 3] = np.arange(1, 7)
    poses = AdjustedPoses(motions=motions, points3D_xyz=model.points3D_xyz)
    moved = moved_model(model, poses).reconstruction
    found = {image.name: image.cam_from_world().matrix() for image in moved.images.values()}
    np.testing.assert_array_equal(found["a_copy.png"], found[first])
    assert (found[first] != reconstruction.images[1].cam_from_world().matrix()).any()


def test_a_copy_changes_nothing(small, tmp_path):
    reconstruction, _ = with_copy(small, tmp_path, "a_copy.png")
    options = PipelineOptions(num_threads=2, use_faces=False, use_patches=False)
    found = reconstruct(reconstruction, tmp_path, options).edges
    expected = reconstruct(small[1], small[0], options).edges
    np.testing.assert_array_equal(found.points, expected.points)
