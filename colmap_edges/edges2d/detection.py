"""Detection of sub-pixel edge chains in an image (paper: 2D Edge-Graphs).

Pixel chains come from EdgeDrawing (Topal and Akinlar 2012, parameter free) and, where edges are
faint but straight, from `faint_chains`. Each pixel is then moved along its normal to the steepest
position of the linearised intensity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import cv2
import numpy as np

from colmap_edges.core.arrays import (
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    Picture,
    RaggedTable,
    offsets_of,
)
from colmap_edges.edges2d.blur import blur_of_edges
from colmap_edges.edges2d.faint_chains import faint_pixel_chains
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import DetectionOptions

_Picture = TypeVar("_Picture", Picture, Float32Array)
LIGHT_STEPS = 1 << 16  # fine enough to restore dark intensities


@dataclass(frozen=True, kw_only=True)
class Chains(RaggedTable):
    """Edge chains of one image: 8-connected pixel sequences at sub-pixel positions.

    Attributes:
        points: (N, 2) float64 image pixels, COLMAP's origin; one chain's are contiguous.
        normals: (N, 2) float64 unit gradient directions, dark to bright.
        sides: (N, 2) uint8 intensity on the dark and on the bright side of the edge.
        offsets: (C + 1,) int64; chain c is points[offsets[c]:offsets[c + 1]].
    """

    points: FloatArray
    normals: FloatArray
    sides: ByteArray


def detect_chains(
    image: Picture,
    options: DetectionOptions,
    scale: float = 1.0,
    pixel_chains: tuple[FloatArray, IntArray] | None = None,
) -> Chains:
    """Detect the edge chains of a grayscale image.

    Args:
        image: (H, W) uint8 grayscale.
        options: minimum chain length, gamma and blur.
        scale: upsampling factor; below 1 the image is downsampled.
        pixel_chains: chains of another detector to use instead of these: (N, 2) pixels of
            the upsampled image (OpenCV's origin) and (C + 1,) offsets.

    Returns:
        Chains at sub-pixel positions of the upsampled image, in the detector's order.
    """
    light = resized(light_of(image, options.gamma), scale)
    given, image = image, resized(image, scale)
    pixels, offsets = pixel_chains or own_pixel_chains(given, image, scale, options)
    cv2.GaussianBlur(light, (0, 0), options.sigma_px, dst=light)
    points, normals = _kernels.refine_subpixel(light, pixels)
    if pixel_chains:
        points, normals = followed_further(light, pixels, points, normals)
    # Upper limit of the blur by which displacements by nearby edges are corrected: 2 px.
    blur_px = min(blur_of_edges(image, points + 0.5, normals), 2.0)
    blur_px = float(np.hypot(options.sigma_px, blur_px))
    points = _kernels.undo_displacement(light, points, normals, blur_px)
    table = gray_table(options.gamma)
    sides = _kernels.sample_sides(light, points, normals, 3.0, table)  # 3 px from the edge
    return Chains(
        points=points + 0.5,
        normals=normals,
        sides=sides,
        offsets=offsets,
    )


def followed_further(
    light: Float32Array, pixels: FloatArray, points: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points and normals, refined again where the edge is more than a pixel from its pixel.

    EdgeDrawing's pixels are maxima of the image's gradient; those of other detectors, learned ones
    in particular, can be farther off.
    """
    far = np.linalg.norm(points - pixels, axis=1) > 1.0 - 1e-6  # as far as it goes
    points[far], normals[far] = _kernels.refine_subpixel(light, points[far])
    return points, normals


def resized(picture: _Picture, scale: float) -> _Picture:
    """The picture (H, W) resized: pixel (x, y) moves to `scale` times (x, y).

    Pixels of a downsampled picture are means over their area, which reduces noise.
    """
    if scale == 1:
        return picture
    method = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    return np.asarray(
        cv2.resize(picture, None, fx=scale, fy=scale, interpolation=method), picture.dtype
    )


def light_of(image: Picture, gamma: float) -> Float32Array:
    """(H, W) linear intensity, 0 to 1, of a uint8 image (H, W).

    Pixels integrate light, which is then gamma encoded. The encoded value of a pixel half bright
    and half dark is far above the mean, so encoded edges are displaced up to 0.2 px to the dark.
    """
    return np.asarray(cv2.LUT(image, light_table(gamma)), np.float32)


@cache
def light_table(gamma: float) -> Float32Array:
    """(256,) linear intensity of each encoded value."""
    return ((np.arange(256) / 255) ** gamma).astype(np.float32)


@cache
def gray_table(gamma: float) -> ByteArray:
    """(LIGHT_STEPS + 1,) uint8 encoded value of linear intensity; inverse of `light_table`."""
    steps = np.arange(LIGHT_STEPS + 1) / LIGHT_STEPS
    return np.asarray(np.round(255 * steps ** (1 / gamma)), np.uint8)


def own_pixel_chains(
    image: Picture, upsampled: Picture, scale: float, options: DetectionOptions
) -> tuple[FloatArray, IntArray]:
    """EdgeDrawing's chains and faint straight ones, as `detect_pixel_chains` returns them.

    Args:
        image: (H, W) uint8 grayscale, as given.
        upsampled: the same at the working scale, whose pixels the chains have.
        scale: how many times it is upsampled.
        options: minimum chain length, and slope of faint edges.
    """
    pixels, offsets = detect_pixel_chains(upsampled, options.min_chain_points)
    if not options.faint_noises:
        return pixels, offsets
    faint, of_faint = faint_pixel_chains(image, scale, pixels, options.faint_noises)
    return np.concatenate([pixels, faint]), np.concatenate([offsets, offsets[-1] + of_faint[1:]])


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
