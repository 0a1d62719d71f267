"""The scale at which images are worked on: that at which their edges are blurred by about a pixel.

Detection blurs by a pixel, which moves the two edges of a thin bar apart and makes one of edges
that are nearer to each other. Where images are sharp, as small copies of photographs are, pixels
between theirs tell more edges apart and place them better, so they are enlarged. Where the lens, a
demosaicing or an enlargement has blurred them by more, neighbouring pixels say the same: these
images are reduced, which costs nothing that they show.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Picture
from colmap_edges.core.view import View
from colmap_edges.edges2d.blur import WIDEST_PX, blur_of_wide_edges
from colmap_edges.edges2d.detection import detect_chains, resized
from colmap_edges.errors import ImageError
from colmap_edges.images.files import gray_of, read_image
from colmap_edges.options import DetectionOptions

logger = logging.getLogger(__name__)

MAX_SCALE = 1.5  # beyond it, noise breaks chains into pieces
MAX_SIZE_PX = 3200  # of an upsampled image, as large as COLMAP looks at images by itself
SCALE_STEP = 0.25  # images are upsampled and reduced by multiples of it
SOFT_BLUR_PX = 1.4  # that reduced images keep at least: as sharp lenses give in all pixels
MIN_REDUCTION = 2.0  # reducing by less loses edges and saves little (docs/experiments.md)
NUM_IMAGES = 5  # that are measured
CROP_PX = 1024  # side of the middle of an image that is measured
SMALLEST_PX = 64  # side of an image that is halved to measure it
HALVING_BLUR_PX = 0.5  # standard deviation of two pixels' mean, in these pixels


def at_working_scale(model: Model, image_path: Path, options: DetectionOptions) -> Model:
    """The model with views enlarged or reduced as far as their images' sharpness asks for.

    The usual image decides how far all are enlarged, the sharpest how far all are reduced, for
    what it shows would be lost.

    Args:
        model: its views say where the images are; it is not changed.
        image_path: folder of the images.
        options: the blur that is enough.

    Raises:
        ColmapEdgesError: when an image is not of its camera's size.
    """
    if options.min_blur_px == 0:
        return model
    largest = max(max(view.width, view.height) for view in model.views)
    limit = min(MAX_SCALE, MAX_SIZE_PX / largest)
    blurs = blurs_until_decided(model.views, image_path, options, limit >= 1 + SCALE_STEP)
    scale = scale_for(blurs, limit, options)
    logger.info("edges are blurred by %s px; images are scaled by %g", rounded(blurs), scale)
    return model.at_scale(scale)


def scale_for(blurs: Sequence[float], limit: float, options: DetectionOptions) -> float:
    """The scale of images whose edges are blurred by these pixels; none is larger than `limit`."""
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
    """Blurs of a few images that show edges, in pixels: as many as the decision takes.

    Where images are too large to be enlarged, the first that is sharp has them stay as they are.
    """
    every = np.linspace(0, len(views) - 1, min(NUM_IMAGES, len(views))).astype(int)
    blurs = []
    for blur_px in blurs_of([views[i] for i in every], image_path, options):
        blurs.append(blur_px)
        if not may_enlarge and blur_px < SOFT_BLUR_PX * MIN_REDUCTION:
            break
    return blurs


def blurs_of(views: Sequence[View], image_path: Path, options: DetectionOptions) -> Iterator[float]:
    """Blurs of the images of these views that show edges, in pixels."""
    for view in views:
        try:
            blur_px = measure_blur(gray_of(read_image(view, image_path)), options)
        except ImageError:
            continue  # detection tells of it
        if blur_px > 0:
            yield blur_px


def measure_blur(gray: Picture, options: DetectionOptions) -> float:
    """How much the edges in the middle of an image (H, W) uint8 are blurred, in pixels.

    The standard deviation of the Gaussian that makes steps as steep as the strongest edges are;
    0 where there are none. Edges too wide for the profiles across them are measured in the image
    reduced to half its size, and so on.
    """
    top, left = (max(0, (size - CROP_PX) // 2) for size in gray.shape)
    crop = np.ascontiguousarray(gray[top : top + CROP_PX, left : left + CROP_PX])
    chains = detect_chains(crop, options)
    blur_px = blur_of_wide_edges(crop, chains.points, chains.normals)
    if blur_px <= WIDEST_PX or min(gray.shape) < SMALLEST_PX:
        return blur_px
    of_half = 2 * measure_blur(resized(gray, 0.5), options)
    return max(blur_px, float(np.sqrt(max(0.0, of_half**2 - HALVING_BLUR_PX**2))))


def rounded(blurs: Sequence[float]) -> str:
    """Blurs, for a message."""
    return ", ".join(f"{blur:.2f}" for blur in blurs) or "unknown"
