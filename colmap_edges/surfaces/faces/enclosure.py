"""Test of whether labelled cells are enclosed by observed points of their plane.

Labels spread over plain regions, and beyond the end of a wall also over a backdrop, where nothing
contradicts them. Between its observed points a plane probably continues; beyond them it may not.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, owners_of
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.decision import Samples
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import CELL_PX, Grid
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import extents_of, planes_of_points, split_by_view

# Steps (columns, rows) of 16 directions, sorted by angle.
DIRECTIONS = (
    *((1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)),
    *((-1, 0), (-2, -1), (-1, -1), (-1, -2), (0, -1), (1, -2), (1, -1), (2, -1)),
)
# maximum number of adjacent open directions: points enclose a cell from all sides
MAX_OPEN = len(DIRECTIONS) // 2 - 1
# minimum share of enclosed cells of a piece, or of agreeing views at a position
ENCLOSED_SHARE = 1 / 2


def are_enclosed(
    samples: Samples,
    labels: Int32Array,
    model: Model,
    grids: Sequence[Grid],
    evidence: Evidence,
    planes: Planes,
) -> BoolArray:
    """(S,) whether most of the agreeing views show a place on a piece between what is observed.

    Args:
        samples: places that labelled cells see.
        labels: of the cells of all views.
        model: gives the V views.
        grids: (V,) their small pictures.
        evidence: points, and who observes them.
        planes: of the labels.
    """
    num_planes = len(planes.offsets)
    plane_offsets, plane_rows = planes_of_points(evidence, planes)
    directions, extents = (
        part.reshape(num_planes, -1, part.shape[-1])
        for part in extents_of(evidence, planes, plane_offsets, plane_rows)
    )
    on = np.zeros((len(evidence.points), num_planes), bool)
    on[owners_of(plane_offsets), plane_rows] = True
    observed = owners_of(evidence.offsets)
    rows, votes = owners_of(samples.offsets), np.zeros(len(samples.views), bool)
    parts = zip(model.views, grids, split_by_view(labels, grids), strict=True)
    for index, (view, grid, shown) in enumerate(parts):
        seen = np.flatnonzero(samples.views == index)
        if not len(seen):
            continue
        points = observed[evidence.views == index]
        touched = touched_cells(evidence.points[points], on[points], view, grid, shown.shape)
        inside = inside_extents(shown, view, grid, planes, directions, extents)
        held = whole_pieces(shown, enclosed_cells(shown, touched, inside))
        at, columns, lines = cells_at(samples.points[rows[seen]], view, grid, shown.shape)
        seen = seen[at]
        votes[seen] = held[lines, columns] & (shown[lines, columns] == samples.planes[rows[seen]])
    count = np.bincount(rows, votes, len(samples.points))
    most: BoolArray = count >= ENCLOSED_SHARE * np.diff(samples.offsets)
    return most


def cells_at(
    points: FloatArray, view: View, grid: Grid, shape: tuple[int, ...]
) -> tuple[IntArray, IntArray, IntArray]:
    """Which of (N, 3) points are in a view's small picture, with columns and rows of the cells."""
    local = points @ view.rotation.T + view.translation
    front = local[:, 2] > 0
    pixels = local[:, :2] / np.where(front, local[:, 2], 1)[:, None] * grid.focal_px
    cells = np.floor((pixels + grid.principal) / CELL_PX).astype(np.int64)
    held = front & (cells >= 0).all(axis=1) & (cells < shape[1::-1]).all(axis=1)
    columns, rows = cells[held].T
    return np.flatnonzero(held), columns, rows


def touched_cells(
    points: FloatArray, on: BoolArray, view: View, grid: Grid, shape: tuple[int, ...]
) -> BoolArray:
    """(h, w, K + 1) in which cells points of each plane are observed; the last of no plane."""
    touched = np.zeros((*shape, on.shape[1] + 1), bool)
    at, columns, rows = cells_at(points, view, grid, shape)
    members, planes = np.nonzero(on[at])
    touched[rows[members], columns[members], planes] = True
    return touched


