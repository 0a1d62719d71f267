"""A whole run from input folders to an output folder, with its report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.writing import check_text_names
from colmap_edges.edges2d.image_graphs import Visitors
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.errors import OptionError
from colmap_edges.export.faces import write_faces
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.pipeline.detect import GraphWriter, check_file_names, detect_stage
from colmap_edges.pipeline.mesh import background_stage, check_mesher, face_stage, mesh_stage
from colmap_edges.pipeline.paths import Paths, absolute, check_paths, image_folder
from colmap_edges.pipeline.read import check_pictures, read_stage
from colmap_edges.pipeline.trace import edge_stages
from colmap_edges.pipeline.write import make_report, report_stage, write_stage
from colmap_edges.report.contents import Contents
from colmap_edges.report.pictures import PictureTaker
from colmap_edges.report.rerun_viewer import NO_VIEWER, Viewer
from colmap_edges.runtime.executors import Workers, open_workers
from colmap_edges.runtime.output import new_folder, write_whole
from colmap_edges.runtime.ownership import OUTPUT, REPORT_NAME, file_sizes
from colmap_edges.runtime.stages import Progress, Stages, no_progress
from colmap_edges.surfaces.faces.finding import NO_FACES
from colmap_edges.surfaces.faces.grids import GridTaker


def run(
    command: str,
    paths: Paths,
    options: PipelineOptions,
    *,
    overwrite: bool = False,
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
    if command != "mesh" or options.use_edges:
        image_folder(paths)
    if scheduler and paths.cache_path is None:
        raise OptionError(
            "a scheduler needs cache_path, through which workers read edge graphs; give it"
        )
    if command == "mesh":
        check_mesher()
    with (
        new_folder(paths.output_path, OUTPUT, overwrite) as folder,
        open_workers(options, paths.cache_path, scheduler) as workers,
    ):
        stages = Stages(progress)
        uses_images = command != "mesh" or options.use_edges
        images = paths.image_path if uses_images else None
        model, settings = read_stage(paths.input_path, stages, images), options
        viewer.show_model(model)
        if not uses_images:
            mesh = mesh_stage(model, None, model, folder, options, stages)
            viewer.show_mesh(mesh)
            contents = Contents(model=model, mesh=mesh)
        else:
            model = model_to_trace(command, model, paths, options)
            settings = resolved(options, model.scale)
            contents = run_edges(command, model, paths, folder, settings, stages, workers, viewer)
        report = make_report(command, paths, options, settings, stages)
        if options.report and command != "detect":
            report_stage(contents, folder, report, stages)
            report["stages"] = stages.records()
        write_record(folder, report)
    return report


def write_record(folder: Path, report: dict[str, Any]) -> None:
    """Write report.json, with the list of the folder's files."""
    report["files"] = file_sizes(folder)
    text = json.dumps(report, indent=2, default=str, allow_nan=False) + "\n"
    write_whole(folder / REPORT_NAME, text.encode(), "report")


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
) -> Contents:
    """Run the stages of `command` that need images, with resolved settings."""
    images, others = image_folder(paths), (paths.mask_path, paths.edge_path)
    if command == "detect":
        check_file_names(model.views)
        writer = GraphWriter(folder, options.edge_graph)
        detect_stage(model, images, options, stages, writer, workers, *others)
        return Contents(model=model)
    wanted = options.report or viewer is not NO_VIEWER
    taker = PictureTaker(len(model.views)) if wanted else None
    grids = GridTaker() if command == "mesh" and options.use_faces else None
    visitor = Visitors.of(taker, grids)
    detection = detect_stage(model, images, options, stages, visitor, workers, *others)
    pictures = taker.pictures() if taker else ()
    for picture in pictures:
        viewer.show_picture(model.views[picture.view], picture)
    given = model
    model, traced = edge_stages(model, detection, options, stages, workers)
    detection.graphs.release()
    if model is not given:
        viewer.show_model(model)
    edges = traced.edges
    viewer.show_edges(edges, len(model.views))
    extended = write_stage(model, edges, folder, options, stages)
    mesh, background, faces = None, None, NO_FACES
    if command == "mesh":
        if options.meshing.background_weight:
            background = background_stage(model, detection, edges, options, stages)
        if grids:
            small = grids.grids
            faces = face_stage(model, edges, small, options, stages, detection, background)
            write_faces(faces.faces, model, folder / "faces.json")
            viewer.show_faces(faces.faces)
        mesh = mesh_stage(model, traced, extended, folder, options, stages, background, faces)
        viewer.show_mesh(mesh)
    return Contents(model=model, pictures=pictures, edges=edges, mesh=mesh, faces=faces.faces)
