"""Acceptance of labelled cells that views agree on, and their points for the mesher."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    medians_of,
    offsets_of,
    owners_of,
    parts_of,
    ranks_of,
    row_numbers,
)
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import CELL_PX, CLIPPED, Grid, cells_in
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import ON_TOLERANCE, EvidenceWeights, observed_points

AGREEING_SHARE = 1 / 2  # minimum share of agreeing views among those that contain the position
MAX_THROUGH = 0.1  # maximum number of views that see a plane behind it, per agreeing view
MAX_HIDDEN = 0.2  # maximum number of views that see a plane in front of it, per agreeing view
# Minimum share of the accepted cells that are PLAIN_CELLS or farther from all observed points:
# where points lie on most faces, the mesh follows them, and faces add their errors only.
MIN_PLAIN = 1 / 10
PLAIN_CELLS = 2.0
# Maximum share of the accepted cells that are overexposed and next to a point before their plane:
# 0.27 of a white block on a white ground, 0 of a white box, below 0.07 of rooms.
MAX_CLIPPED = 0.15
EACH_VIEW = 3  # one in so many agreeing views gives a point a ray
SPACING_CELLS = 1.2  # distance between points of a face
BORDER_SPACING_CELLS = 0.85  # next to small cells with another label, where surfaces may end


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Places on planes that labelled cells see.

    Attributes:
        points: (S, 3) world units.
        sizes: (S,) sides of the cells there, world units.
        cells: (S,) int32 labelled cells, row by row, in the views that come first in `views`.
        planes: (S,) int32.
        holding: (S,) int32 views on the same side of the plane in whose pictures a place lies, its
            own and neighbours.
        agreeing: (S,) int32 of them those that show the plane there, or one at its depth.
        through: (S,) int32 views, on either side, that show a plane farther away.
        hidden: (S,) int32 of the holding views those that show a nearer plane.
        offsets: (S + 1,) of the agreeing views.
        views: (T,) int32 agreeing views, row by row.
    """

    points: FloatArray
    sizes: FloatArray
    cells: Int32Array
    planes: Int32Array
    holding: Int32Array
    agreeing: Int32Array
    through: Int32Array
    hidden: Int32Array
    offsets: IntArray
    views: Int32Array


def sample_cells(
    scene: Any, labels: Int32Array, centers: FloatArray, cell_angles: FloatArray, num_threads: int
) -> Samples:
    """The places that labelled cells see, and what other views say of them.

    Args:
        scene: of `make_scene`.
        labels: of the cells of all views.
        centers: (V, 3) of the views.
        cell_angles: (V,) side of a cell over the focal length.
        num_threads: threads.
    """
    points, rows, offsets, views = scene.support(
        labels, EvidenceWeights().depth_tolerance, num_threads
    )
    view = rows[:, 0]
    return Samples(
        points=points,
        sizes=np.linalg.norm(points - centers[view], axis=1) * cell_angles[view],
        cells=rows[:, 1],
        planes=rows[:, 2],
        agreeing=rows[:, 3],
        through=rows[:, 4],
        hidden=rows[:, 5],
        holding=rows[:, 6],
        offsets=offsets,
        views=views,
    )


def are_believed(samples: Samples) -> BoolArray:
    """(S,) whether enough views show the plane there, and few see through it or before it.

    That few see a nearer plane matters most: walls run on behind the next wall.
    """
    agreeing = samples.agreeing
    enough = agreeing >= AGREEING_SHARE * samples.holding
    free = samples.through <= MAX_THROUGH * agreeing
    believed: BoolArray = enough & free & (samples.hidden <= MAX_HIDDEN * agreeing)
    return believed


