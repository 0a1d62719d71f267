"""Views as small undistorted pictures in gray, in which faces are labelled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_edges.core.arrays import ByteArray, FloatArray, Picture
from colmap_edges.core.view import View

CELL_PX = 4  # side of a cell in pixels of the small picture
NUM_COLUMNS = 80  # cells along the longer side of an image


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A view as a small undistorted picture.

    Attributes:
        gray: (h, w) uint8, whole cells.
        focal_px: its focal length.
        principal: (2,) its principal point, the corner of the picture is (0, 0).
    """

    gray: ByteArray
    focal_px: float
    principal: FloatArray


def make_grid(view: View, image: Picture) -> Grid:
    """The small undistorted picture of a view's image (H, W, 3) or (H, W)."""
    longer = max(view.width, view.height)
    factor = NUM_COLUMNS * CELL_PX / longer
    width, height = (
        CELL_PX * max(2, round(side * factor / CELL_PX)) for side in (view.width, view.height)
    )
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    while min(gray.shape) > 4 * min(width, height):
        gray = cv2.resize(gray, (gray.shape[1] // 2, gray.shape[0] // 2), interpolation=cv2.INTER_AREA)
    small = cv2.resize(gray, (width, height), interpolation=cv2.INTER_AREA)
    params = view.camera
    focal = view.focal_px / view.scale * factor
    principal = np.array([params.principal_point_x, params.principal_point_y]) * factor
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    ideal = (np.column_stack([columns.ravel(), rows.ravel()]) - principal) / focal
    pixels = view.image_from_ideal(ideal * view.focal_px)
    scale = np.array([width / view.width, height / view.height])
    at = (pixels * scale - 0.5).astype(np.float32).reshape(height, width, 2)
    undistorted = cv2.remap(small, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Grid(gray=np.ascontiguousarray(undistorted), focal_px=focal, principal=principal)


class GridTaker:
    """Takes the small pictures of all views while their images are in memory."""

    def __init__(self, views: list[View]) -> None:
        """Hold none yet."""
        self.taken: dict[int, Grid] = {}
        self.views = views

    def visit(self, index: int, view: View, read: Callable[[], Picture], found: object) -> Grid:
        """Take the picture of a view."""
        return make_grid(view, read())

    def collect(self, index: int, kept: Grid) -> None:
        """Keep a picture."""
        self.taken[index] = kept
