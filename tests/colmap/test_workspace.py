"""Which model of a workspace is used, and what is said about folders without one."""

import shutil

import pytest
from text_models import POSES, write

from colmap_edges.colmap.model import load_model
from colmap_edges.colmap.workspace import find_model, num_images, other_models
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.read import read_stage
from colmap_edges.report.diagnosis import diagnose
from colmap_edges.runtime.stages import Stages


def put(workspace, **counts):
    for name, count in counts.items():
        folder = workspace / "sparse" / name.removeprefix("m")
        folder.mkdir(parents=True, exist_ok=True)
        write(folder, POSES[:count])


def test_the_model_of_most_images_is_used(tmp_path):
    put(tmp_path, m0=2, m1=3, m10=1)
    assert find_model(tmp_path) == tmp_path / "sparse" / "1"
    assert other_models(tmp_path / "sparse" / "1") == {"0": 2, "10": 1}
    put(tmp_path, m0=3)
    assert find_model(tmp_path) == tmp_path / "sparse" / "0"


def test_binary_models_are_counted(small, tmp_path):
    shutil.copytree(small[1], tmp_path / "sparse" / "1")
    put(tmp_path, m0=3)
    assert num_images(tmp_path / "sparse" / "1") == 6
    (tmp_path / "sparse" / "1" / "images.bin").write_bytes(b"x")
    assert num_images(tmp_path / "sparse" / "1") == 0


def notes(stages):
    return [finding.text for finding in diagnose(stages.records(), PipelineOptions())]


@pytest.mark.parametrize("number", ["0", "1", "2"])
def test_other_models_are_said_with_their_sizes(tmp_path, number):
    put(tmp_path, m0=2, m1=3, m2=2)
    stages = Stages()
    read_stage(tmp_path / "sparse" / number, stages)
    assert any(f"the model sparse/{number} is used, with" in text for text in notes(stages))


def test_smaller_models_behind_it_are_not_said(tmp_path):
    put(tmp_path, m0=3, m1=2)
    stages = Stages()
    read_stage(tmp_path / "sparse" / "0", stages)
    assert not any("beside it" in text for text in notes(stages))


def test_a_folder_too_high_is_told_where_models_are(tmp_path):
    put(tmp_path, m0=3, m1=2)
    for folder in (tmp_path, tmp_path / "sparse"):
        with pytest.raises(ColmapEdgesError, match=r"there is one in .*sparse/0 and .*sparse/1"):
            load_model(folder)
    with pytest.raises(ColmapEdgesError, match="is a folder of models; give the folder above it"):
        find_model(tmp_path / "sparse")


def test_a_missing_file_is_named(tmp_path):
    put(tmp_path, m0=3)
    (tmp_path / "sparse" / "0" / "points3D.txt").unlink()
    with pytest.raises(ColmapEdgesError, match=r"\(no points3D\.txt\); give the folder"):
        load_model(tmp_path / "sparse" / "0")


def test_few_poses_of_many_images_are_not_too_few_images(tmp_path):
    put(tmp_path, m0=1)
    for name in "abcde":
        (tmp_path / f"{name}.png").touch()
    with pytest.raises(ColmapEdgesError, match=r"has 1 images with poses, of 5; .*its log"):
        read_stage(tmp_path / "sparse" / "0", Stages(), tmp_path)
