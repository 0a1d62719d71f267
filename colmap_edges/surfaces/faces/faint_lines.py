"""Faint lines on planes, such as borders of walls and ceilings, too weak in any single image.

Intensity gradients in a cell are projected onto the plane that the cell is labelled with. Gradients
of several views coincide on a line of the plane only if they belong to it: as a mark, or as the
border to another plane, which lies on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
)
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.evidence import Evidence, sight_of
from colmap_edges.surfaces.faces.grids import CELL_PX, Grid
from colmap_edges.surfaces.faces.hypotheses import Planes

# Lengths are in pixels of the reduced images. Set by trial on rooms (docs/experiments.md).
BLUR_PX = 1.0  # standard deviation of the blur of the reduced images
MIN_SLOPE = 0.5  # minimum gradient of the blurred image per pixel, above the noise of pixel means
NUM_ANGLES = 120  # number of line directions in half a turn
WIDTH_PX = 2.0  # width of lines
MAX_PLACES = 4000  # maximum number of parallel line positions
MAX_TURN = 0.08  # maximum sine of the angle between a gradient's edge direction and its line
MIN_PIXELS = 60  # minimum number of pixels on a line, over all views
MIN_VIEWS = 3  # minimum number of views of a stretch of a line
MIN_STEPS = 8  # minimum number of such stretches
STEP_PX = 3.0  # length of a stretch
MAX_LINES = 24  # maximum number of lines on a plane
MAX_TRIED = 40  # candidates per line
SIGMA_PX = 0.7  # standard deviation of a point of a line


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


class Line(NamedTuple):
    """A line on a plane.

    Attributes:
        members: (M,) marks on it.
        steps: (M,) stretch of the line that each is on.
        middle: (3,) of the marks.
        tangent: (3,) unit direction.
    """

    members: IntArray
    steps: IntArray
    middle: FloatArray
    tangent: FloatArray


def ridges(gray: ByteArray) -> tuple[IntArray, IntArray, FloatArray]:
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
    undistorted = (pixels - grid.principal) / grid.focal_px
    rays: FloatArray = np.column_stack([undistorted, np.ones(len(undistorted))]) @ view.rotation
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

    points, ahead = (
        meet(np.asarray(pixels, np.float64)),
        meet(np.asarray(pixels + along, np.float64)),
    )
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


def lines_of_plane(marks: Marks, own: IntArray, normal: FloatArray) -> list[Line]:
    """The lines on which many of a plane's (P,) marks fall, by their votes for angle and place."""
    if len(own) < MIN_PIXELS:
        return []
    basis = np.linalg.svd(normal[None])[2][1:]
    flat = FlatMarks(
        at=marks.points[own] @ basis.T,
        along=marks.directions[own] @ basis.T,
        views=marks.views[own],
        size=float(np.median(marks.sizes[own])),
        free=np.ones(len(own), bool),
    )
    lines: list[Line] = []
    for angle, place in flat.peaks():
        members, steps = flat.fitted(angle, place)
        if not len(members):
            continue
        flat.free[members] = False
        middle = marks.points[own[members]].mean(axis=0)
        off = marks.points[own[members]] - middle
        tangent = np.linalg.eigh(off.T @ off)[1][:, -1]
        lines.append(Line(own[members], steps, middle, tangent))
        if len(lines) == MAX_LINES:
            break
    return lines


