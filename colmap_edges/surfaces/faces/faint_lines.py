"""Faint lines on planes: borders of walls and ceilings that no single image shows clearly enough.

Where a cell is taken for a plane, the changes of gray in it are taken for marks on that plane. Those
of several views fall on one line of the plane only if they are on it: a mark, or the border to
another plane, which lies on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, offsets_of
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import CELL_PX, Grid
from colmap_edges.surfaces.faces.hypotheses import Planes

BLUR_PX = 1.0
MIN_SLOPE = 0.5  # gray levels a pixel of the small picture, blurred
NUM_ANGLES = 120
MIN_VIEWS = 3  # that see every part of a line
MIN_PIXELS = 60  # of all views on a line
MAX_LINES = 24  # of a plane
STEP_PX = 3.0  # along lines
SIGMA_PX = 0.7
MAX_COSINE_OFF = 0.05


@dataclass(frozen=True, kw_only=True)
class Marks:
    """Changes of gray on planes.

    Attributes:
        points: (M, 3).
        directions: (M, 3) unit, along the change.
        sizes: (M,) of a pixel of the small picture there, world units.
        planes: (M,) plane of each.
        views: (M,) view of each.
    """

    points: FloatArray
    directions: FloatArray
    sizes: FloatArray
    planes: IntArray
    views: IntArray


def ridges(gray: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows and columns of the pixels where gray changes most, and (M, 2) unit gradients (x, y)."""
    smooth = ndimage.gaussian_filter(gray.astype(np.float64), BLUR_PX)
    gy, gx = np.gradient(smooth)
    size = np.hypot(gx, gy)
    inner = np.zeros(size.shape, bool)
    inner[2:-2, 2:-2] = size[2:-2, 2:-2] > MIN_SLOPE
    rows, columns = np.nonzero(inner)
    gradients = np.column_stack([gx[rows, columns], gy[rows, columns]]) / size[rows, columns, None]
    step = np.rint(gradients / np.abs(gradients).max(axis=1, keepdims=True)).astype(np.int64)
    here = size[rows, columns]
    peak = (here >= size[rows + step[:, 1], columns + step[:, 0]]) & (
        here > size[rows - step[:, 1], columns - step[:, 0]]
    )
    return rows[peak], columns[peak], gradients[peak]


def rays_of(view: View, grid: Grid, pixels: FloatArray) -> FloatArray:
    """(N, 3) world directions, one unit deep, through (N, 2) pixels of the small picture."""
    ideal = (pixels - grid.principal) / grid.focal_px
    rays: FloatArray = np.column_stack([ideal, np.ones(len(ideal))]) @ view.rotation
    return rays


