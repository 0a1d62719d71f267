"""Choice of the working scale, at which edges are blurred by about one pixel.

Detection blurs by one pixel, which pushes the two edges of a thin bar apart and merges closer ones.
Sharp images, such as downsampled photographs, are therefore upsampled, which separates more edges
and localises them better. Images blurred by the lens, by demosaicing or by upsampling hold no
detail at their full resolution; they are downsampled without loss.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Picture, evenly_chosen
from colmap_edges.core.view import View
from colmap_edges.edges2d.blur import WIDEST_PX, blur_of_wide_edges
from colmap_edges.edges2d.detection import detect_chains, resized
from colmap_edges.errors import ImageError
from colmap_edges.images.files import gray_of, read_image
from colmap_edges.options import DetectionOptions

logger = logging.getLogger(__name__)

SCALE_STEP = 0.25  # step of the scale factors
SOFT_BLUR_PX = 1.4  # minimum blur left in downsampled images: that of sharp lenses
MIN_REDUCTION = 2.0  # minimum downsampling; less loses edges and saves little (docs/experiments.md)


def at_working_scale(model: Model, image_path: Path, options: DetectionOptions) -> Model:
    """The model with views scaled according to the blur of their images.

    All images get the same scale. The median blur determines upsampling, the smallest blur
    downsampling, so that no image loses detail.

    Args:
        model: the model; it is not changed.
        image_path: folder of the images.
        options: with the blur below which images are upsampled.

    Raises:
        ColmapEdgesError: if an image does not have its camera's size.
    """
    if options.min_blur_px == 0:
        return model
    largest = max(max(view.width, view.height) for view in model.views)
    # Beyond 1.5, noise breaks chains into pieces; 3200 px is COLMAP's limit for features.
    limit = min(1.5, 3200 / largest)
    blurs = blurs_until_decided(model.views, image_path, options, limit >= 1 + SCALE_STEP)
    scale = scale_for(blurs, limit, options)
    logger.info("edges are blurred by %s px; images are scaled by %g", rounded(blurs), scale)
    return model.at_scale(scale)


def scale_for(blurs: Sequence[float], limit: float, options: DetectionOptions) -> float:
    """The scale for images with these edge blurs, at most `limit`."""
    if not blurs:
        return 1.0
    times = int(min(blurs) / max(SOFT_BLUR_PX, options.min_blur_px) / SCALE_STEP) * SCALE_STEP
    if times >= MIN_REDUCTION:
        return 1 / times
    wanted = options.min_blur_px / float(np.median(blurs))
    steps = int(min(wanted + SCALE_STEP / 2, limit) / SCALE_STEP)
    return max(1.0, steps * SCALE_STEP)


def blurs_until_decided(
    views: Sequence[View], image_path: Path, options: DetectionOptions, may_enlarge: bool
) -> list[float]:
    """Blurs of a few images with edges, in pixels; as many as the decision needs.

    If images are too large for upsampling, one sharp image suffices to keep the scale.
    """
    some = [views[i] for i in evenly_chosen(len(views), 5)]
    blurs = []
    for blur_px in blurs_of(some, image_path, options):
        blurs.append(blur_px)
        if not may_enlarge and blur_px < SOFT_BLUR_PX * MIN_REDUCTION:
            break
    return blurs


def blurs_of(views: Sequence[View], image_path: Path, options: DetectionOptions) -> Iterator[float]:
    """Blurs of the images of these views, without images that show no edges, in pixels."""
    for view in views:
        try:
            blur_px = measure_blur(gray_of(read_image(view, image_path)), options)
        except ImageError:
            continue  # detection reports it
        if blur_px > 0:
            yield blur_px


def measure_blur(gray: Picture, options: DetectionOptions) -> float:
    """The blur of the edges in the central part of an image (H, W) uint8, in pixels.

    It is the standard deviation of the Gaussian that blurs a step as much as the strongest edges;
    0 without edges. Edges too wide for the profiles are measured in the image halved in size, as
    often as necessary.
    """
    side = 1024
    top, left = (max(0, (size - side) // 2) for size in gray.shape)
    crop = np.ascontiguousarray(gray[top : top + side, left : left + side])
    chains = detect_chains(crop, options)
    blur_px = blur_of_wide_edges(crop, chains.points, chains.normals)
    if blur_px <= WIDEST_PX or min(gray.shape) < 64:
        return blur_px
    of_half = 2 * measure_blur(resized(gray, 0.5), options)
    # 0.5 is the standard deviation of two pixels' mean.
    return max(blur_px, float(np.sqrt(max(0.0, of_half**2 - 0.5**2))))


def rounded(blurs: Sequence[float]) -> str:
    """Blurs as text for a log message."""
    return ", ".join(f"{blur:.2f}" for blur in blurs) or "unknown"
