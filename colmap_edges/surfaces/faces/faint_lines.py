"""Faint lines on planes, such as borders of walls and ceilings, too weak in any single image.

Intensity gradients in a cell are projected onto the plane that the cell is labelled with. Gradients
of several views coincide on a line of the plane only if they belong to it: as a mark, or as the
border to another plane, which lies on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    order_of,
    row_numbers,
)
from colmap_edges.core.view import View
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.faces.evidence import Evidence, sight_of
from colmap_edges.surfaces.faces.grids import Grid
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
MAX_TRIED = 1000  # maximum number of candidates on a plane
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


def marks_of(view: View, index: int, grid: Grid, labels: Int32Array, planes: Planes) -> Marks:
    """The marks that a view sees, by the (rows, columns) labels of its cells."""
    gray = grid.gray.astype(np.float64)
    smooth = cv2.GaussianBlur(gray, (0, 0), BLUR_PX, borderType=cv2.BORDER_REFLECT)
    points, directions, sizes, on = _kernels.marks_of(
        view.rotation,
        view.translation,
        grid.focal_px,
        grid.principal,
        smooth,
        labels,
        planes.normals,
        planes.offsets,
        MIN_SLOPE,
    )
    views = np.full(len(points), index)
    return Marks(points=points, directions=directions, sizes=sizes, planes=on, views=views)


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
    order = order_of(marks.planes, len(planes.offsets))
    rows = offsets_of(np.bincount(marks.planes, minlength=len(planes.offsets)))
    lines = [
        line
        for plane, normal in enumerate(planes.normals)
        for line in lines_of_plane(marks, order[rows[plane] : rows[plane + 1]], normal)
    ]
    return as_evidence(marks, lines, model)


def lines_of_plane(marks: Marks, own: IntArray, normal: FloatArray) -> list[Line]:
    """The lines on which many of a plane's (P,) marks fall, by their votes for angle and place."""
    if len(own) < MIN_PIXELS:
        return []
    basis = np.linalg.svd(normal[None])[2][1:]
    offsets, members, steps = _kernels.faint_lines(
        marks.points[own] @ basis.T,
        marks.directions[own] @ basis.T,
        marks.views[own],
        float(np.median(marks.sizes[own])),
        NUM_ANGLES,
        WIDTH_PX,
        MAX_PLACES,
        MAX_TURN,
        np.array([MIN_PIXELS, MIN_VIEWS, MIN_STEPS]),
        STEP_PX,
        MAX_TRIED,
    )
    lines: list[Line] = []
    for line in map(slice, offsets[:-1], offsets[1:]):
        points = marks.points[own[members[line]]]
        middle = points.mean(axis=0)
        off = points - middle
        tangent = np.linalg.eigh(off.T @ off)[1][:, -1]
        lines.append(Line(own[members[line]], steps[line], middle, tangent))
    return lines


def as_evidence(marks: Marks, lines: list[Line], model: Model) -> Evidence:
    """Points of straight edges at the steps of lines, one a step."""
    chosen = np.concatenate([np.zeros(0, np.int64), *(line.members for line in lines)])
    counts = [len(line.members) for line in lines]
    of_line = np.repeat(np.arange(len(lines)), counts)
    all_steps = np.concatenate([np.zeros(0, np.int64), *(line.steps for line in lines)])
    tangents = np.array([line.tangent for line in lines]).reshape(-1, 3)
    middles = np.array([line.middle for line in lines]).reshape(-1, 3)
    stretches = row_numbers(np.column_stack([of_line, all_steps]))
    _, point = np.unique(stretches, return_inverse=True)
    number = int(point.max(initial=-1)) + 1
    members = np.bincount(point, minlength=number)
    line_of = np.zeros(number, np.int64)
    line_of[point] = of_line
    off = marks.points[chosen] - middles[of_line]
    along = np.einsum("ij,ij->i", off, tangents[of_line])
    along = np.bincount(point, along, number) / np.maximum(members, 1)
    sizes = np.bincount(point, marks.sizes[chosen], number) / np.maximum(members, 1)
    points = middles[line_of] + along[:, None] * tangents[line_of]
    tracks = np.column_stack([point, marks.views[chosen]])
    tracks = tracks[np.unique(row_numbers(tracks), return_index=True)[1]]
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
        edge_ids=np.full(number, -1),
        offsets=offsets,
        views=views,
    )