def marks_of(view: View, index: int, grid: Grid, labels: Int32Array, planes: Planes) -> Marks:
    """The marks that a view sees, by the (rows, columns) labels of its cells."""
    rows, columns, gradients = ridges(grid.gray)
    label = labels[rows // CELL_PX, columns // CELL_PX]
    on = label >= 0
    label, gradients = label[on], gradients[on]
    pixels = np.column_stack([columns[on], rows[on]]) + 0.5
    along = np.column_stack([-gradients[:, 1], gradients[:, 0]])
    normals, offsets = (
        planes.normals[label],
        planes.offsets[label] - planes.normals[label] @ view.center,
    )

    def meet(at: FloatArray) -> FloatArray:
        rays = rays_of(view, grid, at)
        with np.errstate(divide="ignore", invalid="ignore"):
            depths = offsets / np.einsum("ij,ij->i", normals, rays)
        return view.center + np.where(depths > 0, depths, np.nan)[:, None] * rays

    points, ahead = meet(pixels), meet(pixels + along)
    directions = ahead - points
    sizes = np.linalg.norm(points - view.center, axis=1) / grid.focal_px
    lengths = np.linalg.norm(directions, axis=1)
    good = np.isfinite(lengths) & (lengths > 0) & (lengths < 8 * sizes)
    return Marks(
        points=points[good],
        directions=directions[good] / lengths[good, None],
        sizes=sizes[good],
        planes=label[good].astype(np.int64),
        views=np.full(good.sum(), index),
    )


def find_faint_lines(
    model: Model, grids: Sequence[Grid], labels: Sequence[Int32Array], planes: Planes
) -> Evidence:
    """Lines on the planes that several views see, as points of straight edges."""
    parts = [
        marks_of(view, v, grid, label, planes)
        for v, (view, grid, label) in enumerate(zip(model.views, grids, labels, strict=True))
    ]
    marks = Marks(
        **{name: np.concatenate([getattr(p, name) for p in parts]) for name in vars(parts[0])}
    )
    lines = [
        line
        for plane in range(len(planes.offsets))
        for line in lines_of_plane(
            marks, np.flatnonzero(marks.planes == plane), planes.normals[plane]
        )
    ]
    return as_evidence(marks, lines, model)


def lines_of_plane(
    marks: Marks, own: IntArray, normal: FloatArray
) -> list[tuple[IntArray, IntArray]]:
    """Marks of a plane on one line each, with the step along the line of each of them."""
    if len(own) < MIN_PIXELS:
        return []
    basis = np.linalg.svd(normal[None])[2][1:]
    at, along = marks.points[own] @ basis.T, marks.directions[own] @ basis.T
    at = at - np.median(at, axis=0)
    size = float(np.median(marks.sizes[own]))
    angles = np.arctan2(along[:, 1], along[:, 0]) % np.pi
    across = -np.sin(angles) * at[:, 0] + np.cos(angles) * at[:, 1]
    width = 2 * size
    columns = np.floor((across - across.min()) / width).astype(np.int64)
    rows = np.minimum((angles / np.pi * NUM_ANGLES).astype(np.int64), NUM_ANGLES - 1)
    if columns.max() > 20000:
        return []
    votes = np.zeros((NUM_ANGLES, columns.max() + 1))
    np.add.at(votes, (rows, columns), 1)
    votes = ndimage.uniform_filter(votes, 3, mode="constant") * 9
    order = np.argsort(-votes, axis=None)[: 40 * MAX_LINES]
    lines: list[tuple[IntArray, IntArray]] = []
    free = np.ones(len(own), bool)
    for cell in order:
        row, column = divmod(int(cell), votes.shape[1])
        if votes[row, column] < MIN_PIXELS or len(lines) >= MAX_LINES:
            break
        angle = (row + 0.5) / NUM_ANGLES * np.pi
        place = across.min() + (column + 0.5) * width
        found = fitted_line(at, along, free, angle, place, width, marks.views[own], size)
        if found is None:
            continue
        members, steps = found
        free[members] = False
        lines.append((own[members], steps))
    return lines


def fitted_line(
    at: FloatArray,
    along: FloatArray,
    free: BoolArray,
    angle: float,
    place: float,
    width: float,
    views: IntArray,
    size: float,
) -> tuple[IntArray, IntArray] | None:
    """Members of a line near an angle and a place, and their steps along it where views agree."""
    for _ in range(2):
        direction = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-direction[1], direction[0]])
        near = free & (np.abs(at @ normal - place) < width) & (np.abs(along @ normal) < 0.08)
        members = np.flatnonzero(near)
        if len(members) < MIN_PIXELS:
            return None
        middle = at[members].mean(axis=0)
        values = np.linalg.eigh((at[members] - middle).T @ (at[members] - middle))[1]
        direction = values[:, 1]
        angle = float(np.arctan2(direction[1], direction[0]))
        place = float(middle @ [-direction[1], direction[0]])
    steps = np.floor((at[members] @ direction) / (STEP_PX * size)).astype(np.int64)
    steps -= steps.min()
    pairs = np.unique(np.column_stack([steps, views[members]]), axis=0)
    num_views = np.bincount(pairs[:, 0])
    seen = num_views[steps] >= MIN_VIEWS
    if np.sum(num_views >= MIN_VIEWS) < 8:
        return None
    return members[seen], steps[seen]


def as_evidence(marks: Marks, lines: list[tuple[IntArray, IntArray]], model: Model) -> Evidence:
    """Points of straight edges at the steps of lines."""
    points, tangents, sigmas, weights, tracks = [], [], [], [], []
    focals = np.array([view.focal_px / view.scale for view in model.views])
    for members, steps in lines:
        middle = marks.points[members].mean(axis=0)
        off = marks.points[members] - middle
        tangent = np.linalg.eigh(off.T @ off)[1][:, -1]
        along = off @ tangent
        for step in np.unique(steps):
            own = members[steps == step]
            points.append(middle + np.mean(along[steps == step]) * tangent)
            tangents.append(tangent)
            size = float(np.median(marks.sizes[own]))
            sigmas.append(SIGMA_PX * size)
            weights.append(STEP_PX * size)
            tracks.append(np.unique(marks.views[own]))
    at = np.array(points).reshape(-1, 3)
    views = np.concatenate([np.zeros(0, np.int64), *tracks]).astype(np.int32)
    offsets = offsets_of(np.array([len(t) for t in tracks], np.int64))
    away = np.array(
        [(p - model.camera_centers[t]).mean(axis=0) for p, t in zip(at, tracks, strict=True)]
    )
    away = away.reshape(-1, 3)
    distances = np.linalg.norm(away, axis=1)
    near = np.array(
        [
            np.median(np.linalg.norm(p - model.camera_centers[t], axis=1) / focals[t])
            for p, t in zip(at, tracks, strict=True)
        ]
    )
    return Evidence(
        points=at,
        tangents=np.array(tangents).reshape(-1, 3),
        rays=away / (distances[:, None] + 1e-300),
        sigmas=np.array(sigmas),
        ray_sigmas=np.array(sigmas),
        weights=np.array(weights) / near if len(at) else np.zeros(0),
        offsets=offsets,
        views=views,
    )
