"""The stages of face detection, meshing and texturing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, Picture
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D, TracedEdges
from colmap_edges.core.seen_points import joined_seen
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.meshes import TEXTURED, is_far_from_origin, write_mesh
from colmap_edges.images.background import BackgroundRays, Backgrounds
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import Detection
from colmap_edges.pipeline.paths import Paths
from colmap_edges.runtime.executors import thread_count
from colmap_edges.runtime.stages import Stages, plain_counts
from colmap_edges.surfaces.bodies import find_background, spread_bodies
from colmap_edges.surfaces.cylinders.finding import find_cylinders
from colmap_edges.surfaces.dense.cloud import DenseCloud
from colmap_edges.surfaces.extension import load_extension
from colmap_edges.surfaces.faces.evidence import gather_evidence
from colmap_edges.surfaces.faces.finding import NO_FACES, Faces, find_faces
from colmap_edges.surfaces.faces.grids import Grid, with_backgrounds, with_bodies
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.mesher import finished, mesh_with_curves
from colmap_edges.surfaces.outlines2d import Outlines2D
from colmap_edges.surfaces.patches.finding import NO_PATCHES, Patches
from colmap_edges.surfaces.revolution.finding import find_bodies
from colmap_edges.surfaces.round_evidence import FoundRound
from colmap_edges.surfaces.sky.finding import find_sky
from colmap_edges.texture.pictures import Images
from colmap_edges.texture.texturing import textured


def check_mesher(options: PipelineOptions) -> None:
    """Check that the mesher and what it needs are available, before work starts.

    Raises:
        ColmapEdgesError: if a library is not installed.
    """
    load_extension()


def background_stage(
    model: Model, detection: Detection, edges: Edges3D, options: PipelineOptions, stages: Stages
) -> BackgroundRays | None:
    """Find the background rays; None without a background."""
    masks, are_masks = detection.background_masks, options.masks_are_background
    if not any(mask.is_seen for mask in masks):
        return None
    with stages.stage("background") as stage:
        background = find_background(model, masks, are_masks, edges)
        if background:
            stage.counts = {"background_rays": len(background.cameras)}
    return background


def sky_stage(
    model: Model, edges: Edges3D, pictures: Mapping[int, Picture], stages: Stages
) -> tuple[BackgroundRays | None, Backgrounds]:
    """Find the rays of the sky in small pictures of views, and its masks; none if few show it."""
    with stages.stage("sky") as stage:
        background, shown = find_sky(model, edges, pictures) or (None, Backgrounds())
        stage.counts = {
            "images": len(pictures),
            "images_with_sky": sum(mask.is_seen for mask in shown.masks),
            "sky_rays": len(background.cameras) if background else 0,
        }
    return background, shown


def face_stage(
    model: Model,
    edges: Edges3D,
    grids: Mapping[int, Grid],
    options: PipelineOptions,
    stages: Stages,
    hidden: Backgrounds,
    round_faces: FoundRound,
) -> Faces:
    """Find the planar faces between 3D edges, none before a background or through a round face.

    `grids` are reduced images by view, `hidden` is the background of all views.
    """
    with stages.stage("faces") as stage:
        masks = hidden.masks
        bodies = spread_bodies(model.views, masks, edges.points) if masks else ()
        shown = with_backgrounds(model.views, grids, hidden)
        if round_faces.faces:
            views, points = model.views, round_faces.points.points
            shown = {v: with_bodies(views[v], grid, points) for v, grid in shown.items()}
        seed, threads = options.random_seed, thread_count(options)
        faces = find_faces(model, edges, shown, seed, threads, bodies)
        stage.counts = {
            "planes_tried": faces.num_planes,
            "cells": faces.num_cells,
            "cells_on_planes": faces.num_labelled,
            "cells_believed": faces.num_believed,
            "planar_faces": len(faces.faces),
            "area": faces.area,
            "face_points": int(np.count_nonzero(np.diff(faces.points.track_offsets))),
        }
    return replace(faces, round_faces=round_faces.faces, round_points=round_faces.points)


def round_stage(
    model: Model,
    edges: Edges3D,
    curves: Curves3D,
    outlines: Outlines2D,
    options: PipelineOptions,
    stages: Stages,
) -> FoundRound:
    """Find cylinders and other faces of revolution whose outlines are among some chains."""
    with stages.stage("round_faces") as stage:
        evidence, seed = gather_evidence(model, edges), options.random_seed
        lines, samples = outlines
        straight = find_cylinders(lines, model.views, evidence, seed)
        turned = find_bodies(samples, curves, model.views, evidence, straight.faces, seed)
        found = FoundRound(
            faces=[*straight.faces, *turned.faces],
            points=joined_seen([straight.points, turned.points]),
            num_tried=straight.num_tried + turned.num_tried,
            num_fitted=straight.num_fitted + turned.num_fitted,
        )
        stage.counts = {
            "lines": len(lines.views),
            "axes_tried": found.num_tried,
            "axes_fitted": found.num_fitted,
            "round_faces": len(found.faces),
            "round_points": len(found.points.points),
        }
    return found


def mesh_stage(
    model: Model,
    traced: TracedEdges | None,
    extended: Model,
    options: PipelineOptions,
    stages: Stages,
    background: BackgroundRays | None = None,
    faces: Faces = NO_FACES,
    patches: Patches = NO_PATCHES,
    cloud: DenseCloud | None = None,
) -> Mesh:
    """Mesh a model's points and what was found; `extended` also has the points of the edges.

    Raises:
        ColmapEdgesError: if no image observes a point.
    """
    if not len(extended.track_views) and cloud is None:
        raise ColmapEdgesError(
            f"nothing to mesh: none of the {len(extended.point3D_ids):,} points has a track; run "
            "`colmap point_triangulator` on the model first"
        )
    with stages.stage("mesh") as stage:
        curves = (traced.edges, traced.contours) if traced else (None, None)
        mesh = mesh_with_curves(
            model,
            curves,
            options.meshing,
            thread_count(options),
            background,
            faces,
            patches,
            options.refine_mesh,
            cloud,
        )
        mesh = finished(mesh, extended, options.meshing, thread_count(options))
        stage.counts = {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
        stage.counts |= {"far_from_origin": 1} if is_far_from_origin(mesh) else {}
        stage.counts["details"] = plain_counts(mesh.stats)
    return mesh


def write_mesh_stage(
    model: Model,
    mesh: Mesh,
    paths: Paths,
    folder: Path,
    formats: Sequence[str],
    options: PipelineOptions,
    stages: Stages,
    up: FloatArray,
) -> Mesh:
    """Write a mesh and return it, with a texture if a format holds it and there are images.

    `formats` are further ones in which it will be written, and `up` is the (3,) upward direction,
    for files with a convention of it.
    """
    held = any(name.upper() in TEXTURED for name in (options.mesh_type, *formats))
    if held and paths.image_path and options.texture_size and len(mesh.faces):
        with stages.stage("texture") as stage:
            images, size = Images(paths.image_path, paths.mask_path), options.texture_size
            mesh, stage.counts = textured(mesh, model.views, images, size, thread_count(options))
    write_mesh(mesh, folder / f"mesh.{options.mesh_type.lower()}", up=up)
    return mesh
