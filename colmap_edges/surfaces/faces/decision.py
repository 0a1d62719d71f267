"""Which cells of which views show which plane, and which of it is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    offsets_of,
    order_of,
    owners_of,
)
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import Grid
from colmap_edges.surfaces.faces.hypotheses import MAX_SLOPE, Planes

ON_TOLERANCE = 2.0  # standard deviations
NUM_NEIGHBORS = 12

WEIGHTS = dict(
    on=1.6, before=1.5, behind=0.3, seen_through=1.0, seen_there=0.4, unsupported=0.6, no_plane=1.1,
    agree=1.0, disagree=1.0, hidden=0.5, correlation=1.0, depth_tolerance=0.02,
)
BORDERS = dict(weight=2.0, least=0.06, slope_scale=2.0, crossing_factor=0.35)


@dataclass(frozen=True, kw_only=True)
class Labels:
    """What the views' cells show."""

    labels: Int32Array
    offsets: IntArray


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Points of labelled cells."""

    points: FloatArray
    views: Int32Array
    cells: Int32Array
    planes: Int32Array
    agreeing: Int32Array
    through: Int32Array
    hidden: Int32Array
    holding: Int32Array
    offsets: IntArray
    seen_by: Int32Array


def neighbors_of(num_views: int, evidence: Evidence, count: int) -> list[IntArray]:
    """Of each view those that see the most of the same points."""
    owners = owners_of(evidence.offsets)
    ones = np.ones(len(owners), np.float32)
    seen = sparse.csr_matrix((ones, (evidence.views, owners)), (num_views, len(evidence.points)))
    shared = (seen @ seen.T).tolil()
    shared.setdiag(0)
    rows = []
    for v in range(num_views):
        columns, values = np.array(shared.rows[v], int), np.array(shared.data[v])
        columns, values = columns[values > 0], values[values > 0]
        order = np.argsort(-values, kind="stable")[:count]
        rows.append(columns[order])
    return rows


def planes_of_points(evidence: Evidence, planes: Planes) -> tuple[IntArray, Int32Array]:
    """Offsets and planes, row by row, that each point lies on."""
    distances = np.abs(evidence.points @ planes.normals.T - planes.offsets)
    along = (evidence.rays @ planes.normals.T) * evidence.ray_sigmas[:, None]
    near = distances <= ON_TOLERANCE * np.hypot(along, evidence.sigmas[:, None])
    near &= np.abs(evidence.tangents @ planes.normals.T) <= 3 * MAX_SLOPE
    rows, columns = np.nonzero(near)
    return offsets_of(np.bincount(rows, minlength=len(near))), columns.astype(np.int32)


def make_scene(model: Model, grids: Sequence[Grid], evidence: Evidence, planes: Planes, threads: int) -> Any:
    num_views = len(model.views)
    plane_offsets, plane_rows = planes_of_points(evidence, planes)
    owners = owners_of(evidence.offsets)
    order = order_of(evidence.views, num_views)
    observed = owners[order].astype(np.int32)
    observed_offsets = offsets_of(np.bincount(evidence.views, minlength=num_views))
    neighbors = neighbors_of(num_views, evidence, NUM_NEIGHBORS)
    center = np.median(evidence.points, axis=0)
    reach = 2.0 * np.quantile(np.linalg.norm(evidence.points - center, axis=1), 0.99)
    return _kernels.FaceScene(
        np.array([v.rotation for v in model.views]),
        np.array([v.translation for v in model.views]),
        np.array([g.focal_px for g in grids]),
        np.array([g.principal for g in grids]),
        [g.gray for g in grids],
        np.ascontiguousarray(planes.normals),
        planes.offsets,
        evidence.points,
        plane_offsets,
        plane_rows,
        observed_offsets,
        observed,
        offsets_of(np.array([len(n) for n in neighbors])),
        np.concatenate(neighbors).astype(np.int32),
        np.array([center, [reach, 0, 0]]),
        threads,
    )


def label(scene: Any, rounds: int, threads: int) -> Int32Array:
    return scene.label(np.array(list(WEIGHTS.values())), np.array(list(BORDERS.values())), rounds, 2, threads)


def samples_of(scene: Any, labels: Int32Array, threads: int) -> Samples:
    points, rows, offsets, views = scene.support(labels, WEIGHTS["depth_tolerance"], threads)
    return Samples(points=points, views=rows[:, 0], cells=rows[:, 1], planes=rows[:, 2],
        agreeing=rows[:, 3], through=rows[:, 4], hidden=rows[:, 5], holding=rows[:, 6], offsets=offsets, seen_by=views)


def accepted(samples: Samples) -> BoolArray:
    """Which samples are believed."""
    a, t, h = samples.agreeing, samples.through, samples.hidden
    return (a >= 2) & (a >= AGREE * samples.holding) & (t <= 0.15 * a) & (h <= HID * a)

AGREE, HID = 0.5, 0.3


NEAR_CELLS = 1.5


def is_lonely(samples: Samples, sizes: FloatArray, known: FloatArray) -> BoolArray:
    """Whether the mesher has less than two points of its own near a sample."""
    if len(known) < 2:
        return np.ones(len(samples.points), bool)
    distances, _ = cKDTree(known).query(samples.points, 2)
    lonely: BoolArray = distances[:, 1] > NEAR_CELLS * sizes
    return lonely


def thinned(samples: Samples, sizes: FloatArray, keep: BoolArray) -> IntArray:
    """One sample of each plane in every cube as large as a cell there is seen."""
    idx = np.flatnonzero(keep)
    if not len(idx):
        return idx
    idx = idx[np.argsort(-samples.agreeing[idx], kind="stable")]
    size = 1.2 * np.median(sizes[idx])
    cubes = np.column_stack([np.floor(samples.points[idx] / size).astype(np.int64), samples.planes[idx]])
    return np.sort(idx[np.unique(cubes, axis=0, return_index=True)[1]])
