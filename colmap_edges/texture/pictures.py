"""Pictures of views for textures: decoded colours, and which pixels show the scene."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray, IntArray, Picture
from colmap_edges.core.view import View
from colmap_edges.images.files import (
    alpha_of,
    decode,
    decode_image,
    path_of_image,
    read_bytes,
)
from colmap_edges.images.masks import decode_mask, read_mask

REDUCED = {
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


class Images(NamedTuple):
    """Folders of a model's images and masks.

    Attributes:
        image_path: folder of the images.
        mask_path: folder of the masks, or one mask for all images, or None.
    """

    image_path: Path
    mask_path: Path | None = None

    def full(self, view: View) -> Picture:
        """The image of a view, (H, W, 3) BGR.

        Raises:
            ColmapEdgesError: if it cannot be read.
        """
        path = path_of_image(self.image_path, view.name)
        return decode_image(read_bytes(path), path, view)

    def reduced(self, view: View) -> tuple[Picture, BoolArray]:
        """The reduced image of a view, (h, w, 3) BGR, and (h, w) whether it shows the scene.

        Raises:
            ColmapEdgesError: if it cannot be read.
        """
        path = path_of_image(self.image_path, view.name)
        data = read_bytes(path)
        factor = reduction(view)
        flags = REDUCED[factor] | cv2.IMREAD_IGNORE_ORIENTATION if factor > 1 else None
        image = None if flags is None else cv2.imdecode(data, flags)
        image = decode(data, path) if image is None else image
        return np.asarray(image), self.usable(view, data, image.shape[:2])

    def usable(self, view: View, data: ByteArray, shape: tuple[int, ...]) -> BoolArray:
        """(h, w) whether no pixel of a reduced image is masked or transparent."""
        mask = read_mask(self.mask_path, view.name)
        usable = np.ones(shape, bool)
        for picture in (mask and decode_mask(mask, view), alpha_of(data)):
            if picture is not None:
                open_pixels = (np.asarray(picture) > 0).astype(np.float32)
                smaller = cv2.resize(open_pixels, shape[::-1], interpolation=cv2.INTER_AREA)
                usable &= smaller > 0.999
        return usable


def reduction(view: View) -> int:
    """By which factor the image of a view is reduced when views are compared."""
    longest = max(view.width, view.height)
    # JPEG files are decoded in part only if they are reduced two, four or eight times.
    return next((factor for factor in (8, 4, 2) if longest / factor >= 700), 1)


def resized(image: Picture, scale: float) -> Picture:
    """An image reduced by a scale below 1."""
    if scale >= 1:
        return image
    width, height = scaled_size(image.shape[1], image.shape[0], scale).tolist()
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))


def scaled_size(width: int, height: int, scale: float) -> IntArray:
    """(2,) width and height of an image that is reduced by a scale; at least one pixel."""
    return np.maximum(np.rint(np.array([width, height]) * scale), 1).astype(np.int64)


def scaled_pixels(view: View, pixels: FloatArray, scale: float) -> FloatArray:
    """(N, 2) pixels of the reduced image of a view, of (N, 2) of its image."""
    if scale >= 1:
        return pixels
    return pixels * (scaled_size(view.width, view.height, scale) / [view.width, view.height])
