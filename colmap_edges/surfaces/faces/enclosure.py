"""Test of whether labelled cells are enclosed by observed points of their plane.

Labels spread over plain regions, and beyond the end of a wall also over a backdrop, where nothing
contradicts them. Between its observed points a plane probably continues; beyond them it may not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from colmap_edges.core.arrays import BoolArray, Int32Array, IntArray
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
# Minimum share of pictures' borders, in the median, that shows the backdrop if there is one: 0.37
# to 1 around objects, 0.15 to 0.55 of the sky, 0.1 to 0.2 in rooms.
MIN_BACKDROP = 0.35
BACKDROP_LEVELS = 2  # maximum deviation of the backdrop from its most frequent gray
MIN_SHOWN = 1 / 4  # minimum share of a cell that shows it
# Maximum share of its gray that has other colours than a known backdrop's; beyond, colours decide.
MAX_OTHERS = 1 / 4


def are_enclosed(
    scene: Any,
    samples: Samples,
    labels: Int32Array,
    grids: Sequence[Grid],
    num_threads: int = 1,
    side: int = 1,
) -> BoolArray:
    """(S,) whether most of the agreeing views show a place on a piece between what is observed.

    Args:
        scene: of `make_scene`.
        samples: places that labelled cells see.
        labels: of the cells of all views.
        grids: (V,) the views' small pictures.
        num_threads: threads; the result does not depend on them.
        side: cells along a side of those that an observed point stands for, since the next point of
            an edge may be as far.
    """
    plain = np.concatenate([of.ravel() for of in backdrops(grids)])
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
        side,
        num_threads,
    )
    most: BoolArray = counts >= ENCLOSED_SHARE * np.diff(samples.offsets)
    return most


def backdrops(grids: Sequence[Grid]) -> list[BoolArray]:
    """(V,) (rows, columns) whether cells show a backdrop: what most pictures' borders are of.

    Surfaces are rarely of one gray along the border of a picture, as a backdrop is. A sky may be,
    too, but around fewer pictures and less of them. Where a ground has the gray of a backdrop whose
    colours are known, these tell them apart.
    """
    borders = [np.concatenate([of[0], of[-1], of[:, 0], of[:, -1]]) for of in map(gray_of, grids)]
    window = np.ones(2 * BACKDROP_LEVELS + 1, np.int64)
    counts = [np.convolve(np.bincount(of, minlength=256), window, "same") for of in borders]
    shares = [of.max() / len(border) for of, border in zip(counts, borders, strict=True)]
    if np.median(shares) < MIN_BACKDROP:
        return [np.zeros(grid.shape, bool) for grid in grids]
    alike = [
        np.abs(gray_of(grid) - of.argmax()) <= BACKDROP_LEVELS
        for grid, of in zip(grids, counts, strict=True)
    ]
    told = [
        of if grid.others is None else of & ~grid.others
        for grid, of in zip(grids, alike, strict=True)
    ]
    if sum(map(np.sum, told)) < (1 - MAX_OTHERS) * sum(map(np.sum, alike)):
        alike = told
    found = []
    for grid, pixels in zip(grids, alike, strict=True):
        rows, columns = grid.shape
        cells = pixels.reshape(rows, CELL_PX, columns, CELL_PX).mean(axis=(1, 3))
        found.append(np.asarray(cells >= MIN_SHOWN))
    return found


def gray_of(grid: Grid) -> IntArray:
    """(h, w) int64 gray of a small picture."""
    return grid.gray.astype(np.int64)
