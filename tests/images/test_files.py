"""Image files of all formats, and unusual image names."""

import struct
from dataclasses import replace
from zlib import compress, crc32

import cv2
import numpy as np
import pycolmap
import pytest
import scenes

from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.images.files import (
    alpha_of,
    check_images_exist,
    colors_at,
    path_of_image,
    read_image,
)
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.runtime.stages import Stages

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

EXIF_HEAD = "45786966000049492a000800000001001201030001000000"


def view_of(scene_model, name, width, height):
    return replace(scene_model.views[0], name=name, width=width, height=height)


def gray_step(width=60, height=40):
    """Dark to the left, bright to the right."""
    image = np.full((height, width), 60, np.uint8)
    image[:, width // 2 :] = 200
    return image


def with_orientation(jpeg, orientation):
    """A JPEG with an EXIF header that says how the camera was held."""
    exif = bytes.fromhex(EXIF_HEAD) + bytes([orientation]) + bytes(7)
    return jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:]


def encoded(kind):
    """A picture of `gray_step` as file bytes and the name it has."""
    gray = gray_step()
    color = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    if kind.startswith("rotated"):
        jpeg = cv2.imencode(".jpg", color)[1].tobytes()
        return "a.jpg", with_orientation(jpeg, int(kind[-1]))
    if kind == "cmyk":
        return "a.jpg", cmyk_jpeg(gray)
    image = {
        "gray": gray,
        "color": color,
        "16 bit": gray.astype(np.uint16) * 257,
        "16 bit color": color.astype(np.uint16) * 257,
        "alpha": np.dstack([color, np.full_like(gray, 7)]),
        "16 bit alpha": np.dstack([color, np.full_like(gray, 7)]).astype(np.uint16) * 257,
    }[kind]
    return "a.png", cv2.imencode(".png", image)[1].tobytes()


def cmyk_jpeg(gray):
    """A JPEG of four colours, as printers like them; OpenCV cannot write one."""
    pillow = pytest.importorskip("PIL.Image", reason="needs Pillow")
    from io import BytesIO

    file = BytesIO()
    pillow.fromarray(np.dstack([gray] * 3)).convert("CMYK").save(file, "JPEG", quality=95)
    return file.getvalue()


@pytest.mark.parametrize(
    "kind",
    ["gray", "color", "16 bit", "16 bit color", "alpha", "16 bit alpha", "cmyk"]
    + [f"rotated {orientation}" for orientation in range(1, 9)],
)
def test_every_kind_of_picture_shows_the_same(scene_model, tmp_path, kind):
    name, data = encoded(kind)
    (tmp_path / name).write_bytes(data)
    image = read_image(view_of(scene_model, name, 60, 40), tmp_path)
    assert image.shape == (40, 60, 3)
    difference = image.astype(int) - gray_step()[:, :, None]
    assert np.abs(difference).max() <= 6


@pytest.mark.parametrize("size", [(1, 1), (2, 1), (1, 50), (3, 3), (9, 7)])
def test_the_smallest_pictures_have_no_edges(scene_model, tmp_path, size):
    cv2.imwrite(str(tmp_path / "a.png"), gray_step(*size))
    model = replace(scene_model, views=(view_of(scene_model, "a.png", *size),))
    graph = detect_stage(model, tmp_path, PipelineOptions(), Stages()).graphs.load(0)
    assert graph.num_polylines == 0


def test_pictures_of_100_megapixels(scene_model, tmp_path, soak):
    width, height = (12_000, 8_400) if soak else (2_000, 1_400)
    cv2.imwrite(str(tmp_path / "a.bmp"), gray_step(width, height))
    model = replace(scene_model, views=(view_of(scene_model, "a.bmp", width, height),))
    graph = detect_stage(model, tmp_path, PipelineOptions(num_threads=1), Stages()).graphs.load(0)
    assert graph.num_polylines == 1
    np.testing.assert_allclose(graph.points[:, 0], width / 2, atol=0.1)


NAMES = [
    *("with space.png", "Ünï/çødé 世界.png", "a'b\"c.png", "<img src=x>.png", "%2e%2e%2fx.png"),
    *("..hidden.png", "-rf.png", "a;b&c|d$e.png", "deep/er/down.png", "no suffix"),
]


@pytest.mark.parametrize("command", ["detect", "reconstruct"])
def test_names_of_all_sorts(tmp_path, command):
    scene = scenes.make_scene(num_views=len(NAMES), width=96, height=72)
    reconstruction = pycolmap.Reconstruction(scene.reconstruction)
    for image, name in zip(reconstruction.images.values(), NAMES, strict=True):
        path = tmp_path / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(".png", scene.images[image.name])[1].tobytes())
        image.name = name
    (tmp_path / "sparse").mkdir()
    reconstruction.write(tmp_path / "sparse")
    folders = {f"{name}_path": tmp_path / name for name in ("input", "output")}
    folders["input_path"] = tmp_path / "sparse"
    before = sorted(path for path in tmp_path.rglob("*"))
    run(command, Paths(image_path=tmp_path / "images", **folders), PipelineOptions())
    output = tmp_path / "output"
    if command == "detect":
        assert all((output / "overlays" / f"{name}.png").is_file() for name in NAMES)
        assert all((output / "edge_graphs" / f"{name}.npz").is_file() for name in NAMES)
    else:
        written = pycolmap.Reconstruction(output / "sparse")
        assert sorted(image.name for image in written.images.values()) == sorted(NAMES)
    after = sorted(p for p in tmp_path.rglob("*") if output not in (p, *p.parents))
    assert after == before


OUTSIDE = ["../secret.png", "/etc/passwd", "a/../../b.png", "..", "a/..", "/", ""]


