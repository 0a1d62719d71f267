"""Image masks, named as in COLMAP, and alpha channels: no edges in black or transparent areas."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from colmap_edges.core.arrays import BoolArray, Picture
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.files import CompanionFile, first_existing, square

# Margin around masks, since they are drawn roughly and edges at their border belong to the scene.
MARGIN_PX = 3


def path_of_mask(mask_path: Path, name: str) -> Path | None:
    """Path of the mask of the image `name` of a model; None if it has none.

    Args:
        mask_path: a folder, with the mask of a/b.jpg in a/b.jpg.png (of a/b.png also in a/b.png);
            or one file, the mask of all images.
        name: the image's name in the model.

    Raises:
        ColmapEdgesError: when the name leads out of the folder.
    """
    if not mask_path.is_dir():
        return mask_path
    names = [name + ".png", name] if name.lower().endswith(".png") else [name + ".png"]
    return first_existing(mask_path, names)


def check_masks(views: Iterable[View], mask_path: Path) -> None:
    """Check that there are masks, before work starts.

    Raises:
        ColmapEdgesError: if no image has one.
    """
    if not (mask_path.is_dir() or mask_path.is_file()):
        raise ColmapEdgesError(f"mask_path {mask_path} is neither a folder nor a file; give masks")
    names = [view.name for view in views]
    if not any(path_of_mask(mask_path, name) for name in names):
        raise ColmapEdgesError(
            f"mask_path {mask_path} has no mask of any of the {len(names)} images; name them as "
            f"COLMAP does: that of {names[0]} is {names[0]}.png"
        )


def read_mask(mask_path: Path | None, name: str) -> CompanionFile | None:
    """Read the mask of an image, undecoded; None if it has none.

    Raises:
        ColmapEdgesError: if it cannot be read.
    """
    path = mask_path and path_of_mask(mask_path, name)
    return CompanionFile.read("mask", path, name) if path else None


def usable_pixels(mask: CompanionFile | None, alpha: Picture | None, view: View) -> BoolArray:
    """Whether edges of each pixel of a view are used, given its mask or its image's alpha channel.

    Args:
        mask: its mask, undecoded, or None.
        alpha: (H, W) opacities of its image, or None; transparent pixels are masked.
        view: the view.

    Returns:
        (H, W) whether the pixel, or one nearby, is neither black in the mask nor transparent.

    Raises:
        ColmapEdgesError: if the mask cannot be decoded, or does not have its camera's size.
    """
    seen = np.ones((view.height, view.width), np.uint8)
    for picture in (None if mask is None else decode_mask(mask, view), alpha):
        if picture is not None:
            seen &= picture > 0
    return np.asarray(cv2.dilate(seen, square(MARGIN_PX)) > 0)


def decode_mask(file: CompanionFile, view: View) -> Picture:
    """Decode a view's mask, (H, W).

    Raises:
        ColmapEdgesError: if it cannot be decoded, or does not have its camera's size.
    """
    mask = file.decode()
    height, width = mask.shape
    if (width, height) != (view.width, view.height):
        raise ColmapEdgesError(
            f"mask {file.path} is {width}x{height}, the camera of image {view.name} "
            f"{view.width}x{view.height}; give masks of the size of their images"
        )
    return mask
