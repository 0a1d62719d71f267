"""Smooth regions of small pictures that reach their border and hold no structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    Picture,
    offsets_of,
    order_of,
    parts_of,
)
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View, cells_seen
from colmap_edges.images.files import square

PICTURE_PX = 320  # longer side of a small picture
BLUR_PX = 1.0  # standard deviation of the blur before gradients are taken
SMOOTH_LEVELS = 4.0  # maximum gradient of a smooth region, levels per pixel
NEAR_PX = 2  # distance from projected points within which pixels count as structure
PLAIN_LEVELS = 1.5  # ... if there is structure above it
PASSAGE_PX = 3  # narrower passages do not connect regions, in radii
MIN_AREA = 0.002  # minimum share of a picture that a region covers
NUM_POINTS = 20_000  # maximum number of points projected to every view


@dataclass(frozen=True, kw_only=True)
class Regions:
    """Smooth regions of all views; numbered through all of them.

    Attributes:
        pictures: (V,) small pictures, (h, w, 3) uint8 BGR, distorted as the images.
        labels: (V,) (h, w) int32 region of each pixel, -1 where there is none.
        near: (V,) (h, w) bool pixels near structure.
        views: (R,) view of each region.
        below: (R,) whether there is structure above them.
    """

    pictures: Sequence[Picture]
    labels: Sequence[Int32Array]
    near: Sequence[BoolArray]
    views: IntArray
    below: BoolArray

    @property
    def at_border(self) -> BoolArray:
        """(R,) whether they reach the border of their picture."""
        borders = [(of[0], of[-1], of[:, 0], of[:, -1]) for of in self.labels]
        return np.isin(
            np.arange(len(self.views)), np.concatenate([np.hstack(of) for of in borders])
        )

    def pixels(self, view: int) -> tuple[IntArray, list[IntArray]]:
        """The regions of a view, and the indices of their pixels in its flattened picture."""
        own = np.flatnonzero(self.views == view)
        labels = self.labels[view].ravel()
        inside = np.flatnonzero(labels >= 0)
        numbers = labels[inside] - (own[0] if len(own) else 0)
        counts = np.bincount(numbers, minlength=len(own))
        return own, parts_of(inside[order_of(numbers, len(own))], offsets_of(counts))

    def shown(self, chosen: BoolArray) -> list[BoolArray]:
        """(V,) (h, w) pixels of the (R,) chosen regions."""
        of_region = np.append(chosen, False)  # the last one stands for pixels of no region
        return [of_region[labels] for labels in self.labels]


def small_picture(view: View, image: Picture, usable: object = None) -> Picture:
    """The image (H, W, 3) of a view reduced to `PICTURE_PX`; smaller images stay as they are."""
    factor = min(1.0, PICTURE_PX / max(image.shape[:2]))
    size = [max(1, round(side * factor)) for side in image.shape[1::-1]]
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def small_pixels(view: View, picture: Picture, points: FloatArray) -> tuple[IntArray, IntArray]:
    """Indices of the (N, 3) points in a view's image, and of their pixels in its picture."""
    seen, rows, columns = cells_seen(view, points, picture.shape)
    return seen, rows * picture.shape[1] + columns


def rays_of(view: View, picture: Picture, pixels: IntArray) -> FloatArray:
    """(n, 3) unit viewing rays of (n,) pixels of a view's flattened picture; or NaN."""
    rows, columns = np.divmod(pixels, picture.shape[1])
    scale = np.array(picture.shape[1::-1]) / (view.width, view.height)
    return unit(view.rays((np.column_stack([columns, rows]) + 0.5) / scale))


