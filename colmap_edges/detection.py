"""Image -> sub-pixel edge chains (paper: 2D Edge-Graphs).

Pixel chains come from EdgeDrawing (Topal and Akinlar 2012, parameter free); each pixel is then
moved to the maximum of the gradient along its normal, where the accuracy of all that follows
starts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from colmap_edges.array_types import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    Picture,
)
from colmap_edges.csr import offsets_of
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import DetectionOptions

SIDE_DISTANCE_PX = 3.0  # from the edge to where the gray of its sides is taken
REMAP_WIDTH = 1 << 14


@dataclass(frozen=True, kw_only=True)
class Chains:
    """Edge chains of one image: 8-connected pixel sequences at sub-pixel positions.

    Attributes:
        points: (N, 2) float64 image pixels, COLMAP's origin; one chain's are contiguous.
        normals: (N, 2) float64 unit gradient directions, dark to bright.
        sides: (N, 2) uint8 gray on the dark and on the bright side of the edge.
        offsets: (C + 1,) int64; chain c is points[offsets[c]:offsets[c + 1]].
    """

    points: FloatArray
    normals: FloatArray
    sides: ByteArray
    offsets: IntArray

    def select(self, index: BoolArray | IntArray, lengths: IntArray) -> Chains:
        """The points at a numpy index, cut into chains of these lengths."""
        return Chains(
            points=self.points[index],
            normals=self.normals[index],
            sides=self.sides[index],
            offsets=offsets_of(lengths),
        )


def detect_chains(image: Picture, options: DetectionOptions) -> Chains:
    """Detect the edge chains of a grayscale image.

    Args:
        image: (H, W) uint8 grayscale.
        options: shortest chain and blur.

    Returns:
        Chains at sub-pixel positions, in the detector's order.
    """
    pixels, offsets = detect_pixel_chains(image, options.min_chain_length_px)
    blurred = cv2.GaussianBlur(image, (0, 0), options.sigma_px)
    gradient_x = cv2.Sobel(blurred, cv2.CV_16S, 1, 0)
    gradient_y = cv2.Sobel(blurred, cv2.CV_16S, 0, 1)
    points, normals = _kernels.refine_subpixel(gradient_x, gradient_y, pixels)
    gray = blurred.astype(np.float32)  # bytes would be sampled less exactly
    dark, bright = (
        sample_gray(gray, points + distance * normals)
        for distance in (-SIDE_DISTANCE_PX, SIDE_DISTANCE_PX)
    )
    return Chains(
        points=points + 0.5,
        normals=normals,
        sides=np.column_stack([dark, bright]),
        offsets=offsets,
    )


def sample_gray(image: Float32Array, pixels: FloatArray) -> ByteArray:
    """(N,) gray at (N, 2) sub-pixel positions (OpenCV's origin), that of the border outside."""
    count = len(pixels)
    if count == 0:
        return np.zeros(0, np.uint8)
    rows = -(-count // REMAP_WIDTH)  # remap takes no more columns than that
    at = np.zeros((rows * REMAP_WIDTH, 2), np.float32)
    at[:count] = pixels
    maps = at.reshape(rows, REMAP_WIDTH, 2)
    gray = cv2.remap(image, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(np.clip(np.round(gray.ravel()[:count]), 0, 255), np.uint8)


def detect_pixel_chains(image: Picture, min_length_px: int) -> tuple[FloatArray, IntArray]:
    """(N, 2) pixels (OpenCV's origin) of EdgeDrawing's chains and their (C + 1,) offsets."""
    detector = cv2.ximgproc.createEdgeDrawing()
    parameters = cv2.ximgproc.EdgeDrawing.Params()
    parameters.PFmode = True
    parameters.MinPathLength = min_length_px
    detector.setParams(parameters)
    detector.detectEdges(image)
    segments = [np.asarray(s).reshape(-1, 2) for s in detector.getSegments()]
    chains = [s for s in segments if len(s) >= min_length_px]
    offsets = offsets_of(np.array([len(c) for c in chains], np.int64))
    pixels = np.concatenate(chains) if chains else np.zeros((0, 2))
    return pixels.astype(np.float64), offsets
