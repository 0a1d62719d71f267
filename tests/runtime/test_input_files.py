"""Folders, pipes and devices in the place of input files are refused without delay."""

import os
import shutil
import socket
from dataclasses import replace
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
from mask_files import paths_of, write_masks

from colmap_edges.cli import info
from colmap_edges.cli import main as cli
from colmap_edges.cli.flags import load_toml
from colmap_edges.colmap.model import load_model
from colmap_edges.errors import ColmapEdgesError, NotAFileError
from colmap_edges.evaluation.layouts import dtu, strecha
from colmap_edges.evaluation.metrics import poses, raycasting
from colmap_edges.evaluation.readers import arrays
from colmap_edges.evaluation.readers.curves import load_curves, read_curves
from colmap_edges.export import ply
from colmap_edges.images.files import read_picture
from colmap_edges.images.masks import check_masks, read_mask
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.run import run
from colmap_edges.runtime.cache import Cache
from colmap_edges.runtime.input_files import open_file, read_bytes, read_text

pytestmark = pytest.mark.timeout(60)  # what hangs, hangs for good


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        before = Path.cwd()
        os.chdir(path.parent)  # names of sockets are short
        try:
            made.bind(path.name)
        finally:
            os.chdir(before)


KINDS = {
    "pipe": os.mkfifo,
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "terminal": lambda path: path.symlink_to("/dev/ptmx"),
    "folder": Path.mkdir,
    "socket": make_socket,
    "link to nowhere": lambda path: path.symlink_to("nowhere"),
    "loop of links": lambda path: path.symlink_to(path.name),
    "unreadable": lambda path: path.write_bytes(b"secret"),
}


@pytest.fixture(params=KINDS)
def no_file(request, public):
    """What makes a path one of the kinds of things that cannot be read."""

    def put(path: Path) -> Path:
        if path.is_file():
            path.unlink()
        KINDS[request.param](path)
        if request.param == "unreadable":
            path.chmod(0)
            path.parent.chmod(0o755)
            other = request.getfixturevalue("other_user")()
            request.addfinalizer(lambda: other.__exit__(None, None, None))
            other.__enter__()
        return path

    return put


def read_config(path):
    """A command line with a configuration file."""
    paths = [word for name in ("image", "input", "output") for word in (f"--{name}_path", "a")]
    cli.cli.commands["mesh"].make_context("mesh", [*paths, "--config", str(path)])


READERS = {
    "bytes": ("file", read_bytes),
    "text": ("file", read_text),
    "picture": ("a.png", read_picture),
    "mask": ("a.png", lambda path: read_mask(path.parent, path.name)),
    "config": ("c.toml", read_config),
    "toml": ("c.toml", load_toml),
    "report": ("report.json", info.read_json),
    "npz": ("a.npz", arrays.read_arrays),
    "curves npz": ("a.npz", load_curves),
    "ply": ("a.ply", lambda path: ply.read_ply(path)),
    "mesh": ("a.ply", raycasting.load_mesh),
    "calibration": ("0.camera", strecha.read_camera),
    "matrix": ("pos.txt", dtu.read_matrix),
    "true cameras": ("true_cameras.json", poses.load_true_cameras),
    "lines": ("lines.txt", read_curves),
    "obj lines": ("lines.obj", read_curves),
    "limap tracks": ("track_0.txt", lambda path: read_curves(path.parent)),
}


@pytest.mark.parametrize("reader", READERS)
def test_readers_refuse_folders_pipes_and_devices(public, no_file, reader):
    name, read = READERS[reader]
    path = no_file(public / name)
    with pytest.raises((ColmapEdgesError, OSError, click.UsageError)) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert name in f"{caught.value} {path.parent}" or path.parent.name in str(caught.value)


@pytest.mark.parametrize("suffix", ["bin", "txt"])
@pytest.mark.parametrize("name", ["cameras", "images", "points3D", "rigs", "frames"])
def test_models_are_of_files(scene, public, no_file, name, suffix):
    write = (
        scene.reconstruction.write_binary if suffix == "bin" else scene.reconstruction.write_text
    )
    write(str(public))
    no_file(public / f"{name}.{suffix}")
    with pytest.raises(ColmapEdgesError, match=name) as caught:
        load_model(public)
    assert "\n" not in str(caught.value)


def test_cache_entries_that_are_no_files_are_made_again(public, no_file, caplog):
    cache = Cache(public / "cache")
    path = cache.path("kind", "key")
    path.parent.mkdir(parents=True)
    no_file(path)
    assert cache.load("kind", "key", dict) is None


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"unreadable"}))
@pytest.mark.parametrize("part", ["image", "mask", "mask_path"])
def test_runs_end_in_one_line(small, tmp_path, part, kind):
    """An image that is no file is missing; what is named as a mask and is no file is told of."""
    images, masks = tmp_path / "images", tmp_path / "masks"
    shutil.copytree(small[0], images)
    write_masks(masks, images, np.full((180, 240), 255, np.uint8))
    name = sorted(images.iterdir())[0].name
    path = {
        "image": images / name,
        "mask": masks / f"{name}.png",
        "mask_path": tmp_path / "mask.png",
    }[part]
    path.unlink(missing_ok=True)
    KINDS[kind](path)
    paths = paths_of((images, small[1]), tmp_path, masks)
    if part == "mask_path":  # an empty one, where it is a folder
        paths = replace(paths, mask_path=path)
    with pytest.raises(ColmapEdgesError) as caught:
        run("detect", paths, PipelineOptions(num_threads=1))
    assert "\n" not in str(caught.value)
    assert (part if part == "mask_path" else path.name) in str(caught.value)
    assert not paths.output_path.exists()


def test_files_are_read_as_they_are(tmp_path):
    data = np.random.default_rng(0).bytes(100_000)
    (tmp_path / "a").write_bytes(data)
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "link") == data
    with open_file(tmp_path / "a") as file:
        assert file.read(5) == data[:5]
    (tmp_path / "b").write_text("Grüße", encoding="utf-8")
    assert read_text(tmp_path / "b") == "Grüße"
    with pytest.raises(NotAFileError, match="a folder, not a file"):
        open_file(tmp_path)


def test_one_mask_of_all_images_that_is_a_file_is_taken(small, tmp_path, scene_model):
    path = tmp_path / "mask.png"
    cv2.imwrite(str(path), np.full((4, 4), 255, np.uint8))
    check_masks(scene_model.views, path)
