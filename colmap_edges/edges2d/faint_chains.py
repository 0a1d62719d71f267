"""Detection of faint straight edges, whose contrast is below EdgeDrawing's threshold.

Walls and ceilings often differ by a few intensity levels only. Noise and texture of that contrast
form no long straight chains, so faint chains are accepted where they are straight (as in
a-contrario detection of segments; Grompone von Gioi et al. 2010).
"""

from __future__ import annotations

import cv2
import numpy as np

from colmap_edges.core.arrays import (
    Float32Array,
    FloatArray,
    IntArray,
    Picture,
    offsets_of,
    ranges_of,
)
from colmap_edges.edges2d.edge_maps import BRANCH_PX, rescaled
from colmap_edges.images.files import square
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

# Pixels are those of the given image, which is not upsampled: faint edges are blurred anyway.
MAX_SLOPE = 1.8  # EdgeDrawing's own threshold: 11 of Prewitt's sums, which are 6 times the slope
SAMPLE = 4  # spacing of the pixels at which noise is measured
STEPS = 256  # of a gray level a pixel, in 16 bits


def faint_pixel_chains(
    image: Picture, scale: float, pixels: FloatArray, noises: float
) -> tuple[FloatArray, IntArray]:
    """Pixel chains of faint straight edges that are not near the given chains.

    Args:
        image: (H, W) uint8 grayscale, as given.
        scale: upsampling factor of the images in which the chains are used.
        pixels: (N, 2) pixels of EdgeDrawing's chains, in the upsampled image.
        noises: minimum slope of a faint edge, in standard deviations of the image's slopes.

    Returns:
        (M, 2) points in pixels of the upsampled image (OpenCV's origin), and (C + 1,) offsets.
        Empty if noise and texture are as strong as EdgeDrawing's threshold.
    """
    edges = faint_pixels(image, noises)
    if edges is None:
        return np.zeros((0, 2)), np.zeros(1, np.int64)
    taken = np.rint(pixels / scale).astype(np.int64)
    found = np.zeros_like(edges)
    height, width = edges.shape
    found[np.clip(taken[:, 1], 0, height - 1), np.clip(taken[:, 0], 0, width - 1)] = 1
    # Radius around EdgeDrawing's chains, in pixels of the upsampled image.
    radius = round(3.0 / scale)
    edges[cv2.dilate(found, square(radius)) > 0] = 0
    chains = _kernels.link_pixels(without_stairs(edges), BRANCH_PX)
    return rescaled(*straight_stretches(*chains), scale)


def faint_pixels(image: Picture, noises: float) -> Picture | None:
    """(H, W) uint8, nonzero at crests of the gradient above the level of noise and texture.

    None if noise and texture are as strong as EdgeDrawing's threshold.
    """
    # The noise of bands is 0.7 to 1.4 times that of all.
    if noises * noise_of_bands(image) >= 1.5 * MAX_SLOPE:
        return None
    slopes = slopes_of(image)
    noise = noise_of([slope[::SAMPLE, ::SAMPLE] for slope in slopes])
    # Gray levels a pixel: rounding to whole levels makes steps of 0.4.
    limit = STEPS * max(noises * noise, 0.6)
    if limit >= STEPS * MAX_SLOPE:
        return None
    across, down = (
        cv2.addWeighted(slope, STEPS, slope, 0, 0, dtype=cv2.CV_16S) for slope in slopes
    )
    # Hysteresis; Canny: a half to a third.
    return np.asarray(cv2.Canny(across, down, 0.5 * limit, limit, L2gradient=True), np.uint8)


def slopes_of(image: Picture) -> list[Float32Array]:
    """(H, W) slopes of the blurred image (H, W) across and down, in gray levels a pixel."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)
    axes = ((1, 0), (0, 1))
    return [np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *axis, scale=1 / 8)) for axis in axes]


def noise_of(slopes: list[Float32Array]) -> float:
    """Standard deviation of slopes, of which few are edges."""
    # Median absolute deviation of a normal distribution, in standard deviations.
    return float(np.median(np.abs(slopes))) / 0.6745


def noise_of_bands(image: Picture) -> float:
    """Standard deviation of slopes in every eighth 16 rows of the image (H, W), or 0."""
    height, width = image.shape
    bands = image[: height // 16 * 16].reshape(-1, 16, width)[::8]
    if len(bands) == 0:
        return 0.0
    slopes = slopes_of(bands.reshape(-1, width))
    # In the middle of a band, no row beyond it has an effect.
    return noise_of([s.reshape(bands.shape)[:, slice(6, 11, SAMPLE), ::SAMPLE] for s in slopes])


def without_stairs(edges: Picture) -> Picture:
    """The lines (H, W) without the corner pixels of their steps, which would become junctions."""
    padded = np.pad((edges > 0).astype(np.uint8), 1)
    flat, width = padded.reshape(-1), padded.shape[1]
    places = np.flatnonzero(flat)
    for above, below in ((-width, width), (width, -width)):
        for left, right in ((-1, 1), (1, -1)):
            corner = (flat[places + above] & flat[places + left]) > 0
            corner &= (flat[places + below] | flat[places + right]) == 0
            flat[places[corner]] = 0
    return np.ascontiguousarray(padded[1:-1, 1:-1])


def straight_stretches(points: FloatArray, offsets: IntArray) -> tuple[FloatArray, IntArray]:
    """The straight stretches of chains (N, 2), one chain each, and their offsets."""
    # Pixels are rounded, and noise moves them.
    vertices, by_chain = _kernels.douglas_peucker(points, offsets, 1.0)
    starts, ends = vertices[:-1], vertices[1:]
    inner = np.ones(len(starts), bool)
    inner[by_chain[1:-1] - 1] = False  # from one chain to the next
    long = np.linalg.norm(points[ends] - points[starts], axis=1) >= 24.0
    starts, ends = starts[inner & long], ends[inner & long] + 1
    return points[ranges_of(starts, ends)], offsets_of(ends - starts)
