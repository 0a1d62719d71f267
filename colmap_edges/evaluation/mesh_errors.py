"""Errors of a mesh, and of points, against depth maps, a mesh, a point cloud, or SfM points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import pictures
from colmap_edges.evaluation.metrics import clouds, depth, dtu_distances, edges, normals
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_mesh
from colmap_edges.evaluation.metrics.statistics import Record, mean, summarize
from colmap_edges.evaluation.scenes import Reference, reference_of


def evaluate_mesh(
    mesh_path: Path,
    input_path: Path,
    reference_path: Path | None = None,
    *,
    view_names: Sequence[str] = (),
    thresholds: Sequence[float] = (),
    pictures_path: Path | None = None,
) -> Record:
    """Measure a mesh against reference depth maps, a mesh, a point cloud, or SfM points.

    Args:
        mesh_path: The mesh.
        input_path: COLMAP model with the views. Without a reference, its points are the
            reference: they are held out only if the mesh was made without them.
        reference_path: Folder of depth maps (*.npz), mesh or point cloud file, or none.
        view_names: Views in which a reference mesh is rendered; default: the central one.
        thresholds: Distances for precision, recall and F of cloud references, in world units;
            default: 0.1, 0.2, 0.5 and 1 % of the diagonal of the reference's box.
        pictures_path: Folder for error maps.

    Returns:
        The content of `evaluation.json`.
    """
    model, mesh = load_model(input_path), load_mesh(mesh_path)
    record: Record = {"mesh": str(mesh_path), "faces": len(mesh.faces), "unit": "world unit"}
    caster = RayCaster(mesh.vertices, mesh.faces)
    if reference_path is None:
        if not len(model.points3D_xyz):
            raise ColmapEdgesError(
                "without a reference the model must hold points, and it has none"
            )
        return record | {"points_depth": depth.observation_depth_statistics(caster, model)}
    reference = reference_of(reference_path, view_names, model)
    if reference.points is not None:
        return record | against_cloud(mesh, reference.points, thresholds)
    record["depth"] = against_depth(caster, reference.depths, pictures_path)
    if reference.surface is None:
        return record
    return record | against_cloud(mesh, sample_surface(reference.surface), thresholds)


def sample_surface(mesh: Any, count: int = 200_000) -> FloatArray:
    """`count` points (count, 3) spread over a surface by area."""
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(plain, count, seed=0)[0], dtype=np.float64)


def against_depth(
    caster: RayCaster, references: Sequence[depth.ReferenceDepth], pictures_path: Path | None
) -> Record:
    """Depth errors of all views together (`pooled`), of `views`, and the `mean_of_views`."""
    results = [depth.depth_errors(caster, reference) for reference in references]
    if pictures_path is not None:
        pictures.write_error_maps(pictures_path, results)
    views = {result.name: result.record() for result in results}
    means = {
        name: mean([view[name] for view in views.values() if name in view])
        for name in ("coverage", *depth.RIGHT_WITHIN, *normals.NORMALS_WITHIN)
        if any(name in view for view in views.values())
    }
    return {"pooled": depth.pool(results), "mean_of_views": means, "views": views}


def against_cloud(mesh: Any, points: FloatArray, thresholds: Sequence[float]) -> Record:
    """Distances from samples of a mesh to the points (N, 3) of a reference, and back."""
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    thresholds = thresholds or [share * diagonal for share in (0.001, 0.002, 0.005, 0.01)]
    to_reference = clouds.cloud_to_cloud(sample_surface(mesh), points)
    to_mesh = clouds.cloud_to_mesh(points, mesh.vertices, mesh.faces)
    return {
        "accuracy": summarize(to_reference),
        "completeness": summarize(to_mesh),
        "scores": clouds.scores(to_reference, to_mesh, thresholds),
    }


def measure(
    mesh: Any,
    points: Model,
    reference: Reference,
    maps_path: Path | None,
    *,
    sfm_points: Model | None = None,
) -> Record:
    """Errors of a mesh and of its points, for the paper's tables.

    Args:
        mesh: Triangle mesh with vertices and faces.
        points: The points added by a method, or all points if it adds none.
        reference: The reference.
        maps_path: Folder for error maps, or None.
        sfm_points: The SfM points to which `points` are added.
    """
    errors, of = point_errors(points, reference)
    record: Record = {"faces": len(mesh.faces), "notes": list(reference.notes)}
    record["points"] = point_record(errors, of, len(points.points3D_xyz))
    record["all_points"] = record["points"]
    if sfm_points is not None:
        errors = np.concatenate([point_errors(sfm_points, reference)[0], errors])
        count = len(sfm_points.points3D_xyz) + len(points.points3D_xyz)
        record["all_points"] = point_record(errors, of, count)
    if reference.depths:
        caster = RayCaster(mesh.vertices, mesh.faces)
        record["mesh"] = against_depth(caster, reference.depths, maps_path)["pooled"]
    if reference.dtu is not None:
        record["dtu"] = dtu_distances.evaluate_mesh(mesh, reference.dtu)
    return record


def point_errors(points: Model, reference: Reference) -> tuple[FloatArray, str]:
    """Errors of points against the reference, and their kind; empty without a reference."""
    xyz = points.points3D_xyz
    if reference.points is not None:
        return clouds.cloud_to_cloud(xyz, reference.points), "distance to the cloud"
    if reference.surface is not None:
        mesh = reference.surface
        distances = clouds.cloud_to_mesh(xyz, mesh.vertices, mesh.faces)
        return distances, "distance to the mesh"
    if reference.depths:
        errors = edges.depth_window_errors(points, reference.depths, relative=False)
        return errors, "depth in observing views"
    return np.empty(0), ""


def point_record(errors: FloatArray, of: str, count: int) -> Record:
    """Statistics of errors (N,), their kind, and the number of points."""
    return (summarize(errors) | {"of": of} if of else {}) | {"count": count}
