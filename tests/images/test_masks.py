"""Masks are named and read as in COLMAP; damaged ones are errors."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from mask_files import BLACK_LEFT, paths_of, write_masks
from scenes import EDGES_ALONE

from colmap_edges.colmap.model import load_model
from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges2d.detection import Chains
from colmap_edges.edges2d.masking import outside_mask
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.images.files import CompanionFile
from colmap_edges.images.masks import (
    MARGIN_PX,
    check_masks,
    path_of_mask,
    read_mask,
    usable_pixels,
)
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.read import check_pictures
from colmap_edges.pipeline.reconstruct import reconstruct
from colmap_edges.pipeline.run import run
from colmap_edges.runtime.stages import Stages

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

CORNER_PX = 8  # by which chains are led on to their corners


def mask_file(mask, path=Path("m.png")):
    return CompanionFile("mask", path, "a.jpg", cv2.imencode(".png", mask)[1].ravel())


def level(lengths, rows):
    """Chains from left to right, of these lengths in these rows of pixels."""
    points = [
        np.column_stack([np.arange(n) + 0.5, np.full(n, y + 0.5)])
        for n, y in zip(lengths, rows, strict=True)
    ]
    return Chains(
        points=np.concatenate(points),
        normals=np.tile([0.0, 1.0], (sum(lengths), 1)),
        sides=np.tile(np.array([50, 200], np.uint8), (sum(lengths), 1)),
        offsets=offsets_of(np.array(lengths)),
    )


def view_of(scene_model, width=60, height=40):
    return replace(scene_model.views[0], name="a.png", width=width, height=height)


@pytest.mark.parametrize(
    ("files", "name", "expected"),
    [
        (["a/b.jpg.png"], "a/b.jpg", "a/b.jpg.png"),
        (["b.png.png", "b.png"], "b.png", "b.png.png"),
        (["b.png"], "b.png", "b.png"),
        (["b.PNG"], "b.PNG", "b.PNG"),
        (["b.jpg", "b.png"], "b.jpg", None),
        ([], "b.jpg", None),
    ],
)
def test_masks_are_named_as_colmap_names_them(tmp_path, files, name, expected):
    for file in files:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    assert path_of_mask(tmp_path, name) == (expected and tmp_path / expected)


def test_one_file_is_the_mask_of_all_images(tmp_path):
    path = tmp_path / "mask.png"
    path.touch()
    assert path_of_mask(path, "any/image.jpg") == path


def test_names_do_not_lead_out_of_the_folder(tmp_path):
    (tmp_path / "secret.png").touch()
    (tmp_path / "masks").mkdir()
    with pytest.raises(ColmapEdgesError, match="leads out of"):
        path_of_mask(tmp_path / "masks", "../secret")


@pytest.mark.parametrize("kind", ["0 and 255", "0 and 1", "16 bit", "color", "one bit"])
def test_black_is_masked_whatever_the_format(scene_model, kind):
    mask = np.zeros((40, 60), np.uint8)
    mask[:, 30:] = 255
    stored = {
        "0 and 255": mask,
        "0 and 1": mask // 255,
        "16 bit": (mask // 255).astype(np.uint16),
        "color": np.dstack([mask, mask, mask]),
        "one bit": mask,
    }[kind]
    options = [cv2.IMWRITE_PNG_BILEVEL, 1] if kind == "one bit" else []
    data = cv2.imencode(".png", stored, options)[1].ravel()
    usable = usable_pixels(
        CompanionFile("mask", Path("m.png"), "m.jpg", data), None, view_of(scene_model)
    )
    expected = np.zeros((40, 60), bool)
    expected[:, 30 - MARGIN_PX :] = True
    np.testing.assert_array_equal(usable, expected)


def test_chains_are_cut_where_masked():
    """Two chains across three columns, of which the middle one is masked."""
    chains = level([90, 90], [10, 20])
    mask = np.ones((40, 90), bool)
    mask[:, 30:60] = False
    mask[20, 80:] = False
    left = outside_mask(chains, mask, 1.0, 12)
    np.testing.assert_array_equal(np.diff(left.offsets), [30, 30, 30, 20])
    np.testing.assert_array_equal(left.points[[0, 30, 60, 90], 0], [0.5, 60.5, 0.5, 60.5])
    np.testing.assert_array_equal(left.points[:, 1], np.repeat([10.5, 20.5], [60, 50]))
    for name in ("normals", "sides"):
        assert len(getattr(left, name)) == 110
    short = outside_mask(chains, mask, 1.0, 21)
    np.testing.assert_array_equal(np.diff(short.offsets), [30, 30, 30])
    # Of an image enlarged twice the same chains lie in the left half.
    np.testing.assert_array_equal(np.diff(outside_mask(chains, mask, 2.0, 12).offsets), [60, 60])


def test_all_white_and_all_black_masks():
    chains = level([50, 50], [5, 6])
    same = outside_mask(chains, np.ones((10, 50), bool), 1.0, 12)
    np.testing.assert_array_equal(same.points, chains.points)
    np.testing.assert_array_equal(same.offsets, chains.offsets)
    none = outside_mask(chains, np.zeros((10, 50), bool), 1.0, 12)
    assert len(none.points) == 0
    np.testing.assert_array_equal(none.offsets, [0])
    again = outside_mask(none, np.ones((10, 50), bool), 1.0, 12)
    np.testing.assert_array_equal(again.offsets, [0])


def test_no_edges_where_the_mask_is_black(small, tmp_path):
    masks = write_masks(tmp_path / "masks", small[0], every=2)
    images = sorted(path.name for path in small[0].iterdir())
    model = load_model(small[1])
    options = PipelineOptions(num_threads=2)
    free = detect_stage(model, small[0], options, Stages()).graphs
    stages = Stages()
    masked = detect_stage(model, small[0], options, stages, mask_path=masks).graphs
    assert stages.records()[0]["counts"]["images_masked"] == len(images[::2])
    for index, view in enumerate(model.views):
        before, after = free.load(index), masked.load(index)
        left = before.points[:, 0] < 120 - MARGIN_PX
        assert left.any()
        if images.index(view.name) % 2:
            np.testing.assert_array_equal(after.points, before.points)
        else:
            assert after.points[:, 0].min() >= 120 - MARGIN_PX - CORNER_PX
            assert (after.points[:, 0] < 120 - MARGIN_PX).mean() < 0.01
            assert len(after.points) >= 0.95 * (~left).sum()


def test_one_mask_hides_the_same_part_of_all_images(small, tmp_path):
    """Where the rig, a watermark or the time is in every image."""
    cv2.imwrite(str(tmp_path / "mask.png"), BLACK_LEFT)
    model = load_model(small[1])
    mask_path = tmp_path / "mask.png"
    graphs = detect_stage(model, small[0], PipelineOptions(), Stages(), mask_path=mask_path).graphs
    lefts = [graphs.load(view).points[:, 0].min() for view in range(len(model.views))]
    assert min(lefts) >= 120 - MARGIN_PX - CORNER_PX


def test_a_run_with_masks(small, tmp_path):
    """3D edges keep to what masks leave; results kept for later know the masks they are of."""
    masks = write_masks(tmp_path / "masks", small[0])
    reconstruction = pycolmap.Reconstruction(str(small[1]))
    found = reconstruct(reconstruction, small[0], EDGES_ALONE, mask_path=masks)
    assert found.edges.num_points
    assert found.edges.observations.pixels[:, 0].min() >= 120 - MARGIN_PX - CORNER_PX

    def points(mask_path):
        paths = replace(paths_of(small, tmp_path, mask_path), cache_path=tmp_path / "cache")
        report = run("reconstruct", paths, replace(EDGES_ALONE, report=False), overwrite=True)
        counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
        return counts["trace"]["edge_points"], counts["detect"]["images_reused"]

    free, masked = points(None), points(masks)
    assert masked == (found.edges.num_distinct, 0)
    assert masked[0] < free[0]
    assert points(None) == (free[0], 6)
    assert points(masks) == (masked[0], 6)


def test_bad_masks_are_one_line(small, tmp_path):
    view = load_model(small[1]).views[0]
    masks = write_masks(tmp_path / "masks", small[0])

    def fails(message, mask_path=masks):
        with pytest.raises(ColmapEdgesError, match=message) as caught:
            run("detect", paths_of(small, tmp_path, mask_path), PipelineOptions())
        assert "\n" not in str(caught.value)
        assert not (tmp_path / "out").exists()

    first = masks / f"{view.name}.png"
    whole = first.read_bytes()
    cv2.imwrite(str(first), BLACK_LEFT[:90])
    fails(f"mask .*{view.name}.png is 240x90, the camera of image {view.name} 240x180")
    for data in (b"", b"no picture", whole[:40]):
        first.write_bytes(data)
        fails(f"cannot read mask .*{view.name}.png of image {view.name}; replace or delete it")
    first.unlink()
    run("detect", paths_of(small, tmp_path, masks), PipelineOptions())
    shutil.rmtree(tmp_path / "out")
    fails("is neither a folder nor a file", tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    fails("has no mask of any of the 6 images; .* that of .* is .*.png", tmp_path / "empty")


def test_unreadable_masks(tmp_path, monkeypatch):
    path = tmp_path / "a.jpg.png"
    path.touch()

    def failing(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(np, "fromfile", failing)
    with pytest.raises(ColmapEdgesError, match="cannot read mask"):
        read_mask(tmp_path, "a.jpg")
    assert read_mask(tmp_path, "b.jpg") is None
    assert read_mask(None, "a.jpg") is None


def test_masks_are_looked_for_before_work_starts(scene_model, tmp_path):
    with pytest.raises(ColmapEdgesError, match="has no mask of any"):
        check_masks(scene_model.views, tmp_path)
    with pytest.raises(ColmapEdgesError, match="is neither a folder nor a file"):
        check_masks(scene_model.views, tmp_path / "nowhere")
    (tmp_path / f"{scene_model.views[-1].name}.png").touch()
    check_masks(scene_model.views, tmp_path)


def test_transparent_pixels_are_masked_as_by_a_mask(scene, tmp_path):
    """Edges, counts and background are those of the opaque image with the alpha as its mask."""
    images, given = scene.write(tmp_path / "given")
    model, (cut, masks) = load_model(given), (tmp_path / "cut", tmp_path / "masks")
    for folder in (cut, masks):
        folder.mkdir()
    for view in model.views:
        alpha = np.zeros((view.height, view.width), np.uint8)
        cv2.circle(alpha, (view.width // 2, view.height // 2), view.height // 3, 255, -1)
        picture = cv2.imread(str(images / view.name))
        cv2.imwrite(str(cut / view.name), np.dstack([picture, alpha]))
        cv2.imwrite(str(masks / f"{view.name}.png"), alpha)
    options = PipelineOptions(num_threads=2, masks_are_background=True)
    check_pictures(model, cut, None, None, options)
    with pytest.raises(OptionError, match="there are no masks"):
        check_pictures(model, images, None, None, options)
    by_alpha, by_mask, whole, both = Stages(), Stages(), Stages(), Stages()
    found = detect_stage(model, cut, options, by_alpha)
    expected = detect_stage(model, images, options, by_mask, mask_path=masks)
    detect_stage(model, images, options, whole)
    detect_stage(model, cut, options, both, mask_path=masks)
    assert by_alpha.records()[0]["counts"] == by_mask.records()[0]["counts"]
    assert both.records()[0]["counts"] == by_mask.records()[0]["counts"]
    counts = [stages.records()[0]["counts"]["edge_pixels"] for stages in (by_alpha, whole)]
    assert 0 < counts[0] < counts[1]
    for mine, theirs in zip(found.background_masks, expected.background_masks, strict=True):
        np.testing.assert_array_equal(mine.packed_body, theirs.packed_body)
