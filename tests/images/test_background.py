"""Detection of the background, and the directions of background rays."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from curves import make_view
from mask_files import paths_of, write_masks

from colmap_edges.colmap.model import load_model
from colmap_edges.errors import OptionError
from colmap_edges.images.background import (
    MAX_DEVIATION,
    NO_BACKGROUND_MASK,
    BackgroundMask,
    background_rays,
    masked_background,
    plain_background,
    shown_pixels,
)
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.reconstruct import reconstruct
from colmap_edges.pipeline.run import run
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.mesher import mesh

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

GRAY = (120, 120, 120)
PLAIN = PipelineOptions(
    use_faces=False, use_patches=False, refine_poses=False, report=False, num_threads=2
)


def picture(color=(255, 255, 255), body=GRAY, height=90, width=120):
    """A body with a hole before a plain backdrop."""
    image = np.full((height, width, 3), color, np.uint8)
    cv2.rectangle(image, (30, 20), (90, 70), body, -1)
    cv2.rectangle(image, (50, 35), (70, 55), color, -1)
    return image


def shown(background_mask, with_holes):
    """The picture of what is sampled, pixel by pixel."""
    body = background_mask.body()
    found = np.zeros(body.shape, bool)
    columns, rows = shown_pixels(body, with_holes).T
    found[rows, columns] = True
    return found


@pytest.mark.parametrize("color", [(255, 255, 255), (0, 0, 0), (40, 200, 60)])
def test_around_and_within_a_body(color):
    """Every pixel is sampled of so small an image, but next to the body and the image's border."""
    image = picture(color)
    background_mask = plain_background(image)
    around = shown(background_mask, with_holes=False)
    enclosed = shown(background_mask, with_holes=True) & ~around
    expected = np.ones(image.shape[:2], bool)
    expected[19:72, 29:92] = False
    np.testing.assert_array_equal(around, expected)
    assert np.array_equal(np.argwhere(enclosed)[[0, -1]], [[36, 51], [54, 69]])
    assert enclosed.sum() == 19 * 19
    assert background_mask.is_seen
    assert background_mask.body_pixels[1] == 0


def test_noise_within_the_deviation_is_plain():
    rng = np.random.default_rng(0)
    image = picture((200, 200, 200)).astype(int)
    noisy = image + rng.integers(-MAX_DEVIATION, MAX_DEVIATION + 1, image.shape)
    background_mask = plain_background(noisy.astype(np.uint8))
    np.testing.assert_array_equal(background_mask.body(), plain_background(picture()).body())


def clutter(image):
    """What is no plain backdrop: something else along a tenth of the border."""
    image[:, :6] = np.arange(len(image))[:, None, None] * 2
    return image


def gradient(image):
    """A sky or a lit wall, brighter to one side."""
    image[:] = np.linspace(150, 250, image.shape[1])[None, :, None]
    return image


@pytest.mark.parametrize("change", [clutter, gradient, lambda image: image[:, :0:-1] * 0 + 7])
def test_other_backgrounds_are_left_alone(change):
    """Clutter, a gradient, and an image that shows nothing at all."""
    assert not plain_background(np.ascontiguousarray(change(picture()), np.uint8)).is_seen


def test_samples_are_a_grid_of_about_as_many():
    pixels = shown_pixels(np.zeros((3000, 4000), bool), with_holes=False)
    assert len(pixels) == pytest.approx(10_000, rel=0.05)
    assert len(np.unique(np.diff(np.unique(pixels[:, 0])))) == 1
    assert len(shown_pixels(np.ones((30, 40), bool), with_holes=True)) == 0
    assert len(shown_pixels(np.zeros((3, 4), bool), with_holes=True)) == 12


def test_large_masks_are_kept_smaller():
    """Rays still go through pixels of the image."""
    body = np.zeros((3000, 4000), bool)
    body[:, :2000] = True
    background_mask = masked_background(body)
    assert background_mask.body().shape == (1500, 2000)
    assert background_mask.packed_body.nbytes == 1500 * 250
    view = replace(make_view(np.eye(3), np.zeros(3)), width=4000, height=3000)
    rays = background_rays([view], [background_mask], True)
    pixels, _ = view.project(rays.directions)
    assert len(pixels) == pytest.approx(5000, rel=0.05)
    assert 2000 < pixels[:, 0].min() < 2100
    assert pixels.max(axis=0) == pytest.approx((4000, 3000), abs=60)


