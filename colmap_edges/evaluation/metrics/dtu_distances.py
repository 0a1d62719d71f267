"""The distances of DTU's benchmark: accuracy and completeness of a mesh, in millimetres.

Reference: Jensen, Dahl, Vogiatzis, Tola, Aanaes, Large scale multi-view stereopsis evaluation,
CVPR 2014.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.clouds import cloud_to_cloud
from colmap_edges.evaluation.metrics.statistics import Record, mean

THINNED_AT_ONCE = 4096  # points whose neighbours are searched in one call; no result depends on it


@dataclass(frozen=True, kw_only=True)
class ObservedMask:
    """The region seen by the cameras and the scanner (the official ObsMask).

    Attributes:
        cells: (X, Y, Z) whether a cell is seen; cell i is centred on box[0] + i resolution.
        box: (2, 3) lowest and highest corner.
        resolution: Side of a cell.
    """

    cells: BoolArray
    box: FloatArray
    resolution: float


@dataclass(frozen=True, kw_only=True)
class DtuReference:
    """Structured-light reference of one scan.

    Attributes:
        points: (N, 3) surface points.
        mask: The seen region; None if the release holds no ObsMask of the scan.
        plane: (4,) the table; points with plane . (x, y, z, 1) > 0 are above it. None where the
            release holds no Plane of the scan.
    """

    points: FloatArray
    mask: ObservedMask | None = None
    plane: FloatArray | None = None


def sample_mesh(
    mesh: trimesh.Trimesh, spacing: float = 0.2, seed: int = 0, max_points: int = 20_000_000
) -> FloatArray:
    """Points on a mesh, denser than one per `spacing`.

    Two random points for every square of side `spacing` (six within it of any place, on average),
    and the vertices.

    Raises:
        ColmapEdgesError: The mesh is so large that more than `max_points` were needed.
    """
    count = int(np.ceil(2 * mesh.area / spacing**2))
    if count > max_points:
        raise ColmapEdgesError(
            f"the mesh needs {count:,} samples every {spacing} mm; crop it to the scene first"
        )
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return np.concatenate([np.asarray(mesh.vertices), np.asarray(points)])


def thin(points: FloatArray, distance: float = 0.2, seed: int = 0) -> FloatArray:
    """Keep, in random order, each of the points (N, 3) without a kept one within `distance`."""
    shuffled = points[np.random.default_rng(seed).permutation(len(points))]
    tree, kept = cKDTree(shuffled), np.ones(len(shuffled), dtype=bool)
    for start in range(0, len(shuffled), THINNED_AT_ONCE):
        rows = start + np.flatnonzero(kept[start : start + THINNED_AT_ONCE])
        neighbors = tree.query_ball_point(shuffled[rows], distance)
        for row, near in zip(rows, neighbors, strict=True):
            if kept[row]:
                kept[near] = False
                kept[row] = True
    return np.asarray(shuffled[kept])


def evaluate_points(points: FloatArray, reference: DtuReference) -> Record:
    """The benchmark's figures of thinned `points` (N, 3) in mm, over distances below 20 mm.

    Returns:
        Mean distance `accuracy` of the points inside the mask to the reference, and their number
        `points`; nothing without a mask. With a plane, mean distance `completeness` of the
        reference above it to the points, and the mean `overall` of the two. Also the medians
        `accuracy_median` and `completeness_median`.
    """
    if reference.mask is None:
        return {}
    inside = points[in_mask(points, reference.mask)]
    record = _near("accuracy", cloud_to_cloud(inside, reference.points)) | {"points": len(inside)}
    if reference.plane is None:
        return record
    above = reference.points[above_plane(reference.points, reference.plane, reference.mask.box)]
    record |= _near("completeness", cloud_to_cloud(above, points))
    return record | {"overall": (record["accuracy"] + record["completeness"]) / 2}


def _near(name: str, distances: FloatArray) -> Record:
    """Mean and median of the distances below 20 mm; NaN when there are none."""
    near = distances[distances < 20.0]
    return {name: mean(near), f"{name}_median": float(np.median(near)) if len(near) else np.nan}


def in_mask(points: FloatArray, mask: ObservedMask) -> BoolArray:
    """Which points (N, 3) fall into a true cell of the mask."""
    cells = np.floor((points - mask.box[0]) / mask.resolution + 0.5).astype(np.int64)
    inside = np.asarray(((cells >= 0) & (cells < mask.cells.shape)).all(axis=1))
    inside[inside] = mask.cells[tuple(cells[inside].T)]
    return inside


def above_plane(points: FloatArray, plane: FloatArray, box: FloatArray) -> BoolArray:
    """Which points (N, 3) are above the table and in the 60 mm blocks that cover the box."""
    low, high = box
    end = low + (np.floor((high - low) / 60.0) + 1) * 60.0
    above = points @ plane[:3] + plane[3] > 0
    return np.asarray(above & ((points >= low) & (points < end)).all(axis=1))


def evaluate_mesh(mesh: trimesh.Trimesh, reference: DtuReference, seed: int = 0) -> Record:
    """`evaluate_points` of a mesh, sampled in the mask's box and thinned to 0.2 mm."""
    if reference.mask is None:
        return {}
    low, high = reference.mask.box + np.array([[-20.0], [20.0]])
    corners = mesh.vertices[mesh.faces]
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    cropped = trimesh.Trimesh(mesh.vertices, mesh.faces[near], process=False)
    samples = sample_mesh(cropped, seed=seed)
    samples = samples[((samples >= low) & (samples <= high)).all(axis=1)]
    return evaluate_points(thin(samples, seed=seed), reference)


def missing_data_notes(reference: DtuReference) -> list[str]:
    """Sentences on why figures of the benchmark are missing; empty if none is."""
    if reference.mask is None:
        return ["No ObsMask of this scan: DTU's accuracy and completeness are left empty."]
    if reference.plane is None:
        return ["No Plane of this scan: DTU's completeness and overall are left empty."]
    return []
