"""The figure of docs/method.md, drawn of the demo scene."""

import cv2
import numpy as np
import pytest
from project import ROOT, run_script

pytestmark = pytest.mark.pipeline  # detection of the demo's edges

ORANGE, BLUE = (0, 120, 255), (200, 110, 40)  # BGR


def near(picture, color):
    return (np.abs(picture.astype(int) - color).max(axis=2) < 40).sum()


def test_every_panel_shows_the_chain_or_its_depths(tmp_path):
    path = tmp_path / "depths.webp"
    demo = ROOT / "tests/data/demo"
    command = ("--image_path", demo / "images", "--input_path", demo / "sparse")
    run_script("draw_method.py", *command, "--output_path", path)
    panels = np.array_split(cv2.imread(str(path)), 3, axis=1)
    assert all(near(panel, ORANGE) > 50 for panel in panels)
    assert [near(panel, BLUE) > 200 for panel in panels] == [True, True, False]
