"""Labelling of the cells of every view with planes, by graph cuts, consistent between views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    order_of,
    owners_of,
    parts_of,
    ranks_of,
)
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import Grid, arrays_of, cell_offsets
from colmap_edges.surfaces.faces.hypotheses import MAX_SLOPE, Planes

NUM_NEIGHBORS = 12  # number of views with the most shared points, with which labels are compared
ON_TOLERANCE = 2.0  # maximum distance of a point from its plane, in standard deviations
ON_SLOPE = 3 * MAX_SLOPE  # maximum sine of the angle between a short piece of an edge and its plane
# Maximum range of the mean distances from a plane of a stretch's thirds, in tolerances. It is less
# than 2/3, the range of an edge that leaves the plane, be it straight or a parabola.
MAX_DRIFT = 0.6
REACH = 2.0  # radius of the scene, relative to the distance of the farthest points from the centre
NUM_SIDES = 16  # number of sides of the polygon around a plane's points
INNER = 0.995  # share of the points inside each side
REFINED_CELLS = 4  # from a border between larger cells, within which smaller ones get new labels
MAX_SWEEPS = 1  # sweeps of alpha expansion over all planes; a second one makes faces worse


class EvidenceWeights(NamedTuple):
    """What speaks for and against a plane in a cell, in units of a border of half a cell.

    Set by trial on corridor and rooms, `agree` and `disagree` on all random scenes
    (docs/experiments.md).
    Counts of points and of views saturate at two to three.
    """

    on: float = 1.6  # observed points that lie on the plane
    before: float = 1.5  # observed points behind the plane, which it would hide
    seen_through: float = 1.0  # views that see a point behind the plane there
    no_plane: float = 1.1  # no plane; a plane without evidence costs 1
    agree: float = 0.6  # views that took the same plane there
    disagree: float = 0.3  # views that took a plane farther away
    hidden: float = 0.5  # share of views that took a nearer plane
    correlation: float = 1.0  # gray that differs from that in other views
    inside: float = 0.15  # a place that the plane's points lie around
    depth_tolerance: float = 0.02  # share of depth by which surfaces are told apart
    missed: float = 1.5  # points on the plane that neighbouring views observe, and the view not


class BorderCosts(NamedTuple):
    """What a border between the planes of two cells costs; set by trial, as above."""

    weight: float = 3.0  # where the picture is plain
    least: float = 0.06  # part of it that is left where gray changes much
    slope_scale: float = 2.0  # gray levels a pixel at which a third of it is left
    crossing_factor: float = 0.35  # part of it where the two planes meet


def evidence_arrays(evidence: Evidence, planes: Planes, num_views: int) -> tuple[Any, ...]:
    """The kernel's arrays of planes and points, and of who observes what, whatever the pictures."""
    plane_offsets, plane_rows = planes_of_points(evidence, planes)
    observed_offsets, observed = observed_points(evidence.offsets, evidence.views, num_views)
    middle = np.median(evidence.points, axis=0)
    far = np.quantile(np.linalg.norm(evidence.points - middle, axis=1), 0.99)
    return (
        np.ascontiguousarray(planes.normals),
        planes.offsets,
        evidence.points,
        plane_offsets,
        plane_rows,
        observed_offsets,
        observed,
        *_kernels.neighbors_of(
            evidence.offsets, evidence.views, observed_offsets, observed, NUM_NEIGHBORS
        ),
        np.array([middle, [REACH * far, 0, 0]]),
        *extents_of(evidence, planes, plane_offsets, plane_rows),
    )


def make_scene(
    model: Model, grids: Sequence[Grid], known: tuple[Any, ...], num_threads: int
) -> Any:
    """The kernel's scene of views and their pictures; `known` are `evidence_arrays`."""
    return _kernels.FaceScene(
        *arrays_of(model.views, grids),
        [grid.shown for grid in grids],
        *known,
        num_threads,
    )


def label_cells(
    scene: Any, num_rounds: int, num_threads: int, weights: EvidenceWeights | None = None
) -> Int32Array:
    """Planes of the cells of all views, view by view and row by row; -1 where there is none.

    Args:
        scene: of `make_scene`.
        num_rounds: 1: each view by itself; afterwards in agreement with its neighbours.
        num_threads: threads; the result does not depend on them.
        weights: of what speaks for planes.
    """
    labels: Int32Array = scene.label(
        np.array(weights or EvidenceWeights()),
        np.array(BorderCosts()),
        num_rounds,
        MAX_SWEEPS,
        num_threads,
    )
    return labels


