"""Acceptance of labelled cells that views agree on, and their points for the mesher."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    offsets_of,
)
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.grids import CELL_PX, blank_grid
from colmap_edges.surfaces.faces.labelling import EvidenceWeights
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.silhouettes import SeenPoints

AGREEING_SHARE = 2 / 3  # minimum share of agreeing views among those that contain the position
MAX_THROUGH = 0.1  # maximum number of views that see a plane behind it, per agreeing view
MAX_HIDDEN = 0.0  # maximum number of views that see a plane in front of it, per agreeing view
NEAR_CELLS = 3.0  # radius in which two other points of the mesher suppress a face point
SAME_CELLS = 0.25  # maximum distance between a triangle and the face that it represents
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


def are_alone(samples: Samples, known: FloatArray) -> BoolArray:
    """(S,) whether no two of the mesher's own (N, 3) points are near: there faces add nothing."""
    if len(known) < 2:
        return np.ones(len(samples.points), bool)
    distances, _ = cKDTree(known).query(samples.points, 2)
    alone: BoolArray = distances[:, 1] > NEAR_CELLS * samples.sizes
    return alone


def thinned(samples: Samples, chosen: IntArray) -> IntArray:
    """Of the chosen samples one of each plane in every cube of about a cell: what most agree on."""
    if not len(chosen):
        return chosen
    order = chosen[np.argsort(-samples.agreeing[chosen], kind="stable")]
    side = SPACING_CELLS * np.median(samples.sizes[order])
    cubes = np.floor(samples.points[order] / side).astype(np.int64)
    cubes = np.column_stack([cubes, samples.planes[order]])
    return np.sort(order[np.unique(cubes, axis=0, return_index=True)[1]])


def seen_points(samples: Samples, chosen: IntArray) -> SeenPoints:
    """The chosen samples as points that the agreeing views see."""
    return SeenPoints(
        samples.points[chosen],
        offsets_of(np.diff(samples.offsets)[chosen]),
        samples.views[entries_of(samples.offsets, chosen)],
    )


def lacking_points(faces: SeenPoints, views: Sequence[View], surface: Mesh) -> SeenPoints:
    """The points of faces at which a mesh has no triangle that faces the view.

    Where the mesh of points and edges is as the faces are, points on these only disturb it: a plate
    that gets points on one side alone is pierced by their cells.

    Args:
        faces: points, each with the view in which it is a cell's place first.
        views: all views.
        surface: mesh of points and edges without faces.
    """
    if not len(faces.points) or not len(surface.faces):
        return faces
    first = faces.track_views[faces.track_offsets[:-1]]
    sights = faces.points - np.array([view.center for view in views])[first]
    angles = np.array([CELL_PX / blank_grid(view).focal_px for view in views])
    sizes = np.linalg.norm(sights, axis=1) * angles[first]
    spread, normals = spread_points(surface, float(np.quantile(sizes, 0.25)))
    near = min(NUM_NEAR, len(spread))
    distances, rows = cKDTree(spread).query(faces.points, near)
    distances, rows = distances.reshape(-1, near), rows.reshape(-1, near)
    off = np.abs(np.einsum("ijk,ijk->ij", faces.points[:, None] - spread[rows], normals[rows]))
    facing = np.einsum("ijk,ik->ij", normals[rows], sights) < 0
    here = facing & (off <= SAME_CELLS * sizes[:, None]) & (distances <= 2 * sizes[:, None])
    lacking = np.flatnonzero(~here.any(axis=1))
    return SeenPoints(
        faces.points[lacking],
        offsets_of(np.diff(faces.track_offsets)[lacking]),
        faces.track_views[entries_of(faces.track_offsets, lacking)],
    )


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
