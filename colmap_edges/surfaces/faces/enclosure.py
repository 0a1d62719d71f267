"""Test of whether labelled cells are enclosed by observed points of their plane.

Labels spread over plain regions, and beyond the end of a wall also over a backdrop, where nothing
contradicts them. Between its observed points a plane probably continues; beyond them it may not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, Int32Array
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.faces.decision import Samples
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import Grid
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import extents_of, observed_points, planes_of_points

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
    num_threads: int = 1,
) -> BoolArray:
    """(S,) whether most of the agreeing views show a place on a piece between what is observed.

    Args:
        samples: places that labelled cells see.
        labels: of the cells of all views.
        model: gives the V views.
        grids: (V,) their small pictures.
        evidence: points, and who observes them.
        planes: of the labels.
        num_threads: threads; the result does not depend on them.
    """
    num_views = len(model.views)
    plane_offsets, plane_rows = planes_of_points(evidence, planes)
    counts = _kernels.count_enclosing(
        np.array([view.rotation for view in model.views]),
        np.array([view.translation for view in model.views]),
        np.array([grid.focal_px for grid in grids]),
        np.array([grid.principal for grid in grids]),
        np.array([grid.shape for grid in grids], np.int32),
        labels,
        planes.normals,
        planes.offsets,
        evidence.points,
        plane_offsets,
        plane_rows,
        *observed_points(evidence, num_views),
        *extents_of(evidence, planes, plane_offsets, plane_rows),
        samples.points,
        np.ascontiguousarray(samples.planes),
        samples.offsets,
        samples.views,
        np.array(DIRECTIONS, np.int32),
        MAX_OPEN,
        ENCLOSED_SHARE,
        num_threads,
    )
    most: BoolArray = counts >= ENCLOSED_SHARE * np.diff(samples.offsets)
    return most