def test_rays_go_through_the_pixels():
    views = [make_view(np.eye(3), np.zeros(3)), make_view(np.diag([-1.0, 1, -1]), np.ones(3), 1)]
    background_mask = plain_background(picture(height=480, width=640))
    rays = background_rays(views, [background_mask] * 2, False)
    pixels = shown_pixels(background_mask.body(), with_holes=True) + 0.5
    for index, view in enumerate(views):
        points = view.center + 3.0 * rays.directions[rays.cameras == index]
        found, depths = view.project(points)
        assert (depths > 0).all()
        np.testing.assert_allclose(found, pixels, atol=1e-3)


def test_a_backdrop_is_believed_when_nearly_all_views_show_it():
    views = [make_view(np.eye(3), np.zeros(3), i) for i in range(20)]
    background_mask = plain_background(picture(height=480, width=640))
    count = len(shown_pixels(background_mask.body(), with_holes=True))
    for missing, expected in ((0, 20), (2, 18), (3, 0), (20, 0)):
        background_masks = [NO_BACKGROUND_MASK] * missing + [background_mask] * (20 - missing)
        rays = background_rays(views, background_masks, False)
        assert (len(rays.cameras) if rays else 0) == expected * count
    assert (
        len(background_rays(views, [NO_BACKGROUND_MASK] * 19 + [background_mask], True).cameras)
        == count
    )


def test_holes_are_believed_when_the_body_is_nowhere_as_bright():
    """A lit body that reaches the backdrop's white has places that nearly do."""
    view = make_view(np.eye(3), np.zeros(3))
    dark = picture(height=480, width=640)
    bright = dark.copy()
    bright[22:30, 32:88] = 255 - MAX_DEVIATION - 1
    for image, with_holes in ((dark, True), (bright, False)):
        background_mask = plain_background(image)
        rays = background_rays([view], [background_mask], False)
        counts = [len(shown_pixels(background_mask.body(), holes)) for holes in (False, True)]
        assert counts[0] < counts[1]
        assert len(rays.cameras) == counts[with_holes]


def test_pixels_that_the_lens_cannot_see_have_no_ray():
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL_FISHEYE", 100.0, 640, 480)
    camera.params = [100.0, 320.0, 240.0, -0.3]
    view = make_view(np.eye(3), np.zeros(3), camera=camera)
    background_mask = masked_background(np.zeros((480, 640), bool))
    rays = background_rays([view], [background_mask], True)
    assert 0 < len(rays.cameras) < 0.5 * 10_000
    assert np.isfinite(rays.directions).all()


def before_white(small, folder):
    """The images of a scene with all that is black, which is its background, made white."""
    for path in sorted(small[0].iterdir()):
        image = cv2.imread(str(path))
        image[(image == image[0, 0]).all(axis=2)] = 255
        cv2.imwrite(str(folder / path.name), image)
    return folder, small[1]


def test_background_reaches_the_mesher(small, tmp_path):
    """The same with and without a cache, from folders and in Python; none when not wanted."""
    (tmp_path / "images").mkdir()
    scene = before_white(small, tmp_path / "images")
    meshes = []
    for cache in (None, tmp_path / "cache", tmp_path / "cache"):
        paths = replace(paths_of(scene, tmp_path, None), cache_path=cache)
        report = run("mesh", paths, PLAIN, overwrite=True)
        counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
        assert counts["background"]["background_rays"] > 1000
        meshes.append((tmp_path / "out" / "mesh.ply").read_bytes())
    assert meshes[0] == meshes[1] == meshes[2]
    found = reconstruct(pycolmap.Reconstruction(str(scene[1])), scene[0], PLAIN)
    assert len(found.background.cameras) == counts["background"]["background_rays"]
    others = {"background": found.background, "contours": found.contours}
    given = mesh(scene[1], found.edges, **others)
    assert len(given.faces) == counts["mesh"]["faces"]
    unused = replace(PLAIN, meshing=replace(PLAIN.meshing, background_weight=0.0))
    report = run("mesh", paths_of(scene, tmp_path, None), unused, overwrite=True)
    counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
    assert "background" not in counts


