"""Which of the labelled cells are believed, and the points that the mesher gets of them."""

from __future__ import annotations

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
from colmap_edges.surfaces.faces.labelling import EvidenceWeights
from colmap_edges.surfaces.silhouettes import SeenPoints

AGREEING_SHARE = 1 / 3  # of the views that hold the place
MAX_THROUGH = 0.1  # views that show a plane behind it, for each that agrees
MAX_HIDDEN = 0.0  # views that show a plane before it, for each that agrees: none may
NEAR_CELLS = 3.0  # within which the mesher has no two points of its own
SPACING_CELLS = 1.2  # between points of a face


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Places on planes that labelled cells see.

    Attributes:
        points: (S, 3) world units.
        sizes: (S,) sides of the cells there, world units.
        planes: (S,) int32.
        holding: (S,) int32 views in whose pictures a place lies, its own and neighbours.
        agreeing: (S,) int32 of them those that show the plane there, or one at its depth.
        through: (S,) int32 of them those that show a plane farther away.
        hidden: (S,) int32 of them those that show a nearer plane.
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