def find_regions(
    views: Sequence[View],
    pictures: Mapping[int, Picture],
    points: FloatArray,
    observed: Sequence[IntArray],
    up: FloatArray,
) -> Regions:
    """Find the smooth regions of all views that reach the border of their pictures.

    Structure are points, wherever they project: what a view does not see of them, something nearer
    hides. Regions with structure above them end there, so that none is a part of the sky and a part
    of a wall of its colour.

    Args:
        views: the V views.
        pictures: small pictures by index of the view; views without one have no regions.
        points: (N, 3) points of surfaces.
        observed: (V,) indices of the points that each view observes.
        up: (3,) upward direction.
    """
    everywhere = points[:: -(-len(points) // NUM_POINTS) or 1]
    blank = np.zeros((1, 1, 3), np.uint8)
    given, labels, nears = [], [], []
    owners: list[int] = []
    is_below: list[bool] = []
    for index, (view, own) in enumerate(zip(views, observed, strict=True)):
        picture = pictures.get(index, blank)
        near = np.zeros(picture.shape[:2], np.uint8)
        for part in (everywhere, points[own]):
            near.ravel()[small_pixels(view, picture, part)[1]] = 1
        near = cv2.dilate(near, square(NEAR_PX)) > 0
        below = below_structure(near, angle_of(view, up))
        regions, counts = smooth_regions(picture, near, below)
        labels.append(np.where(regions >= 0, regions + len(owners), -1).astype(np.int32))
        given.append(picture)
        nears.append(near)
        owners += [index] * sum(counts)
        is_below += [False] * counts[0] + [True] * counts[1]
    return Regions(
        pictures=given,
        labels=labels,
        near=nears,
        views=np.array(owners, np.int64),
        below=np.array(is_below, bool),
    )


def angle_of(view: View, up: FloatArray) -> float:
    """Angle from the top of a view's image to the upward direction (3,), clockwise, radians."""
    x, y, _ = view.rotation @ up
    return float(np.arctan2(x, -y))


def below_structure(near: BoolArray, angle: float) -> BoolArray:
    """(h, w) pixels with structure above them; up is at an angle from the top, clockwise."""
    height, width = near.shape
    side = int(np.ceil(np.hypot(height, width)))
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), np.degrees(angle), 1.0)
    turn[:, 2] += (side - width) / 2, (side - height) / 2
    upright = cv2.warpAffine(near.astype(np.uint8), turn, (side, side))
    shadow = np.maximum.accumulate(upright)
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(shadow, turn, (width, height), flags=flags) > 0)


def smooth_regions(
    picture: Picture, near: BoolArray, below: BoolArray
) -> tuple[Int32Array, list[int]]:
    """Find the smooth regions of a picture (h, w, 3), above structure and below it.

    Args:
        picture: the small picture.
        near: (h, w) pixels near structure.
        below: (h, w) pixels with structure above them.

    Returns:
        (h, w) region of each pixel, -1 where there is none, and the numbers of both kinds.
    """
    blurred = cv2.GaussianBlur(picture, (0, 0), BLUR_PX).astype(np.float32)
    slopes = [cv2.Scharr(blurred, cv2.CV_32F, *order) / 32 for order in ((1, 0), (0, 1))]
    steep = np.maximum.reduce(cv2.split(np.hypot(*slopes)))
    regions = np.full(steep.shape, -1, np.int32)
    counts: list[int] = []
    for part, limit in ((~below, SMOOTH_LEVELS), (below, PLAIN_LEVELS)):
        smooth = ((steep < limit) & part & ~near).astype(np.uint8)
        smooth = cv2.morphologyEx(smooth, cv2.MORPH_OPEN, square(PASSAGE_PX))
        _, labels, stats, _ = cv2.connectedComponentsWithStats(smooth, connectivity=4)
        sizes = stats[:, cv2.CC_STAT_AREA]
        kept = 1 + np.flatnonzero(sizes[1:] >= MIN_AREA * labels.size)
        numbers = np.full(len(sizes), -1, np.int32)
        numbers[kept] = np.arange(sum(counts), sum(counts) + len(kept))
        regions = np.maximum(regions, numbers[labels])
        counts.append(len(kept))
    return regions, counts
