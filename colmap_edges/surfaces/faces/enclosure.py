"""Test of whether labelled cells are enclosed by observed points of their plane.

Labels spread over plain regions, and beyond the end of a wall also over a backdrop, where nothing
contradicts them. Between its observed points a plane probably continues; beyond them it may not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from colmap_edges.core.arrays import BoolArray, Int32Array
from colmap_edges.surfaces.faces.decision import Samples
from colmap_edges.surfaces.faces.grids import CELL_PX, Grid

# Steps (columns, rows) of 16 directions, sorted by angle.
DIRECTIONS = (
    *((1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)),
    *((-1, 0), (-2, -1), (-1, -1), (-1, -2), (0, -1), (1, -2), (1, -1), (2, -1)),
)
# Maximum number of adjacent open directions, in which no points of a cell's plane are met: fewer
# before a backdrop, since slices through a round body meet points on its near side only.
MAX_OPEN = len(DIRECTIONS) // 2 - 1
MAX_OPEN_BEFORE_BACKDROP = len(DIRECTIONS) // 4
# minimum share of enclosed cells of a piece, or of agreeing views at a position
ENCLOSED_SHARE = 1 / 2
# Minimum share of a picture's border that shows the backdrop if there is one: 0.4 to 1 around
# objects, 0.2 to 0.35 of the sky, 0.1 in rooms.
MIN_BACKDROP = 0.35
BACKDROP_LEVELS = 2  # maximum deviation of the backdrop from its most frequent gray
MIN_SHOWN = 1 / 4  # minimum share of a cell that shows it


def are_enclosed(
    scene: Any,
    samples: Samples,
    labels: Int32Array,
    grids: Sequence[Grid],
    num_threads: int = 1,
) -> BoolArray:
    """(S,) whether most of the agreeing views show a place on a piece between what is observed.

    Args:
        scene: of `make_scene`.
        samples: places that labelled cells see.
        labels: of the cells of all views.
        grids: (V,) the views' small pictures.
        num_threads: threads; the result does not depend on them.
    """
    plain = np.concatenate([shows_backdrop(grid).ravel() for grid in grids])
    counts = scene.count_enclosing(
        labels,
        plain.astype(np.uint8),
        samples.points,
        np.ascontiguousarray(samples.planes),
        samples.offsets,
        samples.views,
        np.array(DIRECTIONS, np.int32),
        MAX_OPEN_BEFORE_BACKDROP if plain.any() else MAX_OPEN,
        ENCLOSED_SHARE,
        num_threads,
    )
    most: BoolArray = counts >= ENCLOSED_SHARE * np.diff(samples.offsets)
    return most


def shows_backdrop(grid: Grid) -> BoolArray:
    """(rows, columns) whether cells show the gray of which much of the picture's border is.

    Surfaces are rarely of one gray along the border of a picture, as a backdrop or the sky is.
    """
    gray = grid.gray.astype(np.int64)
    border = np.concatenate([gray[0], gray[-1], gray[:, 0], gray[:, -1]])
    window = np.ones(2 * BACKDROP_LEVELS + 1, np.int64)
    counts = np.convolve(np.bincount(border, minlength=256), window, "same")
    rows, columns = grid.shape
    if counts.max() < MIN_BACKDROP * len(border):
        return np.zeros((rows, columns), bool)
    near = np.abs(gray - counts.argmax()) <= BACKDROP_LEVELS
    cells = near.reshape(rows, CELL_PX, columns, CELL_PX).mean(axis=(1, 3))
    most: BoolArray = cells >= MIN_SHOWN
    return most
