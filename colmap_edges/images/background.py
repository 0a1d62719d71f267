"""Finds the background in images: a plain backdrop, or what masks hide.

Rays to the background are free space, which no point tells: without them, meshes close the holes of
textureless bodies and span webs between silhouettes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray, Int32Array, IntArray, Picture
from colmap_edges.core.view import View
from colmap_edges.images.files import square

NUM_SAMPLES = 10_000  # of an image, on a grid
MAX_DEVIATION = 3  # gray levels by which a plain backdrop differs from its median, in any channel
MIN_BORDER_RATIO = 0.95  # of the image's border that shows a plain backdrop
MIN_VIEWS_RATIO = 0.9  # of the images that show one, or none is believed
# Bodies as bright as the backdrop have places where they are a little less so. Where none are, what
# the body encloses of the backdrop's colour is seen through a hole.
NEAR_LEVELS = 2  # that such places are off beyond the deviation
MAX_NEAR_RATIO = 1e-3  # of the body, all images together
BORDER_PX = 2  # of the body that is mixed with the backdrop
MAX_MASK_PX = 2000  # side of the mask of a body that is kept


class BackgroundRays(NamedTuple):
    """Rays through free space, to the background.

    Attributes:
        cameras: (K,) int32 index of the view each starts at.
        directions: (K, 3) float64 in the world; their lengths do not matter.
    """

    cameras: Int32Array
    directions: FloatArray


@dataclass(frozen=True, kw_only=True)
class BackgroundMask:
    """The background of one image.

    Attributes:
        packed_body: (h, w') uint8, eight pixels each, of the mask of what is not background.
        body_width: (1,) int64 width of that mask; 0 where no background is seen.
        body_pixels: (2,) int64 of what is not background the number of pixels, and of those
            nearly of its colour.
    """

    packed_body: ByteArray
    body_width: IntArray
    body_pixels: IntArray

    @property
    def is_seen(self) -> bool:
        """Whether there is any."""
        return bool(self.body_width[0])

    def body(self) -> BoolArray:
        """(h, w) the mask of what is not background; the image's size, or smaller."""
        return np.unpackbits(self.packed_body, axis=1, count=int(self.body_width[0])) > 0


NO_BACKGROUND_MASK = BackgroundMask(
    packed_body=np.zeros((0, 0), np.uint8),
    body_width=np.zeros(1, np.int64),
    body_pixels=np.zeros(2, np.int64),
)


def plain_background(image: Picture) -> BackgroundMask:
    """The plain backdrop of an image (H, W, 3) uint8, if the image's border shows nothing else."""
    border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    color = np.rint(np.median(border, axis=0))
    low, high = color - MAX_DEVIATION, color + MAX_DEVIATION
    on_border = ((border >= low) & (border <= high)).all(axis=1)
    if on_border.mean() < MIN_BORDER_RATIO:
        return NO_BACKGROUND_MASK
    plain = cv2.inRange(image, low, high)
    inner = cv2.erode(255 - plain, square(BORDER_PX)) > 0
    if not inner.any():
        return NO_BACKGROUND_MASK  # nothing in view: a blank image rather
    near = cv2.inRange(image, low - NEAR_LEVELS, high + NEAR_LEVELS) > 0
    return kept(plain == 0, np.array([inner.sum(), (inner & near).sum()]))


def masked_background(mask: BoolArray) -> BackgroundMask:
    """The background where the mask (H, W) of what may show edges is false."""
    return NO_BACKGROUND_MASK if mask.all() else kept(mask, np.array([mask.sum(), 0]))


def kept(body: BoolArray, body_pixels: IntArray) -> BackgroundMask:
    """The backdrop around a body (H, W)."""
    factor = min(1.0, MAX_MASK_PX / max(body.shape))
    size = [max(1, round(side * factor)) for side in body.shape[::-1]]
    smaller = cv2.resize(255 * body.astype(np.uint8), size, interpolation=cv2.INTER_AREA) >= 128
    return BackgroundMask(
        packed_body=np.packbits(smaller, axis=1),
        body_width=np.array([smaller.shape[1]]),
        body_pixels=body_pixels,
    )


def background_rays(
    views: Sequence[View], background_masks: Sequence[BackgroundMask], are_masks: bool
) -> BackgroundRays | None:
    """The lines of sight to the background of all views.

    Args:
        views: the V views.
        background_masks: (V,) what their images show of it.
        are_masks: whether masks say so, who are believed each.

    Returns:
        The rays in the order of the views; none where no background is believed to be seen.
    """
    seen = sum(mask.is_seen for mask in background_masks)
    if seen == 0 or not (are_masks or seen >= MIN_VIEWS_RATIO * len(background_masks)):
        return None
    with_holes = shows_holes(background_masks)
    cameras, directions = [], []
    for index, (view, background_mask) in enumerate(zip(views, background_masks, strict=True)):
        if not background_mask.is_seen:
            continue
        body = background_mask.body()
        scale = np.array([view.width, view.height]) / body.shape[::-1]
        rays = view.rays((shown_pixels(body, with_holes) + 0.5) * scale)
        rays = rays[np.isfinite(rays).all(axis=1)]
        cameras.append(np.full(len(rays), index, np.int32))
        directions.append(rays)
    return BackgroundRays(np.concatenate(cameras), np.concatenate(directions))


def shows_holes(background_masks: Sequence[BackgroundMask]) -> bool:
    """Whether what bodies enclose of the backdrop's colour is seen through holes."""
    body, near = np.sum([mask.body_pixels for mask in background_masks], axis=0).tolist()
    return bool(near <= MAX_NEAR_RATIO * body)


def shown_pixels(body: BoolArray, with_holes: bool) -> IntArray:
    """Columns and rows (K, 2) of pixels on a grid that show background, not next to the body.

    Args:
        body: (h, w) what is not background.
        with_holes: whether it also shows where the body encloses it.
    """
    plain = 1 - body.astype(np.uint8)
    inner = cv2.erode(plain, square(1)) > 0
    if not with_holes:
        _, labels = cv2.connectedComponents(plain, connectivity=4)
        outside = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        inner &= np.isin(labels, outside)
    step = max(1, round(float(np.sqrt(body.size / NUM_SAMPLES))))
    rows, columns = np.nonzero(inner[step // 2 :: step, step // 2 :: step])
    return np.column_stack([columns, rows]) * step + step // 2