@pytest.mark.parametrize("name", OUTSIDE)
def test_names_cannot_leave_the_folder(tmp_path, name):
    with pytest.raises(ColmapEdgesError, match="leads out of"):
        path_of_image(tmp_path, name)


@pytest.mark.parametrize("name", ["../secret.png", "{tmp_path}/secret.png"])
@pytest.mark.parametrize("command", ["detect", "reconstruct", "mesh"])
def test_a_model_cannot_make_us_read_or_write_outside(tmp_path, scene, command, name):
    image_path, input_path = scene.write(tmp_path / "scene")
    first = sorted(image_path.iterdir())[0]
    first.rename(tmp_path / "scene" / "secret.png")
    reconstruction = pycolmap.Reconstruction(input_path)
    image = next(i for i in reconstruction.images.values() if i.name == first.name)
    image.name = name.format(tmp_path=tmp_path / "scene")
    reconstruction.write(input_path)
    before = sorted(tmp_path.rglob("*"))
    paths = Paths(image_path=image_path, input_path=input_path, output_path=tmp_path / "out")
    with pytest.raises(ColmapEdgesError, match="leads out of"):
        run(command, paths, PipelineOptions())
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["a" * 300 + ".png", "a\0b.png"])
def test_names_that_no_file_has(scene_model, tmp_path, name):
    with pytest.raises(ColmapEdgesError, match="is not in"):
        check_images_exist([view_of(scene_model, name, 1, 1)], tmp_path)


def test_colours_are_those_of_the_image_at_the_points():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (40, 60, 3)).astype(np.uint8)  # OpenCV's BGR
    points = rng.uniform((1, 1), (58, 38), (200, 2))
    x, y = (points - 0.5).T  # pixel centres of COLMAP are at 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    above = (1 - fx) * image[top, left] + fx * image[top, left + 1]
    below = (1 - fx) * image[top + 1, left] + fx * image[top + 1, left + 1]
    expected = ((1 - fy) * above + fy * below)[:, ::-1]
    found = colors_at(image, points)
    assert found.dtype == np.uint8
    assert np.abs(found - expected).max() <= 0.5 + 1e-9


@pytest.mark.parametrize(
    ("there", "name", "message"),
    [
        ("a.JPG", "a.jpg", r"'a.JPG' is there: rename it to the model's 'a.jpg'"),
        ("a.png", "a.jpg", r"'a.png' is there: rename it"),
        ("cafe\u0301.jpg", "caf\u00e9.jpg", r"'cafe\\u0301.jpg' is there: .*'caf\\xe9.jpg'"),
        ("images/a.jpg", "a.jpg", r"it is in .*/given/images: give that as --image_path"),
        ("a.jpg", "given/a.jpg", r"it is in .*: give that as --image_path"),
        ("b.jpg", "a.jpg", "give the folder the model was made from"),
    ],
)
def test_missing_images_are_looked_for_nearby(scene_model, tmp_path, there, name, message):
    path = tmp_path / "given" / there
    path.parent.mkdir(parents=True)
    path.touch()
    with pytest.raises(ColmapEdgesError, match=message):
        check_images_exist([view_of(scene_model, name, 60, 40)], tmp_path / "given")


def test_images_rotated_against_their_camera_are_named(scene_model, tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), gray_step(40, 60))
    with pytest.raises(ColmapEdgesError, match=r"40x60, its camera 60x40; .*EXIF orientation"):
        read_image(view_of(scene_model, "a.png", 60, 40), tmp_path)
    with pytest.raises(ColmapEdgesError, match="undistorted ones for"):
        read_image(view_of(scene_model, "a.png", 61, 40), tmp_path)


def test_heic_is_told_how_to_convert(scene_model, tmp_path):
    (tmp_path / "a.jpg").write_bytes(bytes(3) + b"\x18ftypheic" + bytes(100))
    with pytest.raises(ImageError, match=r"HEIC or AVIF; convert it to JPEG or PNG under the same"):
        read_image(view_of(scene_model, "a.jpg", 60, 40), tmp_path)


def palette_png(alpha):
    """A PNG of two colours, of which the first is transparent."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", crc32(kind + data))

    height, width = alpha.shape
    rows = np.column_stack([np.zeros(height, np.uint8), alpha > 0]).astype(np.uint8)
    head = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    parts = {b"IHDR": head, b"PLTE": bytes([0, 0, 0, 90, 90, 90]), b"tRNS": b"\0"}
    parts |= {b"IDAT": compress(rows.tobytes()), b"IEND": b""}
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts.items())


@pytest.mark.parametrize("kind", ["8 bit", "16 bit", "palette", "webp", "tiff"])
def test_transparent_pixels_are_known(kind):
    color, alpha = np.full((4, 6, 3), 90, np.uint8), np.full((4, 6), 255, np.uint8)
    alpha[:, :2] = 0
    picture = np.dstack([color, alpha])
    if kind == "palette":
        raw = np.frombuffer(palette_png(alpha), np.uint8)
    else:
        stored = picture.astype(np.uint16) * 257 if kind == "16 bit" else picture
        suffix = {"webp": ".webp", "tiff": ".tiff"}.get(kind, ".png")
        raw = cv2.imencode(suffix, stored)[1].ravel()
    found = alpha_of(raw)
    assert found is not None
    np.testing.assert_array_equal(found > 0, alpha > 0)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".webp"])
def test_opaque_images_have_no_transparent_pixels(suffix):
    color = np.full((4, 6, 3), 90, np.uint8)
    assert alpha_of(cv2.imencode(suffix, color)[1].ravel()) is None
    if suffix == ".png":
        opaque = np.dstack([color, np.full((4, 6), 9, np.uint8)])
        assert alpha_of(cv2.imencode(suffix, opaque)[1].ravel()) is None