def test_masked_pixels_may_be_background(small, tmp_path):
    mask = np.full((180, 240), 255, np.uint8)
    mask[:40] = 0
    masks = write_masks(tmp_path / "masks", small[0], mask)
    counts = []
    for are_background in (True, False):
        options = replace(PLAIN, masks_are_background=are_background)
        report = run("mesh", paths_of(small, tmp_path, masks), options, overwrite=True)
        by_name = {stage["name"]: stage["counts"] for stage in report["stages"]}
        counts.append(by_name["background"]["background_rays"])
    assert counts[0] == 6 * 120 * 18, "of every second pixel"
    assert counts[1] not in (0, counts[0]), "of the plain backdrop"
    with pytest.raises(OptionError, match="there are no masks; give mask_path"):
        run(
            "mesh",
            paths_of(small, tmp_path, None),
            PipelineOptions(masks_are_background=True),
            overwrite=True,
        )


def test_masks_are_not_asked_for_without_edges():
    with pytest.raises(OptionError, match="masks_are_background is 1 and use_edges 0"):
        PipelineOptions(masks_are_background=True, use_edges=False)


def test_masked_views_without_masks_show_no_background(small, tmp_path):
    masks = write_masks(tmp_path / "masks", small[0], np.zeros((180, 240), np.uint8), every=3)
    model = load_model(small[1])
    options = PipelineOptions(masks_are_background=True)
    store = detect_stage(model, small[0], options, Stages(), mask_path=masks)
    assert sum(mask.is_seen for mask in store.background_masks) == 2
    assert isinstance(store.background_masks[0], BackgroundMask)


def test_a_backdrop_without_any_edge_is_meshed(small, tmp_path):
    """Bodies as blurred as clouds before white: SfM points, and rays past the bodies."""
    images = tmp_path / "images"
    images.mkdir()
    y, x = np.mgrid[:180, :240]
    cloud = np.clip(60 - np.hypot(x - 120, y - 90), 0, 60)
    for path in small[0].iterdir():
        cv2.imwrite(str(images / path.name), np.rint(255 - 0.5 * cloud).astype(np.uint8))
    paths = paths_of((images, small[1]), tmp_path, None)
    report = run("mesh", paths, PipelineOptions(num_threads=2, report=False))
    counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
    assert counts["detect"]["edge_pixels"] == counts["trace"]["edges"] == 0
    assert counts["mesh"]["faces"] > 500
    assert "no edge was detected in any of 6 images" in report["findings"][1]["text"]
    result = reconstruct(pycolmap.Reconstruction(str(small[1])), images)
    found = mesh(small[1], result.edges, background=result.background, faces=result.faces)
    assert len(found.faces) == counts["mesh"]["faces"]


@pytest.mark.parametrize("are_background", [True, False])
@pytest.mark.parametrize("left", ["nothing", "a blob"])
def test_masks_without_visible_edges_are_reported(small, tmp_path, left, are_background):
    """Such as inverted ones, for which what there is gets meshed."""
    mask = np.zeros((180, 240), np.uint8)
    if left == "a blob":
        mask[80:100, 110:130] = 255
    masks = write_masks(tmp_path / "masks", small[0], mask)
    options = replace(PLAIN, masks_are_background=are_background)
    report = run("mesh", paths_of(small, tmp_path, masks), options)
    counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
    assert counts["trace"]["edges"] == 0
    assert counts["mesh"]["faces"] > (500 if left == "nothing" or not are_background else 0)
    remedies = [finding["remedy"] for finding in report["findings"]]
    assert sum("check the masks" in remedy for remedy in remedies) == 1
    assert (tmp_path / "out" / "mesh.ply").is_file()