def are_plain(
    samples: Samples, views: Sequence[View], grids: Sequence[Grid], evidence: Evidence
) -> BoolArray:
    """(S,) whether a place is `PLAIN_CELLS` or farther from all points that its view observes."""
    sampled = rows_by_view(samples.views[samples.offsets[:-1]], len(views))
    offsets, observed = observed_points(evidence.offsets, evidence.views, len(views))
    plain = np.zeros(len(samples.points), bool)
    for view, grid, rows, seen in zip(
        views, grids, sampled, parts_of(observed, offsets), strict=True
    ):
        open_ = np.ones(grid.shape, np.uint8)
        open_[cells_in(view, grid, evidence.points[seen])] = 0
        distances = cv2.distanceTransform(open_, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        plain[rows] = distances[cells_in(view, grid, samples.points[rows])] >= PLAIN_CELLS
    return plain


def are_overexposed(
    samples: Samples,
    accepted: IntArray,
    planes: Planes,
    views: Sequence[View],
    grids: Sequence[Grid],
    evidence: Evidence,
) -> bool:
    """Whether too many of (N,) accepted samples are of white cells next to points before them.

    A white body before a white ground has no outline there, and views agree on the ground. What is
    seen of its edges lies before the ground, while those of a white face lie on it or behind it.
    """
    own = samples.views[samples.offsets[accepted]]
    clipped = grays_at(samples.points[accepted], own, views, grids) >= CLIPPED
    if clipped.mean() <= MAX_CLIPPED:
        return False
    white, seeing = accepted[clipped], own[clipped]
    near = nearest_observed(samples.points[white], seeing, views, grids, evidence)
    normals, offsets = planes.normals[samples.planes[white]], planes.offsets[samples.planes[white]]
    centers = np.array([view.center for view in views])[seeing]
    sides = np.sign(np.einsum("ij,ij->i", centers, normals) - offsets)
    are_before = sides * evidence.deviations(near, normals, offsets) > ON_TOLERANCE
    return bool(np.sum(are_before) > MAX_CLIPPED * len(accepted))


def nearest_observed(
    places: FloatArray,
    seeing: Int32Array,
    views: Sequence[View],
    grids: Sequence[Grid],
    evidence: Evidence,
) -> IntArray:
    """(N,) the point nearest to each of (N, 3) places in the picture of the (N,) view seeing it.

    Only points that the view observes; the first point if it observes none.
    """
    near = np.zeros(len(places), np.int64)
    offsets, rows = observed_points(evidence.offsets, evidence.views, len(views))
    sampled = rows_by_view(seeing, len(views))
    for view, grid, own, seen in zip(views, grids, sampled, parts_of(rows, offsets), strict=True):
        if len(own) and len(seen):
            tree = cKDTree(grid.pixels_of(view, evidence.points[seen]))
            near[own] = seen[tree.query(grid.pixels_of(view, places[own]))[1]]
    return near


def thinned(samples: Samples, accepted: IntArray, near_border: BoolArray, side: int) -> IntArray:
    """One sample of each plane in every cube of about a cell: the one that most views agree on.

    Args:
        samples: S samples.
        accepted: indices of those to choose from.
        near_border: (S,) where surfaces may end, and cubes are smaller.
        side: small cells along a side of a cell.

    Returns:
        (P,) chosen samples.
    """
    if not len(accepted):
        return accepted
    order = accepted[np.argsort(-samples.agreeing[accepted], kind="stable")]
    spacings = np.where(near_border[order], BORDER_SPACING_CELLS, SPACING_CELLS)
    sides = spacings * side * np.median(samples.sizes[order])
    cubes = np.floor(samples.points[order] / sides[:, None]).astype(np.int64)
    cubes = np.column_stack([cubes, samples.planes[order], near_border[order]])
    _, first = np.unique(row_numbers(cubes), return_index=True)
    chosen: IntArray = order[np.sort(first)]
    return chosen


def points_of_samples(
    samples: Samples, chosen: IntArray, views: Sequence[View], grids: Sequence[Grid]
) -> SeenPoints:
    """Samples as points that some agreeing views see.

    These are the views that show most nearly the middle gray of all that agree. What stands before
    a plane and was labelled as part of it differs from what other views see of the plane there.

    Args:
        samples: all samples.
        chosen: (N,) indices of those that become points.
        views: all views.
        grids: their small pictures.
    """
    counts = np.diff(samples.offsets)[chosen]
    offsets, entries = offsets_of(counts), entries_of(samples.offsets, chosen)
    owners, seeing = owners_of(offsets), samples.views[entries]
    gray = grays_at(samples.points[chosen][owners], seeing, views, grids)
    off = gray - medians_of(gray, owners, len(counts))[owners]
    for rows in rows_by_view(seeing, len(views)):
        off[rows] -= np.median(off[rows]) if len(rows) else 0.0  # exposures differ
    order = np.lexsort((np.abs(off - medians_of(off, owners, len(counts))[owners]), owners))
    kept = -(-counts // EACH_VIEW)
    rays = np.sort(order[ranks_of(counts) < kept[owners]])
    return SeenPoints(samples.points[chosen], offsets_of(kept), seeing[rays])


def grays_at(
    points: FloatArray, seeing: Int32Array, views: Sequence[View], grids: Sequence[Grid]
) -> FloatArray:
    """(N,) mean gray of the cell around each of (N, 3) points in the (N,) view that sees it."""
    gray = np.zeros(len(points))
    for view, grid, rows in zip(views, grids, rows_by_view(seeing, len(views)), strict=True):
        means = cv2.blur(grid.gray.astype(np.float32), (CELL_PX, CELL_PX))
        last = np.array(means.shape[::-1]) - 1
        at = np.clip(np.floor(grid.pixels_of(view, points[rows])), 0, last).astype(np.int64)
        gray[rows] = means[at[:, 1], at[:, 0]]
    return gray
