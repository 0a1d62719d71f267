"""The demo's images through other lenses give the same edges."""

import copy
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from project import DEMO
from scenes import EDGES_ALONE, resample
from scipy.spatial import cKDTree

import colmap_edges
from colmap_edges.colmap.model import model_from_reconstruction

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

NUM_VIEWS = 8  # of the low arc
WIDTH, HEIGHT = 512, 384
DEPTH_PX = 50.0  # pixels off to the side that weigh as much as a depth e times as large
# Parameters after focal length(s) and principal point, and the focal length in parts of the
# pinhole's, such that no pixel looks beyond the borders of the photograph.
LENSES = {
    "PINHOLE": ((), 1.0),
    "OPENCV": ((-0.12, 0.04, 0.002, -0.0015), 1.0),
    "OPENCV_FISHEYE": ((0.02, -0.03, 0.01, -0.002), 1.12),
}


def make_camera(lens, focal):
    """A camera of half the demo's size."""
    params, factor = LENSES[lens]
    camera = pycolmap.Camera.create_from_model_name(1, lens, focal * factor, WIDTH, HEIGHT)
    plain = len(camera.params) - len(params)
    camera.params = [*camera.params[:plain], *params]
    return camera


def source_pixels(camera, source):
    """(H, W, 2) float32 place of each pixel of `camera` in the image of `source`; for OpenCV."""
    rows, columns = np.indices((HEIGHT, WIDTH))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]) + 0.5
    rays = np.asarray(camera.cam_from_img(pixels))
    found = np.asarray(source.img_from_cam(np.column_stack([rays, np.ones(len(rays))])))
    return (found - 0.5).reshape(HEIGHT, WIDTH, 2).astype(np.float32)


def through_lens(lens, folder):
    """Reconstruction and folder of images of the demo as a camera with this lens sees it."""
    reconstruction = pycolmap.Reconstruction(str(DEMO / "sparse"))
    source = copy.copy(reconstruction.cameras[1])
    camera = make_camera(lens, 0.5 * source.mean_focal_length() * 1.08)
    maps = source_pixels(camera, source)
    assert (maps >= 0).all() and (maps <= (source.width - 1, source.height - 1)).all()
    images = sorted(reconstruction.images.values(), key=lambda image: image.name)
    for image in images[NUM_VIEWS:]:
        reconstruction.deregister_frame(image.frame_id)
    for image in images[:NUM_VIEWS]:
        picture = cv2.imread(str(DEMO / "images" / image.name))
        blurred = cv2.GaussianBlur(picture, (0, 0), 0.7)  # half the size follows
        seen = cv2.remap(blurred, maps, None, cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / Path(image.name).with_suffix(".png")), seen)
        rays = np.asarray(source.cam_from_img(np.array([p.xy for p in image.points2D])))
        pixels = np.asarray(camera.img_from_cam(np.column_stack([rays, np.ones(len(rays))])))
        for point, xy in zip(image.points2D, pixels, strict=True):
            point.xy = xy
    for image in images:
        image.name = str(Path(image.name).with_suffix(".png"))
    replace_camera(reconstruction.cameras[1], camera)
    return reconstruction, folder


def replace_camera(old, new):
    old.model, old.width, old.height = new.model, new.width, new.height
    old.params = new.params


@pytest.fixture(scope="module")
def pinhole(tmp_path_factory):
    scene = through_lens("PINHOLE", tmp_path_factory.mktemp("pinhole"))
    return colmap_edges.reconstruct(*scene, EDGES_ALONE)


def nearest_px(result, other, views):
    """Distances in pixels of the edges of one result from those of another, in each view.

    Each edge point is compared in the views that observe it with what is near to it and about as
    far away: a line of sight is long, and other edges cross it.
    """
    lines = np.concatenate(
        [
            resample(edges.points[a:b], 0.005)
            for edges in (other.edges, other.contours)  # near the limit a curve may be either
            for a, b in zip(edges.edge_offsets[:-1], edges.edge_offsets[1:], strict=True)
        ]
    )
    owners = np.repeat(
        np.arange(result.edges.num_points), np.diff(result.edges.observations.offsets)
    )
    distances = []
    for index, view in enumerate(views):
        observed = result.edges.points[owners[result.edges.observations.views == index]]
        places, targets = (
            np.column_stack([pixels, DEPTH_PX * np.log(depths)])
            for pixels, depths in (view.project(observed), view.project(lines))
        )
        nearest = cKDTree(targets).query(places)[1]
        distances.append(np.linalg.norm((places - targets[nearest])[:, :2], axis=1))
    return np.concatenate(distances)


@pytest.mark.parametrize("lens", [lens for lens in LENSES if lens != "PINHOLE"])
def test_edges_agree_with_those_of_a_pinhole(lens, pinhole, tmp_path):
    reconstruction, images = through_lens(lens, tmp_path)
    result = colmap_edges.reconstruct(reconstruction, images, EDGES_ALONE)
    assert result.edges.num_points > 0.8 * pinhole.edges.num_points > 800
    assert np.median(result.residuals_px) < 0.3
    views = model_from_reconstruction(pinhole.reconstruction).views
    assert len(views) == NUM_VIEWS
    for distances in (nearest_px(result, pinhole, views), nearest_px(pinhole, result, views)):
        assert np.median(distances) < 0.3
        assert np.mean(distances < 1) > 0.8
