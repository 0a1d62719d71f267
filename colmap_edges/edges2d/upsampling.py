"""How much images are upsampled before their edges are detected: until those are blurred enough.

Detection blurs by a pixel, which moves the two edges of a thin bar apart and makes one of edges
that are nearer to each other. Where images are sharp, as small copies of photographs are, pixels
between theirs tell more edges apart and place them better; where the lens or a demosaicing has
blurred them already, they only cost time.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Picture
from colmap_edges.core.view import View
from colmap_edges.edges2d.blur import blur_of_edges
from colmap_edges.edges2d.detection import detect_chains
from colmap_edges.errors import ImageError
from colmap_edges.images.files import gray_of, read_image
from colmap_edges.options import DetectionOptions

logger = logging.getLogger(__name__)

MAX_SCALE = 1.5  # beyond it, noise breaks chains into pieces
MAX_SIZE_PX = 3200  # of an upsampled image, as large as COLMAP looks at images by itself
SCALE_STEP = 0.25  # scales are multiples of it
NUM_IMAGES = 5  # that are measured
CROP_PX = 1024  # side of the middle of an image that is measured


def upsampled(model: Model, image_path: Path, options: DetectionOptions) -> Model:
    """The model with views upsampled as far as their images' sharpness asks for.

    Args:
        model: its views say where the images are; it is not changed.
        image_path: folder of the images.
        options: the blur that is enough.

    Raises:
        ColmapEdgesError: when an image is not of its camera's size.
    """
    largest = max(max(view.width, view.height) for view in model.views)
    limit = min(MAX_SCALE, MAX_SIZE_PX / largest)
    if limit < 1 + SCALE_STEP or options.min_blur_px == 0:
        return model
    every = np.linspace(0, len(model.views) - 1, min(NUM_IMAGES, len(model.views))).astype(int)
    blur_px = typical_blur([model.views[i] for i in every], image_path, options)
    wanted = options.min_blur_px / blur_px if blur_px else 1.0
    steps = int(min(wanted + SCALE_STEP / 2, limit) / SCALE_STEP)
    scale = max(1.0, steps * SCALE_STEP)
    logger.info("edges are blurred by %.2f px; images are upsampled %g times", blur_px, scale)
    return model.at_scale(scale)


def typical_blur(views: Sequence[View], image_path: Path, options: DetectionOptions) -> float:
    """Median blur of the images of these views in pixels; 0 where none shows edges."""
    blurs = []
    for view in views:
        try:
            blurs.append(measure_blur(gray_of(read_image(view, image_path)), options))
        except ImageError:
            continue  # detection tells of it
    seen = [blur for blur in blurs if blur > 0]
    return float(np.median(seen)) if seen else 0.0


def measure_blur(gray: Picture, options: DetectionOptions) -> float:
    """How much the edges in the middle of an image (H, W) uint8 are blurred, in pixels.

    The standard deviation of the Gaussian that makes steps as steep as the strongest edges are;
    0 where there are none.
    """
    top, left = (max(0, (size - CROP_PX) // 2) for size in gray.shape)
    crop = np.ascontiguousarray(gray[top : top + CROP_PX, left : left + CROP_PX])
    chains = detect_chains(crop, options)
    return blur_of_edges(crop, chains.points, chains.normals)
