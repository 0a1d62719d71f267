"""The figure of docs/method.md, drawn of every second view of the demo scene."""

import cv2
import numpy as np
import pytest
from project import DEMO, part_of_demo, run_script

pytestmark = pytest.mark.pipeline  # detection of the demo's edges

ORANGE, BLUE = (0, 120, 255), (200, 110, 40)  # BGR


def near(picture, color):
    return (np.abs(picture.astype(int) - color).max(axis=2) < 40).sum()


def test_every_panel_shows_the_chain_or_its_depths(tmp_path):
    path, sparse = tmp_path / "depths.webp", part_of_demo(tmp_path / "sparse", 2)
    command = ("--image_path", DEMO / "images", "--input_path", sparse)
    run_script("draw_method.py", *command, "--output_path", path)
    panels = np.array_split(cv2.imread(str(path)), 3, axis=1)
    assert all(near(panel, ORANGE) > 50 for panel in panels)
    assert [near(panel, BLUE) > 200 for panel in panels] == [True, True, False]
