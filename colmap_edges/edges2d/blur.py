"""Measures the blur of an image's edges."""

from __future__ import annotations

import cv2
import numpy as np

from colmap_edges.core.arrays import FloatArray, Picture

NUM_PROFILES = 4000  # across the edges of an image
REACH_PX, STEP_PX = 4.0, 0.25  # of a profile to both sides, and between its samples
PLATEAU = 5  # samples at each end of a profile whose mean is the gray of that side
STRONGEST = 0.25  # share of the profiles, by contrast, whose widths count


def blur_of_edges(gray: Picture, points: FloatArray, normals: FloatArray) -> float:
    """How much the edges of an image are blurred, in pixels.

    Args:
        gray: (H, W) uint8.
        points: (N, 2) on edges, image pixels, COLMAP's origin.
        normals: (N, 2) unit vectors across them, dark to bright.

    Returns:
        The standard deviation of the Gaussian that makes steps as steep as the strongest of the
        edges are; 0 where there are none.
    """
    if len(points) == 0:
        return 0.0
    every = np.arange(0, len(points), max(1, len(points) // NUM_PROFILES))
    profiles = profiles_across(gray, points[every], normals[every])
    contrasts = profiles[:, -PLATEAU:].mean(axis=1) - profiles[:, :PLATEAU].mean(axis=1)
    slopes = np.diff(profiles, axis=1).max(axis=1) / STEP_PX
    strong = (contrasts >= np.quantile(contrasts, 1 - STRONGEST)) & (contrasts > 0)
    widths = contrasts[strong] / (slopes[strong] * np.sqrt(2 * np.pi))
    return float(np.median(widths)) if len(widths) else 0.0


def profiles_across(gray: Picture, points: FloatArray, normals: FloatArray) -> FloatArray:
    """(N, S) grays along the normals (N, 2), dark to bright, of (N, 2) image pixels."""
    offsets = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    places = points[:, None] - 0.5 + offsets[None, :, None] * normals[:, None]
    x, y = np.moveaxis(places.astype(np.float32), -1, 0)
    grays = gray.astype(np.float32)
    sampled = cv2.remap(grays, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, np.float64)
