"""Masks in a folder, and runs that use them."""

from pathlib import Path

import cv2
import numpy as np

from colmap_edges.pipeline.paths import Paths

BLACK_LEFT = np.full((180, 240), 255, np.uint8)
BLACK_LEFT[:, :120] = 0


def write_masks(folder: Path, images: Path, mask=BLACK_LEFT, every=1):
    """A mask for every n-th image, named as COLMAP names them."""
    for image in sorted(images.iterdir())[::every]:
        path = folder / (image.name + ".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)
    return folder


def paths_of(scene, folder, mask_path):
    return Paths(
        image_path=scene[0],
        input_path=scene[1],
        output_path=folder / "out",
        mask_path=mask_path,
    )
