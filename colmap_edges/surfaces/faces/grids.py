"""Reduced, undistorted grayscale images of the views, in which faces are labelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
    Picture,
    offsets_of,
    parts_of,
)
from colmap_edges.core.view import View
from colmap_edges.images.background import Backgrounds
from colmap_edges.images.files import gray_of, square

CELL_PX = 4  # side of a cell in pixels of the reduced image
NODE_PX = 8  # pixels of the picture
NUM_COLUMNS = 160  # cells along the longer side of an image
CLIPPED = 250  # minimum level of what is overexposed


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A view as a small undistorted picture.

    Attributes:
        gray: (h, w) uint8, whole cells.
        focal_px: its focal length.
        principal: (2,) its principal point, the corner of the picture is (0, 0).
        usable: (h, w) false where it is masked; None without a mask.
        background: (h, w) whether it shows the backdrop or the sky; None if it shows none.
        others: (h, w) whether colours are not those of the backdrop; None if these are unknown.
        bodies: (rows, columns) float32 depths of the round bodies that cells show, NaN where there
            is none; None if there are none.
    """

    gray: ByteArray
    focal_px: float
    principal: FloatArray
    usable: BoolArray | None = None
    background: BoolArray | None = None
    others: BoolArray | None = None
    bodies: Float32Array | None = None

    @property
    def shown(self) -> Float32Array:
        """(rows, columns) float32 depths of what cells show that is no plane; NaN where unknown.

        They are infinite where cells show nothing but background.
        """
        rows, columns = self.shape
        depths = np.full((rows, columns), np.nan, np.float32)
        if self.bodies is not None:
            depths[:] = self.bodies
        if self.background is not None:
            cells = self.background.reshape(rows, CELL_PX, columns, CELL_PX)
            depths[cells.all(axis=(1, 3))] = np.inf
        return depths

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns of cells."""
        height, width = self.gray.shape
        return height // CELL_PX, width // CELL_PX

    def pixels_of(self, view: View, points: FloatArray) -> FloatArray:
        """(N, 2) places of (N, 3) points before its view in the picture."""
        local = points @ view.rotation.T + view.translation
        pixels: FloatArray = self.focal_px * local[:, :2] / local[:, 2:] + self.principal
        return pixels


def halved(grid: Grid) -> Grid:
    """The picture with cells twice as wide and high; what is left of the last ones repeats."""
    rows, columns = ((count + 1) // 2 for count in grid.shape)
    height, width = CELL_PX * rows, CELL_PX * columns

    def padded(pixels: ByteArray | BoolArray) -> Any:
        down, right = 2 * height - pixels.shape[0], 2 * width - pixels.shape[1]
        return np.pad(pixels, ((0, down), (0, right)), mode="edge")

    def whole(pixels: BoolArray | None) -> BoolArray | None:
        if pixels is None:
            return None
        return np.asarray(padded(pixels).reshape(height, 2, width, 2).all(axis=(1, 3)))

    bodies = grid.bodies
    if bodies is not None:
        fine_rows, fine_columns = grid.shape
        ends = ((0, 2 * rows - fine_rows), (0, 2 * columns - fine_columns))
        far = np.pad(np.nan_to_num(bodies, nan=np.inf), ends, constant_values=np.inf)
        nearest = far.reshape(rows, 2, columns, 2).min(axis=(1, 3))
        bodies = np.where(np.isfinite(nearest), nearest, np.float32(np.nan))
    gray = cv2.resize(padded(grid.gray), (width, height), interpolation=cv2.INTER_AREA)
    return Grid(
        gray=np.asarray(gray, np.uint8),
        focal_px=grid.focal_px / 2,
        principal=grid.principal / 2,
        usable=whole(grid.usable),
        background=whole(grid.background),
        others=whole(grid.others),
        bodies=bodies,
    )


def doubled(labels: Int32Array, grids: Sequence[Grid], finer: Sequence[Grid]) -> Int32Array:
    """Labels of the cells of finer pictures from those of their halves."""
    parts = []
    for part, grid, fine in zip(parts_of(labels, cell_offsets(grids)), grids, finer, strict=True):
        rows, columns = fine.shape
        both = part.reshape(grid.shape).repeat(2, axis=0).repeat(2, axis=1)
        parts.append(both[:rows, :columns].ravel())
    return np.concatenate(parts)


def cell_offsets(grids: Sequence[Grid]) -> IntArray:
    """(V + 1,) where the cells of each of V views begin among those of all."""
    return offsets_of(np.array([grid.shape[0] * grid.shape[1] for grid in grids], np.int64))


def arrays_of(views: Sequence[View], grids: Sequence[Grid]) -> tuple[Any, ...]:
    """V views and their pictures as kernels take them.

    Returns:
        (V, 3, 3) rotations and (V, 3) translations of the views, (V,) focal lengths and (V, 2)
        principal points of the pictures in their pixels, and V arrays of gray levels.
    """
    return (
        np.array([view.rotation for view in views]),
        np.array([view.translation for view in views]),
        np.array([grid.focal_px for grid in grids]),
        np.array([grid.principal for grid in grids]),
        [grid.gray for grid in grids],
    )


def size_of(view: View, num_columns: int) -> tuple[int, int, float]:
    """Width and height of a view's small picture, and its size over the image's."""
    factor = num_columns * CELL_PX / max(view.width, view.height)
    width, height = (
        CELL_PX * max(2, round(side * factor / CELL_PX)) for side in (view.width, view.height)
    )
    return width, height, factor


def make_grid(
    view: View, image: Picture, usable: BoolArray | None = None, num_columns: int = NUM_COLUMNS
) -> Grid:
    """The small undistorted picture of a view's image (H, W, 3), and what is usable of it."""
    blank = blank_grid(view, num_columns)
    height, width = blank.gray.shape
    small = gray_of(image)
    while min(small.shape) > 4 * min(width, height):  # halving is quick
        half = small.shape[1] // 2, small.shape[0] // 2
        small = np.asarray(cv2.resize(small, half, interpolation=cv2.INTER_AREA), np.uint8)
    small = np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    at = places_of(view, blank)
    gray = cv2.remap(small, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    gray = np.ascontiguousarray(gray, np.uint8)
    return replace(blank, gray=gray, usable=usable_at(at, usable))


def with_background(
    view: View, grid: Grid, body: BoolArray, others: BoolArray | None = None
) -> Grid:
    """The picture with the background of its view's image.

    Args:
        view: the view.
        grid: its picture.
        body: (H, W) foreground of the image, at its size or smaller; the rest is background.
        others: (H, W) where colours are not those of the backdrop, likewise; None if unknown.
    """
    at, everywhere = places_of(view, grid), np.ones(grid.gray.shape, bool)

    def seen(pixels: BoolArray) -> BoolArray:
        shown = usable_at(at, pixels)
        return everywhere if shown is None else shown

    known = None if others is None else seen(others)
    return replace(grid, background=seen(~body), others=known)


def with_backgrounds(
    views: Sequence[View], grids: Mapping[int, Grid], shown: Backgrounds
) -> dict[int, Grid]:
    """Pictures of views by their index, with the backgrounds of those that show one."""
    found = dict(grids)
    for v, mask in enumerate(shown.masks):
        if mask.is_seen and v in grids:
            others = shown.others[v] if shown.others else None
            found[v] = with_background(views[v], grids[v], mask.body(), others)
    return found


def with_bodies(view: View, grid: Grid, points: FloatArray) -> Grid:
    """The picture with the depths of round bodies, the same in each two by two cells.

    Args:
        view: the view.
        grid: its picture.
        points: (N, 3) points all over the bodies, about two cells from each other.
    """
    rows, columns = grid.shape
    depths = np.full(((rows + 1) // 2, (columns + 1) // 2), np.inf, np.float32)
    pixels, depths_of_points = view.project(points)
    inside = view.holds(pixels, depths_of_points)
    at = tuple(of // 2 for of in cells_in(view, grid, points[inside]))
    np.minimum.at(depths, at, depths_of_points[inside])
    around = square(1)
    held = cv2.morphologyEx(np.isfinite(depths).astype(np.uint8), cv2.MORPH_CLOSE, around) > 0
    nearest = cv2.erode(depths, around)  # some cells show points of the far side alone
    known = np.where(held, nearest, np.float32(np.nan))
    return replace(grid, bodies=known.repeat(2, axis=0).repeat(2, axis=1)[:rows, :columns])


def usable_at(at: Float32Array, usable: BoolArray | None) -> BoolArray | None:
    """(h, w) whether a picture shows usable parts of the image; None if it does everywhere.

    Args:
        at: (h, w, 2) where its pixels are in the image, reduced to its size.
        usable: (H, W) of the image; None without a mask.
    """
    height, width = at.shape[:2]
    inside = cv2.inRange(at, (-0.6, -0.6), (width - 0.4, height - 0.4)) > 0
    if usable is not None:
        rows, columns = (
            np.arange(side) * whole // side
            for side, whole in zip((height, width), usable.shape, strict=True)
        )
        small = usable[np.ix_(rows, columns)].astype(np.uint8)
        border = cv2.BORDER_REPLICATE
        inside &= cv2.remap(small, at, None, cv2.INTER_NEAREST, borderMode=border) > 0
    return None if inside.all() else inside


def places_of(view: View, grid: Grid) -> Float32Array:
    """(h, w, 2) where the pixels of a picture are in the image, reduced to its size.

    Every `NODE_PX`-th is computed, between which lenses distort nearly linearly.
    """
    height, width = grid.gray.shape
    nodes = [np.arange(side // NODE_PX + 2) * NODE_PX + 0.5 for side in (width, height)]
    columns, rows = np.meshgrid(*nodes)
    undistorted = (
        np.column_stack([columns.ravel(), rows.ravel()]) - grid.principal
    ) / grid.focal_px
    pixels = view.image_from_undistorted(undistorted * view.focal_px)
    scale = np.array([width / view.width, height / view.height])
    at = (pixels * scale - 0.5).astype(np.float32).reshape(*rows.shape, 2)
    step = np.array([[1 / NODE_PX, 0, 0], [0, 1 / NODE_PX, 0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(at, step, (width, height), flags=flags), np.float32)


def blank_grid(view: View, num_columns: int = NUM_COLUMNS) -> Grid:
    """The picture of a view whose image shows nothing."""
    width, height, factor = size_of(view, num_columns)
    camera = view.camera
    principal = np.array([camera.principal_point_x, camera.principal_point_y]) * factor
    gray = np.zeros((height, width), np.uint8)
    return Grid(gray=gray, focal_px=view.focal_px / view.scale * factor, principal=principal)


def cells_in(view: View, grid: Grid, points: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows and columns of the cells in which (N, 3) points before a view lie in its picture.

    Points outside the picture count to the nearest cell.
    """
    last = np.array(grid.gray.shape[::-1]) // CELL_PX - 1
    cells = np.clip(np.floor(grid.pixels_of(view, points) / CELL_PX), 0, last).astype(np.int64)
    return cells[:, 1], cells[:, 0]
