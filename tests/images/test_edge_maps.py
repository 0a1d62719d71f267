"""Edge images are named like masks; damaged ones are errors."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from colmap_edges.colmap.model import load_model
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.edge_maps import (
    check_edge_maps,
    decode_edge_map,
    path_of_edge_map,
    read_edge_map,
)
from colmap_edges.images.files import CompanionFile


@pytest.fixture(scope="module")
def view(small):
    return load_model(small[1]).views[0]


def encode(picture, kind=".png"):
    return cv2.imencode(kind, picture)[1].ravel()


def edge_image(data):
    return CompanionFile("edge image", Path("a.png"), "a.jpg", data)


@pytest.mark.parametrize(
    ("files", "name", "expected"),
    [
        (["a/b.jpg.png"], "a/b.jpg", "a/b.jpg.png"),
        (["a/b.png"], "a/b.jpg", "a/b.png"),
        (["b.png", "b.jpg.png"], "b.jpg", "b.jpg.png"),
        (["b.png"], "b.png", "b.png"),
        (["b.1.png"], "b.1.jpg", "b.1.png"),
        (["b.jpg"], "b.jpg", None),
        ([], "b.jpg", None),
    ],
)
def test_edge_images_are_named_after_their_images(tmp_path, files, name, expected):
    for file in files:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    assert path_of_edge_map(tmp_path, name) == (expected and tmp_path / expected)


def test_names_do_not_lead_out_of_the_folder(tmp_path):
    (tmp_path / "secret.png").touch()
    (tmp_path / "maps").mkdir()
    with pytest.raises(ColmapEdgesError, match="leads out of"):
        path_of_edge_map(tmp_path / "maps", "../secret")


def test_every_image_needs_an_edge_image_before_work_starts(small, tmp_path):
    views = load_model(small[1]).views
    with pytest.raises(ColmapEdgesError, match=r"edge_path .*nowhere is not a folder"):
        check_edge_maps(views, small[0], tmp_path / "nowhere")
    for view in views[1:]:
        (tmp_path / f"{view.name}.png").touch()
    with pytest.raises(ColmapEdgesError, match=f"no edge image of 1 of 6 .* {views[0].name}.png"):
        check_edge_maps(views, small[0], tmp_path)
    (tmp_path / Path(views[0].name).with_suffix(".png")).touch()
    check_edge_maps(views, small[0], tmp_path)


def test_photographs_are_no_edge_images(small, view, tmp_path):
    renamed = replace(view, name="a.png")
    (tmp_path / "a.png").touch()
    with pytest.raises(ColmapEdgesError, match="is the photograph itself"):
        check_edge_maps([renamed], tmp_path, tmp_path)


def test_unreadable_edge_images_are_one_line(view, tmp_path):
    path = tmp_path / f"{view.name}.png"
    whole = encode(np.zeros((180, 240), np.uint8)).tobytes()
    for data in (b"", b"no picture", whole[:40]):
        path.write_bytes(data)
        with pytest.raises(ColmapEdgesError, match="cannot read edge image") as caught:
            decode_edge_map(read_edge_map(tmp_path, view.name), view)
        assert "\n" not in str(caught.value)
    path.write_bytes(encode(np.zeros((180, 240), np.float32), ".tiff").tobytes())
    with pytest.raises(ColmapEdgesError, match="cannot read edge image"):
        decode_edge_map(read_edge_map(tmp_path, view.name), view)
    path.unlink()
    with pytest.raises(ColmapEdgesError, match="has no edge image of image"):
        read_edge_map(tmp_path, view.name)
    path.mkdir()
    with pytest.raises(ColmapEdgesError, match="cannot read edge image"):
        read_edge_map(tmp_path, view.name)
    assert read_edge_map(None, view.name) is None


@pytest.mark.parametrize("shape", [(180, 240), (270, 360), (361, 480)])
def test_sizes_that_fit(view, shape):
    file = edge_image(encode(np.zeros(shape, np.uint8)))
    assert decode_edge_map(file, view).strengths.shape == shape


@pytest.mark.parametrize("shape", [(90, 240), (90, 120), (240, 180), (180, 239), (300, 360)])
def test_sizes_that_do_not_fit(view, shape):
    file = edge_image(encode(np.zeros(shape, np.uint8)))
    height, width = shape
    with pytest.raises(ColmapEdgesError, match=f"edge image a.png is {width}x{height}, the cam"):
        decode_edge_map(file, view)


def test_strengths_are_shares_of_the_strongest(view):
    picture = np.zeros((180, 240), np.uint8)
    picture[5, :3] = 40, 80, 20
    strengths = decode_edge_map(edge_image(encode(picture)), view).strengths
    assert strengths[5, :4].tolist() == [0.5, 1, 0.25, 0]
    inverted = encode(255 - picture)
    again = decode_edge_map(edge_image(inverted), view).strengths
    np.testing.assert_array_equal(again, strengths)
