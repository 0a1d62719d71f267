"""Image masks, named as COLMAP names them; no edges are detected where a mask is black."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.images.files import GRAY, first_there, read_bytes, square

# An edge along the border of a mask belongs to what is seen beside it, and masks are drawn roughly.
MARGIN_PX = 3


@dataclass(frozen=True)
class MaskFile:
    """The mask of an image, as it is read.

    Attributes:
        path: where it is.
        data: (B,) uint8 the file's bytes.
    """

    path: Path
    data: ByteArray


def path_of_mask(mask_path: Path, name: str) -> Path | None:
    """Path of the mask of the image `name` of a model, none where it has none.

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
    return first_there(mask_path, names)


def check_masks(views: Iterable[View], mask_path: Path) -> None:
    """Check that there are masks, before work starts.

    Raises:
        ColmapEdgesError: when no image has one.
    """
    if not (mask_path.is_dir() or mask_path.is_file()):
        raise ColmapEdgesError(f"mask_path {mask_path} is neither a folder nor a file")
    names = [view.name for view in views]
    if not any(path_of_mask(mask_path, name) for name in names):
        raise ColmapEdgesError(
            f"mask_path {mask_path} has no mask of any of the {len(names)} images; name them as "
            f"COLMAP does: that of {names[0]} is {names[0]}.png"
        )


def read_mask(mask_path: Path | None, name: str) -> MaskFile | None:
    """Read the mask of an image as it is; none where it has none.

    Raises:
        ColmapEdgesError: when it cannot be read.
    """
    path = mask_path and path_of_mask(mask_path, name)
    if not path:
        return None
    try:
        return MaskFile(path, read_bytes(path))
    except ImageError as error:
        raise unreadable_mask(path, name) from error


def unreadable_mask(path: Path, name: str) -> ColmapEdgesError:
    """Make the error for a mask that is no picture: not an `ImageError`, which skips the image."""
    return ColmapEdgesError(f"cannot read mask {path} of image {name}; replace or delete it")


def decode_mask(file: MaskFile, view: View) -> BoolArray:
    """Decode a view's mask.

    Returns:
        (H, W) whether a pixel may show edges: it, or one near by, is not black.

    Raises:
        ColmapEdgesError: when that cannot be done, or it is not of its camera's size.
    """
    mask = cv2.imdecode(file.data, GRAY) if len(file.data) else None
    if mask is None:
        raise unreadable_mask(file.path, view.name)
    height, width = mask.shape
    if (width, height) != (view.width, view.height):
        raise ColmapEdgesError(
            f"mask {file.path} is {width}x{height}, the camera of image {view.name} "
            f"{view.width}x{view.height}; masks need the size of their images"
        )
    return np.asarray(cv2.dilate((mask > 0).astype(np.uint8), square(MARGIN_PX)) > 0)