def inside_extents(
    shown: Int32Array,
    view: View,
    grid: Grid,
    planes: Planes,
    directions: FloatArray,
    extents: FloatArray,
) -> BoolArray:
    """(h, w) whether the points of a cell's plane lie around the place that it sees."""
    inside = np.zeros(shown.shape, bool)
    rows, columns = np.nonzero(shown >= 0)
    plane = shown[rows, columns]
    pixels = CELL_PX * (np.column_stack([columns, rows]) + 0.5) - grid.principal
    rays = np.column_stack([pixels / grid.focal_px, np.ones(len(rows))]) @ view.rotation
    normals = planes.normals[plane]
    away = (planes.offsets[plane] - normals @ view.center) / np.einsum("ij,ij->i", normals, rays)
    points = view.center + away[:, None] * rays
    at = np.einsum("idj,ij->id", directions[plane], points)
    low, high = np.moveaxis(extents[plane], -1, 0)
    inside[rows, columns] = ((at >= low) & (at <= high)).all(axis=1)
    return inside


def enclosed_cells(shown: Int32Array, touched: BoolArray, inside: BoolArray) -> BoolArray:
    """(h, w) whether going straight on within a cell's label meets its plane's points all around.

    Args:
        shown: (h, w) planes of cells, -1: none.
        touched: (h, w, K + 1) in which cells points of the planes are observed.
        inside: (h, w) where a way that leaves the picture is taken to meet them, too.
    """
    met = np.stack([met_cells(shown, touched, inside, *step) for step in DIRECTIONS])
    run, longest = np.zeros((2, *shown.shape), np.int64)
    for hit in [*met, *met]:
        run = np.where(hit, 0, run + 1)
        longest = np.maximum(longest, run)
    enclosed: BoolArray = (longest <= MAX_OPEN) & (shown >= 0)
    return enclosed


def met_cells(
    shown: Int32Array, touched: BoolArray, inside: BoolArray, column: int, row: int
) -> BoolArray:
    """(h, w) whether steps in one direction meet points of a cell's plane before they leave it."""
    height, width = shown.shape
    rows, columns = np.indices(shown.shape)
    next_rows, next_columns = rows + row, columns + column
    held = (next_rows >= 0) & (next_rows < height) & (next_columns >= 0) & (next_columns < width)
    next_rows, next_columns = (
        np.clip(next_rows, 0, height - 1),
        np.clip(next_columns, 0, width - 1),
    )
    met: BoolArray = np.where(held, touched[next_rows, next_columns, shown], inside)
    goes_on = held & ~met & (shown[next_rows, next_columns] == shown)
    # Cells whose way goes on are as the next; each round of jumps is twice as long.
    own = rows * width + columns
    ahead = np.where(goes_on, next_rows * width + next_columns, own).ravel()
    for _ in range(int(np.ceil(np.log2(max(shown.shape))))):
        ahead = ahead[ahead]
    reached: BoolArray = met.ravel()[ahead].reshape(shown.shape)
    return reached


def whole_pieces(shown: Int32Array, enclosed: BoolArray) -> BoolArray:
    """(h, w) cells that are enclosed, and all of pieces most of whose cells are.

    A piece is a connected part of the cells of one plane: a wall that goes on to the end of the
    picture is believed, a strip of edges that spreads over a backdrop is not.
    """
    held = enclosed.copy()
    for plane in np.unique(shown[shown >= 0]):
        own = (shown == plane).astype(np.uint8)
        count, pieces = cv2.connectedComponents(own, connectivity=4)
        sizes = np.bincount(pieces.ravel(), minlength=count)
        inner = np.bincount(pieces.ravel(), enclosed.ravel(), count)
        whole = inner >= ENCLOSED_SHARE * sizes
        whole[0] = False
        held |= whole[pieces]
    return held