@dataclass(frozen=True, kw_only=True)
class FlatMarks:
    """Marks in coordinates of their plane.

    Attributes:
        at: (P, 2) places.
        along: (P, 2) unit directions.
        views: (P,) view of each.
        size: of a pixel of the small pictures on the plane.
        free: (P,) whether no line has taken them; changes as lines are found.
    """

    at: FloatArray
    along: FloatArray
    views: IntArray
    size: float
    free: BoolArray

    def peaks(self) -> list[tuple[float, float]]:
        """Angles and places of lines with many votes, the most first."""
        angles = np.arctan2(self.along[:, 1], self.along[:, 0]) % np.pi
        across = np.cos(angles) * self.at[:, 1] - np.sin(angles) * self.at[:, 0]
        low = float(np.median(across)) - MAX_PLACES / 2 * WIDTH_PX * self.size
        columns = np.floor((across - low) / (WIDTH_PX * self.size)).astype(np.int64)
        rows = np.minimum((angles / np.pi * NUM_ANGLES).astype(np.int64), NUM_ANGLES - 1)
        kept = (columns >= 0) & (columns < MAX_PLACES)
        votes = np.zeros((NUM_ANGLES, int(columns[kept].max(initial=0)) + 1))
        np.add.at(votes, (rows[kept], columns[kept]), 1)
        votes = 9 * ndimage.uniform_filter(votes, 3, mode="constant")
        found = np.flatnonzero(votes >= MIN_PIXELS)
        order = found[np.argsort(-votes.flat[found], kind="stable")][: MAX_TRIED * MAX_LINES]
        rows, columns = np.divmod(order, votes.shape[1])
        places = low + (columns + 0.5) * WIDTH_PX * self.size
        return list(zip(((rows + 0.5) / NUM_ANGLES * np.pi).tolist(), places.tolist(), strict=True))

    def fitted(self, angle: float, place: float) -> tuple[IntArray, IntArray]:
        """Free members of a line, and their steps along it; none where too few views agree."""
        none = np.zeros(0, np.int64), np.zeros(0, np.int64)
        for _ in range(2):
            direction = np.array([np.cos(angle), np.sin(angle)])
            normal = np.array([-direction[1], direction[0]])
            near = self.free & (np.abs(self.at @ normal - place) < WIDTH_PX * self.size)
            members = np.flatnonzero(near & (np.abs(self.along @ normal) < MAX_TURN))
            if len(members) < MIN_PIXELS:
                return none
            middle = self.at[members].mean(axis=0)
            off = self.at[members] - middle
            direction = np.linalg.eigh(off.T @ off)[1][:, 1]
            angle = float(np.arctan2(direction[1], direction[0]))
            place = float(middle @ [-direction[1], direction[0]])
        steps = np.floor((self.at[members] @ direction) / (STEP_PX * self.size)).astype(np.int64)
        _, steps = np.unique(steps, return_inverse=True)
        pairs = np.unique(np.column_stack([steps, self.views[members]]), axis=0)
        enough = np.bincount(pairs[:, 0]) >= MIN_VIEWS
        if enough.sum() < MIN_STEPS:
            return none
        return members[enough[steps]], steps[enough[steps]]


def as_evidence(marks: Marks, lines: list[Line], model: Model) -> Evidence:
    """Points of straight edges at the steps of lines, one a step."""
    chosen = np.concatenate([np.zeros(0, np.int64), *(line.members for line in lines)])
    counts = [len(line.members) for line in lines]
    of_line = np.repeat(np.arange(len(lines)), counts)
    all_steps = np.concatenate([np.zeros(0, np.int64), *(line.steps for line in lines)])
    tangents = np.array([line.tangent for line in lines]).reshape(-1, 3)
    middles = np.array([line.middle for line in lines]).reshape(-1, 3)
    _, point = np.unique(np.column_stack([of_line, all_steps]), axis=0, return_inverse=True)
    point = point.reshape(-1)
    number = int(point.max(initial=-1)) + 1
    members = np.bincount(point, minlength=number)
    line_of = np.zeros(number, np.int64)
    line_of[point] = of_line
    off = marks.points[chosen] - middles[of_line]
    along = np.einsum("ij,ij->i", off, tangents[of_line])
    along = np.bincount(point, along, number) / np.maximum(members, 1)
    sizes = np.bincount(point, marks.sizes[chosen], number) / np.maximum(members, 1)
    points = middles[line_of] + along[:, None] * tangents[line_of]
    tracks = np.unique(np.column_stack([point, marks.views[chosen]]), axis=0)
    offsets = offsets_of(np.bincount(tracks[:, 0], minlength=number))
    views = tracks[:, 1].astype(np.int32)
    rays, pixels, _ = sight_of(points, offsets, views, model)
    return Evidence(
        points=points,
        tangents=tangents[line_of],
        rays=rays,
        sigmas=SIGMA_PX * sizes,
        ray_sigmas=SIGMA_PX * sizes,
        weights=STEP_PX * sizes / pixels,
        offsets=offsets,
        views=views,
    )
