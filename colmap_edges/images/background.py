"""Detection of the background in images: a plain backdrop, or masked pixels.

Background rays pass through free space that no point constrains. Without them, meshes close the
holes of textureless bodies and connect silhouettes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import cv2
import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray, Int32Array, IntArray, Picture
from colmap_edges.core.checks import check_arrays, check_points
from colmap_edges.core.observations import check_views
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.files import square

NUM_SAMPLES = 10_000  # background rays per image, on a grid
MAX_DEVIATION = 3  # maximum deviation of a plain backdrop from its median, in any channel
MIN_BORDER_RATIO = 0.95  # minimum share of plain pixels in the border of an image
MIN_VIEWS_RATIO = 0.9  # minimum share of images with a backdrop, else it is ignored in all
# A body of the backdrop's colour also has pixels of nearly that colour. If it has none, enclosed
# pixels of the backdrop's colour are holes.
NEAR_LEVELS = 2  # deviation beyond MAX_DEVIATION of pixels of nearly the backdrop's colour
MAX_NEAR_RATIO = 1e-3  # maximum share of such pixels in the body, over all images
BORDER_PX = 2  # width of the mixed pixels around a body
MAX_MASK_PX = 2000  # maximum side of a stored mask


class BackgroundRays(NamedTuple):
    """Rays through free space, to the background.

    Attributes:
        cameras: (K,) int32 index of the view in which each ray starts.
        directions: (K, 3) float64 world directions of any length.
    """

    cameras: Annotated[Int32Array, "K"]
    directions: Annotated[FloatArray, "K", 3]

    def check(self, name: str, num_views: int | None = None) -> None:
        """Check shapes, dtypes and values.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        check_views(f"{name}.cameras", self.cameras, num_views)
        check_points(f"{name}.directions", self.directions)
        if not self.directions.any(axis=1).all():
            raise ColmapEdgesError(f"{name}.directions holds a direction of length 0; leave it out")


@dataclass(frozen=True, kw_only=True)
class BackgroundMask:
    """The background of one image.

    Attributes:
        packed_body: (h, w') uint8 foreground mask, eight pixels per byte.
        body_width: (1,) int64 width of that mask; 0 if no background is seen.
        body_pixels: (2,) int64 number of foreground pixels, and of those nearly of the
            backdrop's colour.
    """

    packed_body: Annotated[ByteArray, "h", "w"]
    body_width: Annotated[IntArray, 1]
    body_pixels: Annotated[IntArray, 2]

    @property
    def is_seen(self) -> bool:
        """Whether the image shows background."""
        return bool(self.body_width[0])

    def body(self) -> BoolArray:
        """(h, w) foreground mask, of the image's size or smaller."""
        return np.unpackbits(self.packed_body, axis=1, count=int(self.body_width[0])) > 0


NO_BACKGROUND_MASK = BackgroundMask(
    packed_body=np.zeros((0, 0), np.uint8),
    body_width=np.zeros(1, np.int64),
    body_pixels=np.zeros(2, np.int64),
)


class Backgrounds(NamedTuple):
    """The background of all views.

    Attributes:
        masks: (V,) of their images; empty without one.
        others: (V,) (h, w) pixels of small pictures whose colours are not those of the backdrop,
            where these are known; else empty.
    """

    masks: Sequence[BackgroundMask] = ()
    others: Sequence[BoolArray] = ()


def plain_background(image: Picture) -> BackgroundMask:
    """The plain backdrop of an image (H, W, 3) uint8, if its border is plain."""
    border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    color = np.rint(np.median(border, axis=0))
    low, high = color - MAX_DEVIATION, color + MAX_DEVIATION
    on_border = ((border >= low) & (border <= high)).all(axis=1)
    if on_border.mean() < MIN_BORDER_RATIO:
        return NO_BACKGROUND_MASK
    plain = cv2.inRange(image, low, high)
    inner = cv2.erode(255 - plain, square(BORDER_PX)) > 0
    if not inner.any():
        return NO_BACKGROUND_MASK  # a blank image
    near = cv2.inRange(image, low - NEAR_LEVELS, high + NEAR_LEVELS) > 0
    return kept(plain == 0, np.array([inner.sum(), (inner & near).sum()]))


def masked_background(mask: BoolArray) -> BackgroundMask:
    """The background given by a mask (H, W) that is false there."""
    return NO_BACKGROUND_MASK if mask.all() else kept(mask, np.array([mask.sum(), 0]))


def kept(body: BoolArray, body_pixels: IntArray) -> BackgroundMask:
    """The background mask of a foreground mask (H, W)."""
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
    """The background rays of all views.

    Args:
        views: the V views.
        background_masks: (V,) background of their images.
        are_masks: whether it comes from user masks, which are always trusted.

    Returns:
        The rays in the order of the views; empty if too few images show a backdrop.
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
    """Whether enclosed pixels of the backdrop's colour are holes of the body."""
    body, near = np.sum([mask.body_pixels for mask in background_masks], axis=0).tolist()
    return bool(near <= MAX_NEAR_RATIO * body)


def shown_pixels(body: BoolArray, with_holes: bool) -> IntArray:
    """(K, 2) columns and rows of background pixels on a grid, away from the foreground.

    Args:
        body: (h, w) foreground mask.
        with_holes: whether enclosed background counts.
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
