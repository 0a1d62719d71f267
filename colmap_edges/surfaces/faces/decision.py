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
    offsets_of,
    order_of,
    parts_of,
    ranks_of,
    row_numbers,
)
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import CELL_PX, Grid, blank_grid, cells_in
from colmap_edges.surfaces.faces.labelling import EvidenceWeights, observed_points
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.silhouettes import NO_POINTS, SeenPoints

AGREEING_SHARE = 1 / 2  # minimum share of agreeing views among those that contain the position
MAX_THROUGH = 0.1  # maximum number of views that see a plane behind it, per agreeing view
MAX_HIDDEN = 0.2  # maximum number of views that see a plane in front of it, per agreeing view
# Minimum share of the accepted cells that are PLAIN_CELLS or farther from all observed points:
# where points lie on most faces, the mesh follows them, and faces add their errors only.
MIN_PLAIN = 1 / 4
PLAIN_CELLS = 2.0
MIN_LACKING_OF_PLANE = 1 / 5  # minimum share of a plane's area that a mesh lacks
SAME_CELLS = 0.25  # maximum distance between a triangle and the face that it represents
EACH_VIEW = 3  # one in so many agreeing views gives a point a ray
NUM_NEAR = 8  # nearest samples of triangles that a face point is compared with
MAX_SPREAD = 300_000  # number of samples of triangles, in addition to one for each triangle
STEPS = np.array([0.7548776662466927, 0.5698402909980532])  # of the low-discrepancy sequence R2
SPACING_CELLS = 1.2  # distance between points of a face


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Places on planes that labelled cells see.

    Attributes:
        points: (S, 3) world units.
        sizes: (S,) sides of the cells there, world units.
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
    own = samples.views[samples.offsets[:-1]]
    sampled = parts_of(
        order_of(own, len(views)), offsets_of(np.bincount(own, minlength=len(views)))
    )
    offsets, observed = observed_points(evidence, len(views))
    plain = np.zeros(len(samples.points), bool)
    for view, grid, rows, seen in zip(
        views, grids, sampled, parts_of(observed, offsets), strict=True
    ):
        open_ = np.ones(np.array(grid.gray.shape) // CELL_PX, np.uint8)
        open_[cells_in(view, grid, evidence.points[seen])] = 0
        distances = cv2.distanceTransform(open_, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        plain[rows] = distances[cells_in(view, grid, samples.points[rows])] >= PLAIN_CELLS
    return plain


def thinned(samples: Samples, accepted: IntArray) -> IntArray:
    """One sample of each plane in every cube of about a cell: the one that most views agree on.

    Args:
        samples: all samples.
        accepted: indices of those to choose from.

    Returns:
        (P,) chosen samples.
    """
    if not len(accepted):
        return accepted
    order = accepted[np.argsort(-samples.agreeing[accepted], kind="stable")]
    side = SPACING_CELLS * np.median(samples.sizes[order])
    cubes = np.floor(samples.points[order] / side).astype(np.int64)
    cubes = np.column_stack([cubes, samples.planes[order]])
    _, first = np.unique(row_numbers(cubes), return_index=True)
    chosen: IntArray = order[np.sort(first)]
    return chosen


@dataclass(frozen=True, kw_only=True)
class FacePoints:
    """Points on faces for the mesher.

    Attributes:
        seen: P points; the first view of each is the one in which it is sampled.
        planes: (P,) int32 planes that they lie on.
    """

    seen: SeenPoints
    planes: Int32Array


NO_FACE_POINTS = FacePoints(seen=NO_POINTS, planes=np.zeros(0, np.int32))


def points_of_samples(samples: Samples, accepted: IntArray) -> FacePoints:
    """Accepted samples, thinned, as points that some of the agreeing views see."""
    chosen = thinned(samples, accepted)
    counts = np.diff(samples.offsets)[chosen]
    entries = entries_of(samples.offsets, chosen)[ranks_of(counts) % EACH_VIEW == 0]
    seen = SeenPoints(
        samples.points[chosen], offsets_of(-(-counts // EACH_VIEW)), samples.views[entries]
    )
    return FacePoints(seen=seen, planes=samples.planes[chosen])


def lacking_points(faces: FacePoints, views: Sequence[View], surface: Mesh) -> SeenPoints:
    """All points of those planes of which a mesh lacks at least `MIN_LACKING_OF_PLANE`.

    Points on faces that a mesh already has disturb it: a plate that gets points on one side alone
    is pierced by their cells.

    Args:
        faces: points on faces.
        views: all views.
        surface: mesh of points and edges without faces.
    """
    seen = faces.seen
    lacking = np.bincount(faces.planes, gaps_to_mesh(seen, views, surface) > SAME_CELLS)
    share = lacking / np.maximum(np.bincount(faces.planes), 1)
    chosen = np.flatnonzero(share[faces.planes] >= MIN_LACKING_OF_PLANE)
    return SeenPoints(
        seen.points[chosen],
        offsets_of(np.diff(seen.track_offsets)[chosen]),
        seen.track_views[entries_of(seen.track_offsets, chosen)],
    )


def gaps_to_mesh(points: SeenPoints, views: Sequence[View], surface: Mesh) -> FloatArray:
    """(P,) distances to triangles that face the points' first views, in sides of those' cells.

    Infinite where no such triangle is near.
    """
    if not len(surface.faces):
        return np.full(len(points.points), np.inf)
    first = points.track_views[points.track_offsets[:-1]]
    sights = points.points - np.array([view.center for view in views])[first]
    angles = np.array([CELL_PX / blank_grid(view).focal_px for view in views])
    sizes = np.linalg.norm(sights, axis=1) * angles[first]
    spread, normals = spread_points(surface, float(np.quantile(sizes, 0.25)))
    near = min(NUM_NEAR, len(spread))
    distances, rows = cKDTree(spread).query(points.points, near)
    distances, rows = distances.reshape(-1, near), rows.reshape(-1, near)
    off = np.abs(np.einsum("ijk,ijk->ij", points.points[:, None] - spread[rows], normals[rows]))
    facing = np.einsum("ijk,ik->ij", normals[rows], sights) < 0
    here = facing & (distances <= 2 * sizes[:, None])
    gaps: FloatArray = np.where(here, off / sizes[:, None], np.inf).min(axis=1)
    return gaps


def spread_points(surface: Mesh, spacing: float) -> tuple[FloatArray, FloatArray]:
    """Points (P, 3) on a mesh about `spacing` apart, and the unit normals (P, 3) there."""
    corners = surface.vertices[surface.faces].astype(np.float64)
    sides = corners[:, 1:] - corners[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    doubled = np.linalg.norm(normals, axis=1)
    areas = doubled / 2
    spacing = max(spacing, float(np.sqrt(areas.sum() / MAX_SPREAD)))
    counts = np.ceil(areas / spacing**2).astype(np.int64)
    triangle = np.repeat(np.arange(len(counts)), counts)
    one, other = (STEPS[:, None] * np.arange(1, len(triangle) + 1)) % 1
    beyond = one + other > 1
    one, other = np.where(beyond, 1 - one, one), np.where(beyond, 1 - other, other)
    points = corners[triangle, 0] + one[:, None] * sides[triangle, 0]
    points += other[:, None] * sides[triangle, 1]
    return points, normals[triangle] / doubled[triangle, None]
