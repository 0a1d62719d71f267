"""A whole run from input folders to an output folder, with its report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.writing import check_text_names
from colmap_edges.core.upright import upward
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.errors import OptionError
from colmap_edges.export.faces import write_faces
from colmap_edges.export.formats import check_formats
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.pipeline.dense import dense_stage
from colmap_edges.pipeline.detect import GraphWriter, check_file_names, detect_stage
from colmap_edges.pipeline.found import find_edges
from colmap_edges.pipeline.mesh import check_mesher, mesh_stage, write_mesh_stage
from colmap_edges.pipeline.paths import Paths, absolute, check_paths, image_folder
from colmap_edges.pipeline.read import check_pictures, read_stage
from colmap_edges.pipeline.write import export_stage, make_report, report_stage, write_stage
from colmap_edges.report.contents import Contents
from colmap_edges.report.rerun_viewer import NO_VIEWER, Viewer
from colmap_edges.runtime.executors import Workers, open_workers
from colmap_edges.runtime.output import new_folder, write_whole
from colmap_edges.runtime.ownership import OUTPUT, file_sizes
from colmap_edges.runtime.stages import Progress, Stages, no_progress
from colmap_edges.surfaces.dense.cloud import DenseCloud
from colmap_edges.surfaces.patches.finding import NO_PATCHES


def run(
    command: str,
    paths: Paths,
    options: PipelineOptions,
    *,
    overwrite: bool = False,
    exports: Sequence[str] = (),
    progress: Progress = no_progress,
    scheduler: str = "",
    viewer: Viewer = NO_VIEWER,
) -> dict[str, Any]:
    """Run `detect`, `reconstruct` or `mesh` on folders.

    The output folder appears complete at the end, or not at all.

    Args:
        command: name of the command.
        paths: input and output paths.
        options: options of all stages.
        overwrite: replace an existing output.
        exports: further formats of edges and mesh, of `export.formats.FORMATS`.
        progress: called at every step.
        scheduler: address of a dask.distributed scheduler, whose workers do the work.
        viewer: viewer that shows intermediate results.

    Returns:
        The report, as written to report.json.

    Raises:
        ColmapEdgesError: on bad input or options.
    """
    paths = absolute(paths)
    check_paths(paths, overwrite)
    uses_images = command != "mesh" or options.use_edges
    images = image_folder(paths) if uses_images else None
    check_needs(command, paths, options, scheduler)
    check_formats(exports, uses_images)
    with (
        new_folder(paths.output_path, OUTPUT, overwrite) as folder,
        open_workers(options, paths.cache_path, scheduler) as workers,
    ):
        stages = Stages(progress)
        model, settings = read_stage(paths.input_path, stages, images), options
        viewer.show_model(model)
        cloud = dense_stage(model, paths, options, stages)
        if not uses_images:
            rest = (folder, options, stages, viewer, exports, cloud)
            contents = mesh_points_only(model, paths, *rest)
        else:
            model = model_to_trace(command, model, paths, options)
            settings = settings_of(options, model, cloud)
            given = (folder, settings, stages, workers, viewer, exports, cloud)
            contents = run_edges(command, model, paths, *given)
        export_stage(folder, contents.mesh, exports, stages, contents.up)
        report = make_report(command, paths, options, settings, stages)
        if options.report and command != "detect":
            report_stage(contents, folder, report, stages)
            report["stages"] = stages.records()
        write_record(folder, report)
    return report


def settings_of(
    options: PipelineOptions, model: Model, cloud: DenseCloud | None
) -> PipelineOptions:
    """The options for the model's scale; a dense cloud takes the place of patches."""
    settings = resolved(options, model.scale)
    return replace(settings, use_patches=False) if cloud else settings


def mesh_points_only(
    model: Model,
    paths: Paths,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
    viewer: Viewer,
    exports: Sequence[str],
    cloud: DenseCloud | None,
) -> Contents:
    """Run the stages of `mesh` without edges."""
    up = upward(model.views)
    mesh = mesh_stage(model, None, model, options, stages, cloud=cloud)
    mesh = write_mesh_stage(model, mesh, paths, folder, exports, options, stages, up)
    viewer.show_mesh(mesh)
    return Contents(model=model, mesh=mesh, up=up)


def check_needs(command: str, paths: Paths, options: PipelineOptions, scheduler: str) -> None:
    """Check that the mesher and the cache are there if they are needed.

    Raises:
        ColmapEdgesError: if one is not.
    """
    if scheduler and paths.cache_path is None:
        raise OptionError(
            "a scheduler needs cache_path, through which workers read edge graphs; give it"
        )
    if command == "mesh":
        check_mesher(options)


def write_record(folder: Path, report: dict[str, Any]) -> None:
    """Write report.json, with the list of the folder's files."""
    report["files"] = file_sizes(folder)
    text = json.dumps(report, indent=2, default=str, allow_nan=False) + "\n"
    write_whole(folder / OUTPUT.record, text.encode(), "report")


def model_to_trace(command: str, model: Model, paths: Paths, options: PipelineOptions) -> Model:
    """The model at the working scale, checked against its images."""
    check_pictures(model, image_folder(paths), paths.mask_path, paths.edge_path, options)
    if command != "detect" and options.output_type == "TXT":
        check_text_names(model)
    return at_working_scale(model, image_folder(paths), options.detection)


def run_edges(
    command: str,
    model: Model,
    paths: Paths,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
    workers: Workers,
    viewer: Viewer,
    exports: Sequence[str],
    cloud: DenseCloud | None = None,
) -> Contents:
    """Run the stages of `command` that need images, with resolved settings."""
    if command == "detect":
        check_file_names(model.views)
        writer = GraphWriter(folder, options.edge_graph)
        images, masks, maps = image_folder(paths), paths.mask_path, paths.edge_path
        detect_stage(model, images, options, stages, writer, workers, masks, maps)
        return Contents(model=model, up=upward(model.views))
    found = find_edges(
        model,
        paths,
        options,
        stages,
        workers,
        for_mesh=command == "mesh",
        with_pictures=options.report or viewer is not NO_VIEWER,
        viewer=viewer,
    )
    model, edges, faces, mesh = found.model, found.traced.edges, found.faces, None
    up = upward(model.views, found.curves)
    extended = write_stage(model, edges, found.curves, folder, options, stages, found.patches)
    if command == "mesh":
        if options.use_faces:
            in_mesh = bool(len(faces.points.points))
            path = folder / "faces.json"
            write_faces(faces.faces, model, path, in_mesh=in_mesh, round_faces=faces.round_faces)
        patches = found.patches if options.use_patches else NO_PATCHES
        given = (found.traced, extended, options, stages, found.background)
        mesh = mesh_stage(model, *given, faces, patches, cloud)
        mesh = write_mesh_stage(model, mesh, paths, folder, exports, options, stages, up)
        viewer.show_mesh(mesh)
    return Contents(
        model=model,
        pictures=found.pictures,
        edges=edges,
        curves=found.curves,
        mesh=mesh,
        faces=faces.faces,
        up=up,
    )
