"""Distances between clouds and meshes: CloudCompare's, and Tanks and Temples' scores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import extra
from colmap_edges.evaluation.metrics.statistics import Record


def cloud_to_cloud(points: FloatArray, reference: FloatArray) -> FloatArray:
    """Distance (N,) from each of `points` (N, k) to the nearest of `reference` (M, k).

    CloudCompare's C2C without a local model. Infinite when the reference is empty.
    """
    if not len(reference):
        return np.full(len(points), np.inf)
    distance, _ = cKDTree(reference).query(points, workers=2)
    return np.asarray(distance, dtype=np.float64)


def cloud_to_mesh(points: FloatArray, vertices: NDArray[Any], faces: NDArray[Any]) -> FloatArray:
    """Distance (N,) from each of `points` (N, 3) to the surface (CloudCompare's C2M, unsigned)."""
    with extra("the distance to a mesh", "evaluation"):
        import pymeshlab
    if not len(points):
        return np.empty(0)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(np.asarray(points, dtype=np.float64)))
    meshes.add_mesh(
        pymeshlab.Mesh(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32))
    )
    meshes.compute_scalar_by_distance_from_another_mesh_per_vertex(
        measuremesh=0, refmesh=1, signeddist=False
    )
    return np.asarray(meshes.mesh(0).vertex_scalar_array(), dtype=np.float64)


def shares_below(distances: FloatArray, thresholds: Sequence[float]) -> list[float]:
    """Share of `distances` (N,) below each threshold; 0 without distances."""
    return [float(np.mean(distances < t)) if len(distances) else 0.0 for t in thresholds]


def score(threshold: float, precision: float, recall: float) -> Record:
    """`threshold`, `precision`, `recall` and their harmonic mean `f_score`."""
    total = precision + recall
    f_score = 2 * precision * recall / total if total > 0 else 0.0
    return {
        "threshold": threshold,
        "precision": precision,
        "recall": recall,
        "f_score": f_score,
    }


def scores(
    to_reference: FloatArray, to_result: FloatArray, thresholds: Sequence[float]
) -> list[Record]:
    """Scores of distances result -> reference (N,) and reference -> result (M,) at thresholds.

    Tanks and Temples' definition, with the thresholds as its tau.
    """
    precisions, recalls = (shares_below(d, thresholds) for d in (to_reference, to_result))
    return [score(*row) for row in zip(thresholds, precisions, recalls, strict=True)]
