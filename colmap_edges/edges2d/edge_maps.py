"""Pixel chains from the edge images of another detector, instead of EdgeDrawing's.

Binary maps are thinned to lines of single pixels. Probability maps are reduced to their crests
(non-maximum suppression); crests above Otsu's threshold are kept, with connected crests above half
of it (hysteresis, as in Canny 1986).
"""

from __future__ import annotations

import cv2
import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    offsets_of,
    ranks_of,
)
from colmap_edges.images.edge_maps import EdgeMap
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

BRANCH_PX = 6  # length over which directions of the branches of a junction are measured


def pixel_chains_of(
    edge_map: EdgeMap, size: tuple[int, int], scale: float, min_points: int
) -> tuple[FloatArray, IntArray]:
    """Link the pixels of an edge image to chains.

    Args:
        edge_map: edge strengths of an image, or of the upsampled image.
        size: width and height of the image.
        scale: upsampling factor of the image for detection.
        min_points: minimum number of points of a chain.

    Returns:
        (N, 2) points in pixels of the image upsampled `scale` times (OpenCV's origin), one for
        each of its pixels, and their (C + 1,) offsets. Coordinates are integers if the edge image
        has that size.
    """
    edges = edge_map.strengths > 0 if edge_map.is_binary else crests_of(edge_map.strengths)
    pixels, offsets = _kernels.link_pixels(thinned(edges), BRANCH_PX)
    height, width = edges.shape
    ratio = scale * size[0] / width
    if abs(ratio - 1) * max(width, height) >= 1:  # larger than the rounding of the size
        pixels, offsets = rescaled(pixels, offsets, ratio)
    return long_enough(pixels, offsets, min_points)


def thinned(edges: BoolArray) -> BoolArray:
    """(H, W) uint8 lines one pixel wide, the skeleton of the mask (H, W)."""
    padded = np.pad(edges.astype(np.uint8) * 255, 1)  # OpenCV does not thin the border
    thin = cv2.ximgproc.thinning(padded, thinningType=cv2.ximgproc.THINNING_GUOHALL)
    return np.ascontiguousarray(thin[1:-1, 1:-1])


def crests_of(strengths: Float32Array) -> BoolArray:
    """(H, W) mask of pixels with locally maximal edge strength above the threshold."""
    # The first blur moves the crest of a plateau to its middle; the second shows its direction.
    smooth = cv2.GaussianBlur(strengths, (0, 0), 1.0)
    broad = cv2.GaussianBlur(strengths, (0, 0), 2.0)
    xx, xy, yy = (cv2.Sobel(broad, cv2.CV_32F, *order) for order in ((2, 0), (1, 1), (0, 2)))
    along = 0.5 * np.arctan2(2 * xy, xx - yy)  # direction of the larger second derivative
    across_x, across_y = -np.sin(along), np.cos(along)
    is_crest = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy) < 0
    rows, columns = np.indices(strengths.shape, np.float32)
    for side in (-1, 1):
        beside = cv2.remap(
            smooth, columns + side * across_x, rows + side * across_y, cv2.INTER_LINEAR
        )
        is_crest &= smooth >= beside
    return linked_crests(np.where(is_crest, smooth, 0))


def linked_crests(heights: Float32Array) -> BoolArray:
    """(H, W) mask of crests above Otsu's threshold, and of crests connected to them."""
    grays = np.rint(255 * heights / max(float(heights.max()), 1e-12)).astype(np.uint8)
    found = grays[grays > 0]
    if len(found) == 0:
        return np.zeros(heights.shape, bool)
    threshold, _ = cv2.threshold(found, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    # Hysteresis; Canny: 1/2 to 1/3 of the upper threshold.
    above = (grays > 0.5 * threshold).astype(np.uint8)
    count, labels = cv2.connectedComponents(above, connectivity=8)
    strong = np.zeros(count, bool)
    strong[labels[grays > threshold]] = True
    strong[0] = False
    kept: BoolArray = strong[labels]
    return kept


def rescaled(pixels: FloatArray, offsets: IntArray, ratio: float) -> tuple[FloatArray, IntArray]:
    """The chains in pixels `ratio` times as small, with one point per pixel."""
    if len(pixels) == 0:
        return pixels, offsets
    lengths = np.diff(offsets)
    counts = np.where(lengths > 1, np.rint((lengths - 1) * ratio).astype(np.int64) + 1, 1)
    steps = np.repeat((lengths - 1) / np.maximum(counts - 1, 1), counts)
    places = np.repeat(offsets[:-1], counts) + ranks_of(counts) * steps
    every = np.arange(len(pixels))
    points = np.column_stack([np.interp(places, every, axis) for axis in pixels.T])
    return (points + 0.5) * ratio - 0.5, offsets_of(counts)


def long_enough(
    pixels: FloatArray, offsets: IntArray, min_points: int
) -> tuple[FloatArray, IntArray]:
    """The chains with at least `min_points` points."""
    lengths = np.diff(offsets)
    kept = lengths >= min_points
    return pixels[np.repeat(kept, lengths)], offsets_of(lengths[kept])
