"""The stage that meshes points and edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from colmap_edges.colmap.model import Model
from colmap_edges.core.edges3d import TracedEdges
from colmap_edges.export.faces import write_faces
from colmap_edges.export.meshes import write_mesh
from colmap_edges.images.background import BackgroundMask
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.executors import thread_count
from colmap_edges.runtime.stages import Stages, plain_counts
from colmap_edges.surfaces.faces.finding import NO_FACES, find_faces
from colmap_edges.surfaces.faces.grids import Grid
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.mesher import finished, mesh_with_curves
from colmap_edges.surfaces.silhouettes import Body, find_background, spread_bodies


def check_mesher() -> None:
    """Check that the mesher is built, before work starts."""
    from colmap_edges.surfaces.mesher import load_extension

    load_extension()


def mesh_stage(
    model: Model,
    traced: TracedEdges | None,
    extended: Model,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
    background_masks: Sequence[BackgroundMask] = (),
    grids: Mapping[int, Grid] | None = None,
) -> Mesh:
    """Mesh a model's points and edges; `extended` is the model with the edges' points.

    With `grids`, the views' small pictures, planar faces are found and meshed, too.
    """
    with stages.stage("mesh") as stage:
        curves = [traced.edges, traced.contours] if traced else []
        background = None
        if traced and background_masks and options.meshing.background_weight:
            are_masks = options.masks_are_background
            background = find_background(model, background_masks, are_masks, traced.edges)
        threads = thread_count(options)
        faces = NO_FACES
        if traced and grids is not None:
            bodies: Mapping[int, Body] = {}
            if background:
                bodies = spread_bodies(model.views, background_masks, traced.edges.points)
            seen = list(bodies.values())
            faces = find_faces(model, traced.edges, grids, options.random_seed, threads, seen)
            write_faces(faces.faces, model, folder / "faces.json")
        mesh = mesh_with_curves(model, curves, options.meshing, threads, background, faces.points)
        mesh = finished(mesh, extended, options.meshing)
        write_mesh(mesh, folder / f"mesh.{options.mesh_type.lower()}")
        stage.counts = {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
        if background:
            stage.counts["background_rays"] = len(background.rays.cameras)
            stage.counts["silhouette_points"] = len(background.silhouettes.points)
        if grids is not None:
            stage.counts["planes"] = faces.num_planes
            stage.counts["planar_faces"] = len(faces.faces)
            stage.counts["face_points"] = len(faces.points.points)
            stage.counts["share_on_planes"] = faces.labelled
        stage.counts["details"] = plain_counts(mesh.stats)
    return mesh
