"""Upsampling and downsampling of images by their blur; positions of edges are unchanged."""

import json
from dataclasses import asdict, replace
from functools import cache

import cv2
import numpy as np
import pycolmap
import pytest
from scenes import EDGES_ALONE
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import load_model, model_from_reconstruction
from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.edges3d import AdjustedPoses
from colmap_edges.edges2d.detection import detect_chains, detect_pixel_chains, resized
from colmap_edges.edges2d.working_scale import at_working_scale, measure_blur
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.files import gray_of, read_image
from colmap_edges.options import DetectionOptions, PipelineOptions, recorded, resolved
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.reconstruct import reconstruct
from colmap_edges.pipeline.run import run
from colmap_edges.runtime.stages import Stages

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

OPTIONS = DetectionOptions(gamma=1.0)  # what is drawn here is light
SIZE = (320, 240)
SOFTENING_PX = 2.0  # of images that are then given twice as large


@cache
def shapes(blur_px, oversampling=16):
    """(H, W) grays of a disc and a turned square, their edges blurred by a Gaussian."""
    width, height = (side * oversampling for side in SIZE)
    fine = np.full((height, width), 60, np.uint8)
    cv2.circle(fine, (width // 4, height // 2), height // 4, 200, -1)
    corners = cv2.boxPoints(((0.7 * width, height / 2), (height / 2, height / 2), 20))
    cv2.fillConvexPoly(fine, corners.astype(np.int32), 180)
    down, across = (blurring(side, blur_px, oversampling) for side in SIZE[::-1])
    return np.rint(down @ (across @ fine.T).T).astype(np.uint8)


def blurring(size, blur_px, oversampling):
    """(size, size * oversampling) weights of a Gaussian about the middle of each pixel."""
    places = np.arange(size * oversampling)
    off = (places - places[oversampling // 2 :: oversampling, None]) / (blur_px * oversampling)
    weights = np.where(np.abs(off) < 4, np.exp(-(off**2) / 2), 0).astype(np.float32)
    return csr_array(weights / weights.sum(axis=1, keepdims=True))


def bars(width_px, pitch_px):
    """(H, W) grays of upright bars, the first one's left edge at 0.5 px."""
    x = (np.arange(16 * SIZE[0]) + 0.5) / 16
    line = np.where((x - 0.5) % pitch_px < width_px, 180, 60).astype(np.float32)
    line = cv2.GaussianBlur(line[None], (0, 0), 0.5 * 16).reshape(SIZE[0], 16).mean(axis=1)
    return np.tile(np.round(line).astype(np.uint8), (SIZE[1], 1))


@pytest.mark.parametrize("blur_px", [0.4, 0.5, 0.8, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0])
def test_blur_of_known_edges(blur_px):
    rel = 0.2 if blur_px < 0.8 else 0.1  # pixels are about as wide as sharper edges
    assert measure_blur(shapes(blur_px), OPTIONS) == pytest.approx(blur_px, rel=rel)


@pytest.mark.parametrize("noise", [2, 6])
def test_blur_under_noise(noise):
    image = shapes(0.8) + np.random.default_rng(0).normal(0, noise, SIZE[::-1])
    blur_px = measure_blur(np.clip(np.round(image), 0, 255).astype(np.uint8), OPTIONS)
    assert blur_px == pytest.approx(0.8, rel=0.2)


@pytest.mark.parametrize("shape", [(240, 320), (1, 1), (3, 50)])
def test_blank_images_have_no_blur(shape):
    assert measure_blur(np.full(shape, 90, np.uint8), OPTIONS) == 0


def scene_of(model, folder, images):
    """A model whose views are these images, written to the folder."""
    views = []
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / f"{i}.png"), image)
        height, width = image.shape
        views.append(replace(model.views[0], name=f"{i}.png", width=width, height=height))
    return replace(model, views=tuple(views))


def scale_of(model, folder, **options):
    """The one scale of all views."""
    found = at_working_scale(model, folder, DetectionOptions(**options))
    [scale] = {view.scale for view in found.views}
    return scale


@pytest.mark.parametrize(
    ("blur_px", "scale"),
    [
        (0.2, 1.5),
        (0.47, 1.5),
        (0.6, 1.25),
        (0.9, 1.0),
        (1.5, 1.0),
        (2.4, 1.0),
        (3.2, 0.5),
        (4.0, 0.4),
    ],
)
def test_images_are_enlarged_or_reduced(scene_model, tmp_path, blur_px, scale):
    model = scene_of(scene_model, tmp_path, [shapes(blur_px)] * 3)
    assert scale_of(model, tmp_path) == scale
    assert scale_of(model, tmp_path, min_blur_px=0) == 1
    assert model.views[0].scale == 1


def test_the_usual_image_decides(scene_model, tmp_path):
    blank = np.full(SIZE[::-1], 90, np.uint8)
    model = scene_of(scene_model, tmp_path, [shapes(0.5), blank, shapes(0.5), shapes(3.0), blank])
    (tmp_path / "4.png").write_bytes(b"damaged")
    assert scale_of(model, tmp_path) == 1.5
    for view in model.views:
        (tmp_path / view.name).write_bytes(b"damaged")
    assert scale_of(model, tmp_path) == 1


def test_the_sharpest_image_decides_how_far_all_are_reduced(scene_model, tmp_path):
    soft = [shapes(4.0)] * 4
    assert scale_of(scene_of(scene_model, tmp_path, [*soft, shapes(3.2)]), tmp_path) == 0.5
    assert scale_of(scene_of(scene_model, tmp_path, [*soft, shapes(1.0)]), tmp_path) == 1
    assert scale_of(scene_of(scene_model, tmp_path, soft), tmp_path, min_blur_px=0) == 1


def test_large_sharp_images_stay_as_they_are(scene_model, tmp_path):
    large = cv2.copyMakeBorder(shapes(0.5), 900, 900, 800, 800, cv2.BORDER_REPLICATE)
    model = scene_of(scene_model, tmp_path, [large[:, :1920]] * 2)
    assert scale_of(model, tmp_path) == 1.5  # 2880 px
    large = cv2.copyMakeBorder(shapes(0.5), 900, 900, 1200, 1200, cv2.BORDER_REPLICATE)
    model = scene_of(scene_model, tmp_path, [large] * 2)
    views = (model.views[0], replace(model.views[1], width=2700))
    assert scale_of(replace(model, views=views), tmp_path) == 1  # the second is not even read


def test_image_of_another_size_is_an_error(scene_model, tmp_path):
    model = scene_of(scene_model, tmp_path, [shapes(0.5)] * 2)
    views = (model.views[0], replace(model.views[1], width=SIZE[0] + 1))
    with pytest.raises(ColmapEdgesError, match="its camera 321x240"):
        at_working_scale(replace(model, views=views), tmp_path, OPTIONS)


@pytest.mark.parametrize("scale", [1 / 1.5, 1 / 2, 1 / 2.25])
def test_chains_of_reduced_images_lie_where_they_are(scale):
    points = detect_chains(shapes(2.0), OPTIONS, scale).points / scale
    center, radius = np.array([SIZE[0] / 4, SIZE[1] / 2]), SIZE[1] / 4
    distances = np.linalg.norm(points - center, axis=1) - radius
    on_disc = np.abs(distances) < 2
    assert on_disc.sum() > 0.95 * scale * 2 * np.pi * radius / np.sqrt(2)
    inward = (2.0**2 + (OPTIONS.sigma_px / scale) ** 2) / (2 * radius)  # as blur moves a circle
    assert np.median(distances[on_disc]) == pytest.approx(-inward, abs=0.03)
    low, high = points[on_disc].min(axis=0), points[on_disc].max(axis=0)
    np.testing.assert_allclose((low + high) / 2, center, atol=0.1)
    assert np.abs(distances[on_disc]).max() < 0.35


@pytest.mark.parametrize("scale", [1.25, 1.5, 2.0])
def test_chains_of_enlarged_images_lie_where_they_are(scale):
    image = shapes(0.6)
    points = detect_chains(image, OPTIONS, scale).points / scale
    center, radius = np.array([SIZE[0] / 4, SIZE[1] / 2]), SIZE[1] / 4
    distances = np.linalg.norm(points - center, axis=1) - radius
    on_disc = np.abs(distances) < 2
    assert on_disc.sum() > 0.95 * scale * 2 * np.pi * radius / np.sqrt(2)
    assert abs(np.median(distances[on_disc])) < 0.03
    assert np.abs(distances[on_disc]).max() < 0.25


@pytest.mark.parametrize(
    ("width_px", "most_px"), [(2.0, (0.35, 0.25, 0.15)), (3.0, (0.15, 0.03, 0.02))]
)
def test_edges_of_thin_bars_are_moved_apart_less(width_px, most_px):
    """The blur of the sub-pixel step moves the two edges of a bar apart, by 0.48 px where it is 2
    px wide; that is undone as far as pixels tell, the better the larger they are made.
    """
    image = bars(width_px, pitch_px=12.0)
    edges = (np.arange(1, SIZE[0] // 12 - 1) * 12)[:, None] + [0.5, 0.5 + width_px]
    for scale, most in zip((1.0, 1.5, 2.0), most_px, strict=True):
        x = detect_chains(image, OPTIONS, scale).points[:, :1] / scale
        assert np.median(np.abs(x - edges.ravel()).min(axis=0)) < most


def test_graphs_of_enlarged_views(scene_model, scene_paths):
    """The graph is in pixels of the image, its undistorted pixels in those of the enlarged one."""
    view = scene_model.views[0]
    twice = replace(scene_model, views=(replace(view, scale=2.0),))
    graph = detect_stage(twice, scene_paths[0], PipelineOptions(), Stages()).graphs.load(0)
    image = detect_chains(gray_of(read_image(view, scene_paths[0])), OPTIONS).points
    np.testing.assert_allclose(
        graph.undistorted, 2 * view.undistorted_from_image(graph.points), atol=1e-4
    )
    assert graph.points.max() < max(view.width, view.height)
    assert len(graph.points) > 1.6 * len(image)
    assert (graph.colors.max(axis=0) > 0).all()


def test_a_view_is_the_same_camera_at_every_scale(scene_model):
    view = scene_model.views[0]
    twice = replace(view, scale=2.0)
    points = scene_model.points3D_xyz[:50]
    np.testing.assert_allclose(twice.project(points)[0], view.project(points)[0], atol=1e-9)
    np.testing.assert_allclose(
        twice.project_undistorted(points)[0], 2 * view.project_undistorted(points)[0]
    )


def test_moved_views_keep_their_scale(scene_model):
    model = scene_model.at_scale(1.5)
    still = np.tile(np.eye(3, 4), (len(model.views), 1, 1))
    poses = AdjustedPoses(motions=still, points3D_xyz=model.points3D_xyz)
    moved = moved_model(model, poses)
    assert [view.focal_px for view in moved.views] == [view.focal_px for view in model.views]


def test_edges_of_enlarged_images_end_to_end(scene, scene_paths):
    """Tracks are in pixels of the images as they are; edges lie no worse than without."""
    views = load_model(scene_paths[1]).views
    errors = {}
    for min_blur_px, scale in ((0.0, 1.0), (1.5, 1.5)):
        detection = DetectionOptions(min_blur_px=min_blur_px)
        options = replace(EDGES_ALONE, detection=detection)
        result = reconstruct(scene.reconstruction, scene_paths[0], options)
        assert result.stages[1]["counts"]["image_scale"] == scale
        edges = result.edges
        projected = np.array(
            [
                views[view].project(edges.points[point : point + 1])[0][0]
                for point, view in zip(
                    edges.observations.points, edges.observations.views, strict=True
                )
            ]
        )
        distances = np.linalg.norm(projected - edges.observations.pixels, axis=1)
        np.testing.assert_allclose(distances, result.residuals_px, atol=1e-6)
        assert np.quantile(distances, 0.95) < 0.5
        errors[scale] = np.median(scene.distances(edges.points))
        seen = scene.samples[scene.sample_views >= 3]
        assert np.mean(cKDTree(edges.points).query(seen)[0] < 0.03) > 0.8
    assert errors[1.5] < 1.1 * errors[1.0]


def test_edges_of_images_given_twice_as_large_end_to_end(scene, scene_paths, tmp_path):
    """They are worked on at half that size; tracks are in pixels of the large images."""
    images, _ = scene_paths
    large = pycolmap.Reconstruction(scene.reconstruction)
    for camera in large.cameras.values():
        camera.rescale(2.0)
    for image in large.images.values():
        for point in image.points2D:
            point.xy = 2 * point.xy
        picture = cv2.GaussianBlur(cv2.imread(str(images / image.name)), (0, 0), SOFTENING_PX)
        twice = cv2.resize(picture, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(tmp_path / image.name), twice)
    result = reconstruct(large, tmp_path, EDGES_ALONE)
    scale = result.stages[1]["counts"]["image_scale"]
    assert 1 / 3.5 < scale <= 0.5
    edges, views = result.edges, model_from_reconstruction(large).views
    observed = edges.observations
    projected = np.array(
        [
            views[view].project(edges.points[point : point + 1])[0][0]
            for point, view in zip(observed.points, observed.views, strict=True)
        ]
    )
    distances = np.linalg.norm(projected - observed.pixels, axis=1)
    np.testing.assert_allclose(distances, result.residuals_px, atol=1e-6)
    assert np.quantile(distances, 0.95) < 0.75 / scale  # of these soft images
    assert observed.pixels.max() > max(camera.width for camera in large.cameras.values()) / 2
    assert np.median(scene.distances(edges.points)) < 0.01
    seen = scene.samples[scene.sample_views >= 3]
    assert np.mean(cKDTree(edges.points).query(seen)[0] < 0.03) > 0.7


def test_masks_and_edge_images_of_reduced_views(scene_model, scene_paths, tmp_path):
    """A mask hides what it hides in the given image; edge images may be of either size."""
    view = replace(scene_model.views[0], scale=1 / 1.5)
    one = replace(scene_model, views=(view,))
    masks, maps = tmp_path / "masks", tmp_path / "maps"
    masks.mkdir(), maps.mkdir()
    mask = np.full((view.height, view.width), 255, np.uint8)
    mask[:, : view.width // 2] = 0
    cv2.imwrite(str(masks / f"{view.name}.png"), mask)
    options, images = PipelineOptions(), scene_paths[0]

    def points_of(**folders):
        stages = Stages()
        return detect_stage(one, images, options, stages, **folders).graphs.load(0).points

    whole, masked = points_of(), points_of(mask_path=masks)
    assert whole[:, 0].min() < view.width / 3
    bridged_px = 1.5 * PipelineOptions().edge_graph.max_gap_points
    assert view.width // 2 - bridged_px <= masked[:, 0].min() < masked[:, 0].max() < view.width
    gray = gray_of(read_image(view, images))
    for scale in (1.0, view.scale):
        drawn = np.zeros_like(resized(gray, scale))
        pixels, _ = detect_pixel_chains(resized(gray, scale), 12)
        drawn[tuple(pixels.astype(int).T[::-1])] = 255
        cv2.imwrite(str(maps / f"{view.name}.png"), drawn)
        given = points_of(edge_path=maps)
        assert len(given) > 0.6 * len(whole)
        assert np.median(cKDTree(whole).query(given)[0]) < 0.6
    cv2.imwrite(str(maps / f"{view.name}.png"), drawn[::2, ::2])
    with pytest.raises(ColmapEdgesError, match="edge images need the size"):
        points_of(edge_path=maps)


def test_tolerances_are_in_pixels_of_the_given_images():
    given = PipelineOptions()
    used = resolved(given, 1.5)
    assert used.chain_depth.max_disagreement_px == 1.5 * given.chain_depth.max_disagreement_px
    assert used.refinement.search_radius_px == 1.5 * given.refinement.search_radius_px
    assert used.refinement.max_residual_px == 1.5 * given.refinement.max_residual_px
    assert used.chain_depth.sample_step_points == given.chain_depth.sample_step_points
    assert used.visibility.max_error_px == 1.5 * given.visibility.max_error_px
    assert used.detection == given.detection
    assert resolved(given, 1.0) == given
    assert resolved(given, 0.5) == given  # soft images place features no better


def test_a_report_has_options_as_given_and_settings_as_used(scene_paths, tmp_path):
    images, model = scene_paths
    paths = Paths(image_path=images, input_path=model, output_path=tmp_path / "out")
    options = PipelineOptions(detection=DetectionOptions(min_blur_px=1.5))
    run("detect", paths, options)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["options"] == asdict(options)
    assert report["settings"] == recorded(resolved(options, 1.5)) != report["options"]
    later = report["settings"]["later_rounds"]
    assert later["tracing"] == {"min_agreeing_views": options.tracing.min_agreeing_views - 1}
    assert later["chain_depth"]["min_log_likelihood_ratio"] == 1
