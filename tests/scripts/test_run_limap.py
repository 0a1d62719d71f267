"""The input prepared for LIMAP, and LIMAP itself if it is installed."""

import os
import subprocess
import sys

import cv2
import numpy as np
import pycolmap
import pytest
import scenes
from project import SCRIPTS
from run_limap import detect, neighbors, undistorted

from colmap_edges.colmap.model import load_model
from colmap_edges.export import peers


def test_limap_is_given_the_views_that_share_most_points():
    model = scenes.make_scene(num_views=6, width=240, height=180).reconstruction
    seen = {
        index: {point.point3D_id for point in image.points2D if point.has_point3D()}
        for index, image in model.images.items()
    }
    for index, found in neighbors(model, 2).items():
        counts = {other: len(seen[index] & seen[other]) for other in seen if other != index}
        assert len(found) == 2 and index not in found
        assert [counts[i] for i in found] == sorted(counts.values(), reverse=True)[:2]


def test_limap_is_given_the_longest_segments(tmp_path):
    picture = np.zeros((60, 100), np.uint8)
    picture[20:40, 10:90] = 255
    cv2.imwrite(str(tmp_path / "bar.png"), picture)
    found = detect(tmp_path / "bar.png", 2)
    ends = np.sort(found.reshape(2, 2, 2), axis=1)
    np.testing.assert_allclose(np.sort(ends[:, 0, 1]), (20, 40), atol=1)  # its two long sides
    np.testing.assert_allclose(ends[:, 0, 0], 10, atol=2)
    np.testing.assert_allclose(ends[:, 1, 0], 90, atol=2)
    cv2.imwrite(str(tmp_path / "blank.png"), np.zeros((60, 100), np.uint8))
    assert detect(tmp_path / "blank.png", 2).shape == (0, 4)


def test_limap_is_given_undistorted_images(tmp_path, small):
    assert undistorted(*small, tmp_path / "none") == small
    assert not (tmp_path / "none").exists()
    distorted = scenes.make_scene(num_views=2, width=64, height=48, camera_model="SIMPLE_RADIAL")
    images, sparse = undistorted(*distorted.write(tmp_path / "given"), tmp_path / "undistorted")
    model = pycolmap.Reconstruction(sparse)
    assert all(camera.is_undistorted() for camera in model.cameras.values())
    assert {path.name for path in images.iterdir()} == set(distorted.images)


def test_lines_of_limap_are_edges_of_the_scene(scene, scene_paths, tmp_path):
    python = os.environ.get("LIMAP_PYTHON", sys.executable)
    if subprocess.run([python, "-c", "import limap"], capture_output=True).returncode:
        pytest.skip("pylimap is not installed (set LIMAP_PYTHON)")
    paths = ("--image_path", scene_paths[0], "--input_path", scene_paths[1])
    command = [python, SCRIPTS / "run_limap.py", *paths, "--output_path", tmp_path]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    subprocess.run([*command, "--max_segments", "40"], env=environment, check=True)
    found = peers.load(tmp_path, load_model(scene_paths[1]))
    assert found.num_edges > 3
    assert np.median(scene.distances(found.points[::20])) < 0.02
