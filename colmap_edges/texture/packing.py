"""Packing of charts into one picture, reduced until they fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.errors import ColmapEdgesError

MARGIN_PX = 2  # pixels around a chart, so that filtering does not mix it with the next one


class Packing(NamedTuple):
    """Places of charts in a picture.

    Attributes:
        scale: the images' scale, at most 1.
        shape: height and width of the picture.
        lows: (K, 2) first column and row of each chart in its reduced image.
        sizes: (K, 2) width and height of each chart.
        places: (K, 2) first column and row of each chart in the picture.
    """

    scale: float
    shape: tuple[int, int]
    lows: IntArray
    sizes: IntArray
    places: IntArray


def packed(boxes: FloatArray, max_side: int) -> Packing:
    """Pack charts into the smallest picture that holds them, or reduce them to the largest one.

    Args:
        boxes: (K, 4) least and largest x and y of each chart in its image, pixels.
        max_side: largest side of the picture, pixels.

    Raises:
        ColmapEdgesError: if the charts are too many for it.
    """
    sides = 2 ** np.arange(8, int(np.log2(max_side)) + 1)
    for side in (*sides[sides < max_side].tolist(), max_side):
        if found := at_scale(boxes, 1.0, side):
            return found
    best, low, high = None, 0.0, 1.0
    for _ in range(8):
        scale = (low + high) / 2
        found = at_scale(boxes, scale, max_side)
        best, low, high = (found, scale, high) if found else (best, low, scale)
    if best is None:
        raise ColmapEdgesError(
            f"{len(boxes):,} charts do not fit into a texture of {max_side} pixels; "
            "raise texture_size, or set it to 0 for a mesh without texture"
        )
    return best


def at_scale(boxes: FloatArray, scale: float, side: int) -> Packing | None:
    """Pack charts at a scale; None if they do not fit."""
    lows = np.floor(boxes[:, :2] * scale).astype(np.int64) - MARGIN_PX
    sizes = np.ceil(boxes[:, 2:] * scale).astype(np.int64) + MARGIN_PX - lows
    if sizes.max(initial=0) > side or sizes.prod(axis=1).sum() > side * side:
        return None
    places, height = on_shelves(sizes, side)
    if height > side:
        return None
    return Packing(scale, (max(height, 1), side), lows, sizes, places)


def on_shelves(sizes: IntArray, side: int) -> tuple[IntArray, int]:
    """(K, 2) places on rows of rectangles sorted by height, and the height of all rows."""
    order = np.argsort(-sizes[:, 1], kind="stable")
    places = np.zeros_like(sizes)
    x = y = height = 0
    for chart, (width, tall) in zip(order.tolist(), sizes[order].tolist(), strict=True):
        if x + width > side:
            x, y, height = 0, y + height, 0
        places[chart] = x, y
        x, height = x + width, max(height, tall)
    return places, y + height