def refine_labels(
    scene: Any, labels: Int32Array, num_threads: int, weights: EvidenceWeights
) -> Int32Array:
    """Labels of cells half as large, near the borders of those that they were given.

    Args:
        scene: of `make_scene`, with the finer pictures.
        labels: of their cells, from the larger ones.
        num_threads: threads; the result does not depend on them.
        weights: of what speaks for planes.
    """
    borders = BorderCosts()
    refined: Int32Array = scene.refine(
        np.array(weights),
        np.array(borders._replace(weight=2 * borders.weight)),  # evidence of four, borders of two
        labels,
        REFINED_CELLS,
        MAX_SWEEPS,
        num_threads,
    )
    return refined


def split_by_view(labels: Int32Array, grids: Sequence[Grid]) -> list[Int32Array]:
    """(rows, columns) labels of each view."""
    parts = parts_of(labels, cell_offsets(grids))
    return [part.reshape(grid.shape) for part, grid in zip(parts, grids, strict=True)]


def planes_of_points(evidence: Evidence, planes: Planes) -> tuple[IntArray, Int32Array]:
    """Offsets (N + 1,) and planes, row by row, that each point lies on."""
    offsets, rows = _kernels.planes_of_points(
        evidence.points,
        evidence.tangents,
        evidence.ray_sigmas[:, None] * evidence.rays,
        evidence.sigmas,
        planes.normals,
        planes.offsets,
        ON_TOLERANCE,
        ON_SLOPE,
    )
    kept = ~only_touch(evidence, planes, offsets, rows)
    counts = np.bincount(owners_of(offsets)[kept], minlength=len(evidence.points))
    return offsets_of(counts), rows[kept]


def only_touch(
    evidence: Evidence, planes: Planes, offsets: IntArray, rows: Int32Array
) -> BoolArray:
    """(R,) whether the edge of a point only touches or crosses the plane there.

    Along a stretch of an edge that lies on a plane, distances from the plane are noise. Where they
    change steadily over much of the tolerance, the edge bends or runs away from the plane.

    Args:
        evidence: the points.
        planes: the planes.
        offsets: (N + 1,) of the planes within the tolerance of each point.
        rows: (R,) these planes, point by point.
    """
    points = owners_of(offsets)
    order = np.lexsort((points, rows))
    order = order[evidence.edge_ids[points[order]] >= 0]
    own, plane = points[order], rows[order]
    away = evidence.deviations(own, planes.normals[plane], planes.offsets[plane]) / ON_TOLERANCE
    steps = np.column_stack([np.diff(own) - 1, np.diff(plane), np.diff(evidence.edge_ids[own])])
    is_first = np.concatenate([np.ones(min(len(own), 1), bool), steps.any(axis=1)])
    counts = np.diff([*np.flatnonzero(is_first), len(own)])
    stretch = owners_of(offsets_of(counts))
    thirds = 3 * stretch + 3 * ranks_of(counts) // counts[stretch]
    sizes = np.maximum(np.bincount(thirds, minlength=3 * len(counts)), 1)
    means = (np.bincount(thirds, away, 3 * len(counts)) / sizes).reshape(-1, 3)
    passes = (np.ptp(means, axis=1) > MAX_DRIFT) & (counts >= 3)
    found = np.zeros(len(rows), bool)
    found[order] = passes[stretch]
    return found


def observed_points(
    track_offsets: IntArray, track_views: Int32Array, num_views: int
) -> tuple[IntArray, Int32Array]:
    """Offsets (V + 1,) and points, row by row, that each view observes; of points with tracks."""
    order = order_of(track_views, num_views)
    offsets = offsets_of(np.bincount(track_views, minlength=num_views))
    return offsets, owners_of(track_offsets)[order].astype(np.int32)


def extents_of(
    evidence: Evidence, planes: Planes, offsets: IntArray, rows: Int32Array
) -> tuple[FloatArray, FloatArray]:
    """Where on planes the points lie that are on them.

    A border that all of a plane's points lie on one side of is an end of it: walls do not go on
    above the ceiling, though nothing is seen to contradict it.

    Returns:
        (K * D, 3) directions on the planes, and (K * D, 2) least and largest components of the
        points in them.
    """
    num_planes = len(planes.normals)
    owners = owners_of(offsets)[order_of(rows, num_planes)]
    members = parts_of(owners, offsets_of(np.bincount(rows, minlength=num_planes)))
    angles = np.arange(NUM_SIDES // 2) * np.pi / (NUM_SIDES // 2)
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    directions, extents = [], []
    for normal, own in zip(planes.normals, members, strict=True):
        directions.append(circle @ np.linalg.svd(normal[None])[2][1:])
        at = np.ascontiguousarray((evidence.points[own] @ directions[-1].T).T)
        margin = np.median(evidence.sigmas[own]) if len(own) else 0.0
        low, high = np.quantile(at, (1 - INNER, INNER), axis=1) if len(own) else np.zeros((2, 1))
        sides = np.column_stack([low - margin, high + margin])
        extents.append(np.broadcast_to(sides, (len(circle), 2)))
    return np.concatenate(directions), np.ascontiguousarray(np.concatenate(extents))
