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

THINNING_MM = 0.2
MAX_DISTANCE_MM = 20.0
_BLOCK_MM = 60.0


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


@dataclass(frozen=True, kw_only=True)
class DtuErrors:
    """The benchmark's figures in mm, over distances below 20 mm; None if not computable.

    Accuracy needs the mask. Completeness needs the plane and the box of the mask.

    Attributes:
        accuracy: Mean distance of the result inside the mask to the reference.
        completeness: Mean distance of the reference above the plane to the result.
        overall: Mean of the two.
        accuracy_median: Median of the first.
        completeness_median: Median of the second.
        points: Points of the result after thinning and inside the mask.
    """

    accuracy: float | None = None
    completeness: float | None = None
    overall: float | None = None
    accuracy_median: float | None = None
    completeness_median: float | None = None
    points: int | None = None


def sample_mesh(
    mesh: trimesh.Trimesh, spacing: float = THINNING_MM, seed: int = 0, max_points: int = 20_000_000
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


def thin(
    points: FloatArray, distance: float = THINNING_MM, seed: int = 0, chunk_size: int = 200_000
) -> FloatArray:
    """Drop points in random order until none is within `distance` of another.

    Equivalent to visiting the points in that order and keeping each without a kept neighbour.
    `chunk_size` affects only memory.
    """
    shuffled = points[np.random.default_rng(seed).permutation(len(points))]
    kept = np.empty((0, 3))
    for chunk in np.array_split(shuffled, max(1, len(shuffled) // chunk_size)):
        if len(kept):
            chunk = chunk[cloud_to_cloud(chunk, kept) > distance]
        kept = np.concatenate([kept, chunk[_first_of_each(chunk, distance)]])
    return kept


def _first_of_each(points: FloatArray, distance: float) -> BoolArray:
    """(N,) whether points have no kept point before them within `distance`."""
    keep = np.ones(len(points), dtype=bool)
    if len(points) < 2:
        return keep
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]  # each pair is (i, j) with i < j
    starts = np.searchsorted(pairs[:, 0], np.arange(len(points) + 1))
    for index in np.unique(pairs[:, 0]):
        if keep[index]:
            keep[pairs[starts[index] : starts[index + 1], 1]] = False
    return keep


def evaluate_points(points: FloatArray, reference: DtuReference) -> DtuErrors:
    """Accuracy and completeness of thinned `points` (N, 3), as far as the reference allows."""
    if reference.mask is None:
        return DtuErrors()
    inside = points[in_mask(points, reference.mask)]
    accuracy = _mean_and_median(cloud_to_cloud(inside, reference.points))
    if reference.plane is None:
        return DtuErrors(accuracy=accuracy[0], accuracy_median=accuracy[1], points=len(inside))
    above = reference.points[above_plane(reference.points, reference.plane, reference.mask.box)]
    completeness = _mean_and_median(cloud_to_cloud(above, points))
    return DtuErrors(
        accuracy=accuracy[0],
        completeness=completeness[0],
        overall=(accuracy[0] + completeness[0]) / 2,
        accuracy_median=accuracy[1],
        completeness_median=completeness[1],
        points=len(inside),
    )


def _mean_and_median(distances: FloatArray) -> tuple[float, float]:
    """Of the distances below 20 mm; NaN when there are none."""
    near = distances[distances < MAX_DISTANCE_MM]
    return (float(near.mean()), float(np.median(near))) if len(near) else (np.nan, np.nan)


def in_mask(points: FloatArray, mask: ObservedMask) -> BoolArray:
    """Which points (N, 3) fall into a true cell of the mask."""
    cells = np.floor((points - mask.box[0]) / mask.resolution + 0.5).astype(np.int64)
    inside = np.asarray(((cells >= 0) & (cells < mask.cells.shape)).all(axis=1))
    inside[inside] = mask.cells[tuple(cells[inside].T)]
    return inside


def above_plane(points: FloatArray, plane: FloatArray, box: FloatArray) -> BoolArray:
    """Which points (N, 3) are above the table and in the 60 mm blocks that cover the box."""
    low, high = box
    end = low + (np.floor((high - low) / _BLOCK_MM) + 1) * _BLOCK_MM
    above = points @ plane[:3] + plane[3] > 0
    return np.asarray(above & ((points >= low) & (points < end)).all(axis=1))


def evaluate_mesh(mesh: trimesh.Trimesh, reference: DtuReference, seed: int = 0) -> DtuErrors:
    """Accuracy and completeness of a mesh: sampled in the mask's box and thinned to 0.2 mm.

    Without a mask no figure can be computed.
    """
    if reference.mask is None:
        return DtuErrors()
    low = reference.mask.box[0] - MAX_DISTANCE_MM
    high = reference.mask.box[1] + MAX_DISTANCE_MM
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    cropped = trimesh.Trimesh(mesh.vertices, np.asarray(mesh.faces)[near], process=False)
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
