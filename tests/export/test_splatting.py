"""What loaders of Gaussian splatting trainers take for granted about a COLMAP model.

They read the binary files byte by byte as COLMAP 3 documents them, start from points3D with
their colours, and know cameras without distortion only.
"""

import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import EDGES_ALONE

from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

PINHOLE = 1  # COLMAP's id of the camera model


class Reader:
    """Reads little-endian numbers one after the other."""

    def __init__(self, path):
        self.data, self.at = path.read_bytes(), 0

    def take(self, kinds):
        values = struct.unpack_from("<" + kinds, self.data, self.at)
        self.at += struct.calcsize("<" + kinds)
        return values

    def text(self):
        end = self.data.index(b"\0", self.at)
        start, self.at = self.at, end + 1
        return self.data[start:end].decode()

    @property
    def is_done(self):
        return self.at == len(self.data)


def read_points(path):
    reader = Reader(path)
    points = {}
    for _ in range(*reader.take("Q")):
        point_id, *values = reader.take("QdddBBBd")
        track = reader.take("2I" * reader.take("Q")[0])
        points[point_id] = (np.array(values[:3]), values[3:6], values[6], track)
    assert reader.is_done
    return points


def read_images(path):
    reader = Reader(path)
    images = {}
    for _ in range(*reader.take("Q")):
        image_id, *pose, camera_id = reader.take("I7dI")
        name = reader.text()
        rows = [reader.take("ddq") for _ in range(*reader.take("Q"))]
        images[image_id] = (pose, camera_id, name, rows)
    assert reader.is_done
    return images


@pytest.fixture(scope="module")
def model(scene_paths, tmp_path_factory):
    output = tmp_path_factory.mktemp("splatting") / "out"
    paths = Paths(image_path=scene_paths[0], input_path=scene_paths[1], output_path=output)
    run("reconstruct", paths, replace(EDGES_ALONE, report=False))
    return output / "sparse"


def test_points_have_colours_errors_and_tracks(model, scene):
    points = read_points(model / "points3D.bin")
    count = scene.reconstruction.num_points3D()
    edge_points = [points[key] for key in sorted(points)[count:]]
    assert len(edge_points) > 500
    assert all(np.isfinite(xyz).all() and 0 <= error < 5 for xyz, _, error, _ in edge_points)
    assert all(len(track) >= 2 * 3 for *_, track in edge_points)
    colors = np.array([rgb for _, rgb, _, _ in edge_points])
    assert (np.ptp(colors, axis=1) == 0).all()  # the scene is grey
    assert np.ptp(colors[:, 0]) > 50  # but not all alike


def test_cameras_are_as_they_were(model, scene):
    reader = Reader(model / "cameras.bin")
    assert reader.take("Q") == (1,)
    assert reader.take("IiQQ") == (1, PINHOLE, 480, 360)
    np.testing.assert_array_equal(reader.take("4d"), scene.reconstruction.cameras[1].params)
    assert reader.is_done


def test_tracks_and_images_name_each_other(model, scene_paths):
    points, images = read_points(model / "points3D.bin"), read_images(model / "images.bin")
    assert len(images) == 10
    for _, camera_id, name, _ in images.values():
        assert camera_id == 1
        assert cv2.imread(str(scene_paths[0] / name)) is not None
    for point_id, (*_, track) in points.items():
        for image_id, index in zip(track[::2], track[1::2], strict=True):
            assert images[image_id][3][index][2] == point_id
    observed = sum(row[2] != -1 for *_, rows in images.values() for row in rows)
    assert observed == sum(len(track) // 2 for *_, track in points.values())
