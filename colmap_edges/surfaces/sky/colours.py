"""Regions that look like the sky: blue or overexposed, above the horizon, at the upper border."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray, IntArray, Picture
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.grids import CLIPPED
from colmap_edges.surfaces.sky.regions import Regions, angle_of, rays_of

MIN_ELEVATION_DEG = -10.0  # the horizon, with the error of the upward direction
BLUE = 1.03  # minimum ratio of blue to red
# Minimum sum of the shares of structure that are darker, in blue, and less blue ...
BRIGHT_AND_BLUE = 1.4
DEEP_BLUE = 1.3  # ... unless the ratio of blue to red is this, and ...
BLUER = 0.95  # ... this share of structure is less blue
MIN_LEVEL = 64  # minimum level of a sky's blue
# An overexposed sky, of which all channels are, is brighter than this share of structure.
CLIPPED_BRIGHTER = 0.9
LOWEST = 0.05  # share of a region's pixels that may lie below the horizon


def looks_like_sky(
    views: Sequence[View], regions: Regions, up: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Find regions at the upper border, above the horizon, that look like the sky.

    A sky is brighter or bluer than what it shines on. Colours are compared with those of structure
    in the same picture, so that its exposure and white balance do not matter.

    Args:
        views: the V views.
        regions: their R regions.
        up: (3,) upward direction.

    Returns:
        (R,) whether they are blue, and (R,) whether they are overexposed, as windows are, too.
    """
    blue, white = np.zeros((2, len(regions.views)), bool)
    for index, (view, picture) in enumerate(zip(views, regions.pictures, strict=True)):
        own, pixels = regions.pixels(index)
        near = regions.near[index]
        if not len(own) or not near.any():
            continue
        turns = round(angle_of(view, up) / (np.pi / 2))
        border = np.rot90(regions.labels[index], turns)[0]
        around = Colors.of(picture[near])
        for region, inside in zip(own, pixels, strict=True):
            color = np.median(picture.reshape(-1, 3)[inside], axis=0)
            is_white, is_blue = around.below_white(color), around.below_blue(color)
            if (is_white or is_blue) and (border == region).any():
                above = is_above(view, picture, inside, up)
                white[region], blue[region] = above and is_white, above and not is_white
    return blue, white


def is_above(view: View, picture: Picture, inside: IntArray, up: FloatArray) -> bool:
    """Whether pixels (n,) of a flattened picture lie above the horizon."""
    rays = rays_of(view, picture, inside)
    sines = rays[np.isfinite(rays).all(axis=1)] @ up
    return bool(len(sines)) and bool(
        np.quantile(sines, LOWEST) > np.sin(np.radians(MIN_ELEVATION_DEG))
    )


class Colors(NamedTuple):
    """Colours of structure in a picture.

    Attributes:
        levels: (n,) sorted levels of blue.
        blues: (n,) sorted ratios of blue to red.
    """

    levels: ByteArray
    blues: FloatArray

    @classmethod
    def of(cls, pixels: ByteArray) -> Colors:
        """The colours of (n, 3) BGR pixels."""
        return cls(np.sort(pixels[:, 0]), np.sort(blue_of(pixels)))

    def below_white(self, color: FloatArray) -> bool:
        """Whether a colour (3,) is overexposed, and brighter than most of the structure."""
        darker = np.searchsorted(self.levels, color[0]) / len(self.levels)
        return bool(color.min() >= CLIPPED and darker >= CLIPPED_BRIGHTER)

    def below_blue(self, color: FloatArray) -> bool:
        """Whether a colour (3,) is between blue and white, and bluer than the structure."""
        blue = float(blue_of(color[None])[0])
        darker = np.searchsorted(self.levels, color[0]) / len(self.levels)
        less_blue = np.searchsorted(self.blues, blue) / len(self.blues)
        is_blue = blue >= BLUE and color[0] >= MIN_LEVEL and (np.diff(color) <= 1).all()
        is_deep = blue >= DEEP_BLUE and less_blue >= BLUER
        return bool(is_blue and (is_deep or darker + less_blue >= BRIGHT_AND_BLUE))


def blue_of(pixels: NDArray[Any]) -> FloatArray:
    """(n,) ratios of blue to red of (n, 3) BGR pixels."""
    return np.asarray((pixels[:, 0] + 1.0) / (pixels[:, 2] + 1.0))
