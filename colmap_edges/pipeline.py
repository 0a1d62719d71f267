"""The stages in order: read, detect, trace, write, mesh; and the report of what they did."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

import colmap_edges
from colmap_edges.detection import Chains, detect_chains
from colmap_edges.diagnosis import Finding, diagnose, funnel
from colmap_edges.edge_graph import EdgeGraph, build_edge_graph
from colmap_edges.edge_io import write_dxf, write_glb, write_json, write_obj, write_ply
from colmap_edges.edges import Edges3D
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.graph_store import GraphStore
from colmap_edges.images import (
    check_images_exist,
    encoded,
    gray_of,
    path_of_image,
    read_image,
    sample_colors,
)
from colmap_edges.meshing import Mesh, finished, mesh_with_curves, with_outlines, write_mesh
from colmap_edges.model import (
    Model,
    extend_reconstruction,
    load_model,
    model_from_reconstruction,
    observation_residuals,
    with_edge_points,
    write_model,
)
from colmap_edges.options import PipelineOptions
from colmap_edges.output import REPORT_NAME, check_output_path, new_folder
from colmap_edges.overlay import draw_edge_graph
from colmap_edges.report import Contents, PictureTaker, write_report
from colmap_edges.stages import Progress, Stages, no_progress, plain_counts

# What a visitor of an image gets: its place among the views, its pixels, its chains, its graph.
Visitor = Callable[[int, "np.ndarray[Any, Any]", Chains, EdgeGraph], None]


logger = logging.getLogger(__name__)

NO_CHAINS = Chains(
    points=np.zeros((0, 2)),
    normals=np.zeros((0, 2)),
    sides=np.zeros((0, 2), np.uint8),
    offsets=np.zeros(1, np.int64),
)


@dataclass(frozen=True, kw_only=True)
class Paths:
    """Where a run reads and writes, absolute.

    Attributes:
        image_path: folder of the images.
        input_path: folder of the COLMAP model.
        output_path: folder to make.
    """

    image_path: Path
    input_path: Path
    output_path: Path


@dataclass(frozen=True, kw_only=True)
class EdgeReconstruction:
    """What `reconstruct` gives back.

    Attributes:
        edges: the 3D edges with their tracks.
        point3D_ids: (N,) ids of the edge points in `reconstruction`.
        reconstruction: a new pycolmap.Reconstruction: the input plus the edge points; its poses
            and SfM points are the input's unless `refine_poses` is set.
        residuals_px: (T,) distance of each observation from the projection of its edge point.
        stages: records of the stages, as in report.json.
        findings: where edges were lost and what to do about it; empty when all went well.
    """

    edges: Edges3D
    point3D_ids: np.ndarray[Any, np.dtype[np.int64]]
    reconstruction: Any
    residuals_px: np.ndarray[Any, np.dtype[np.float64]]
    stages: list[dict[str, Any]]
    findings: list[Finding]


def run(
    command: str,
    paths: Paths,
    options: PipelineOptions,
    *,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Run `detect`, `reconstruct` or `mesh` from folders to a folder.

    The output folder appears whole at the end, or not at all.

    Returns:
        The report, as written to report.json.

    Raises:
        ColmapEdgesError: on bad input or options.
    """
    paths = Paths(**{name: path.resolve() for name, path in vars(paths).items()})
    check_paths(paths, overwrite)
    if command == "mesh":
        check_mesher()
    with new_folder(paths.output_path) as folder:
        stages = Stages(progress)
        with stages.stage("read") as stage:
            model = load_model(paths.input_path)
            check_model(model, str(paths.input_path))
            stage.counts = model_counts(model)
        if command == "mesh" and not options.use_edges:
            mesh = mesh_stage(model, None, model, folder, options, stages)
            contents = Contents(model=model, mesh=mesh)
        else:
            check_images_exist(model.views, paths.image_path)
            contents = run_edges(command, model, paths.image_path, folder, options, stages)
        report = make_report(command, paths, options, stages)
        if options.report and command != "detect":
            report_stage(contents, folder, report, stages)
            report["stages"] = stages.records()
        text = json.dumps(report, indent=2, default=str) + "\n"
        (folder / REPORT_NAME).write_text(text, encoding="utf-8")
    return report


def run_edges(
    command: str,
    model: Model,
    image_path: Path,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
) -> Contents:
    """Run the stages of `command` that need images into `folder`."""
    if command == "detect":
        detect_stage(model, image_path, options, stages, graph_writer(model, folder))
        return Contents(model=model)
    taker = PictureTaker(model) if options.report else None
    graphs = detect_stage(model, image_path, options, stages, taker.take if taker else None)
    model, edges = edge_stages(model, graphs, options, stages)
    extended = write_stage(model, edges, image_path, folder, options, stages)
    mesh = None
    if command == "mesh":
        mesh = mesh_stage(model, edges, extended, folder, options, stages)
    pictures = taker.pictures() if taker else ()
    return Contents(model=model, pictures=pictures, edges=edges, mesh=mesh)


def reconstruct(
    reconstruction: Any, image_path: Path | str, options: PipelineOptions | None = None
) -> EdgeReconstruction:
    """Reconstruct the 3D edges of a pycolmap.Reconstruction from its images.

    Args:
        reconstruction: the sparse model, a pycolmap.Reconstruction; it is not changed. Its
            cameras may be of any model, with distortion; images without poses are left out.
        image_path: folder of its images, as they were when the model was made.
        options: every stage's options, `preset("high")` for instance; defaults when not given.

    Returns:
        The edges as arrays, and a new pycolmap.Reconstruction with the edge points in it.

    Raises:
        ColmapEdgesError: when the model has fewer than two posed images or is inconsistent, or
            images are missing, of another size, or all but one damaged.
    """
    options = options or PipelineOptions()
    image_path = Path(image_path)
    stages = Stages()
    model = model_from_reconstruction(reconstruction)
    check_model(model, "the reconstruction")
    check_images_exist(model.views, image_path)
    graphs = detect_stage(model, image_path, options, stages)
    model, edges = edge_stages(model, graphs, options, stages)
    extended, ids = extend_reconstruction(model, edges, sample_colors(edges, model, image_path))
    return EdgeReconstruction(
        edges=edges,
        point3D_ids=ids,
        reconstruction=extended,
        residuals_px=observation_residuals(model, edges),
        stages=stages.records(),
        findings=diagnose(stages.records(), options),
    )


def check_paths(paths: Paths, overwrite: bool) -> None:
    """Check that the inputs are folders and the output can be made."""
    for name in ("image_path", "input_path"):
        path = getattr(paths, name)
        if not path.is_dir():
            raise ColmapEdgesError(f"{name} {path} is no folder")
    check_output_path(paths.output_path, [paths.image_path, paths.input_path], overwrite)


def check_mesher() -> None:
    """Check that the mesher is built, before work starts."""
    from colmap_edges.meshing import load_extension

    load_extension()


def check_model(model: Model, where: str) -> None:
    """Check that there is something to work on.

    Raises:
        ColmapEdgesError: with fewer than two posed images.
    """
    if len(model.views) < 2:
        raise ColmapEdgesError(
            f"{where} has {len(model.views)} images with poses; "
            "3D edges need at least 2: run `colmap mapper` on more images first"
        )


def model_counts(model: Model) -> dict[str, Any]:
    """Counts of the input model."""
    return {
        "images_with_poses": len(model.views),
        "images_without_poses": len(model.unposed_names),
        "points3D": len(model.point3D_ids),
        "observations": len(model.track_views),
    }


def thread_count(options: PipelineOptions) -> int:
    """Number of threads the options ask for."""
    if options.num_threads > 0:
        return options.num_threads
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def detect_stage(
    model: Model,
    image_path: Path,
    options: PipelineOptions,
    stages: Stages,
    visit: Visitor | None = None,
) -> Sequence[EdgeGraph]:
    """Detect the 2D edge graph of every view, in the views' order.

    As many images are in memory at once as there are threads. Damaged images are left out: they
    get an empty graph and are counted. Graphs beyond the memory meant for them wait on disk.

    Raises:
        ColmapEdgesError: when fewer than two images can be read.
    """
    with stages.stage("detect", len(model.views)) as stage:
        damaged: dict[int, ImageError] = {}
        # Tracing holds the same graphs in the kernels' form too, which takes as much again.
        store = GraphStore(len(model.views), options.max_graph_memory_gb * 1e9 / 2)

        def detect(index: int) -> ImageCounts:
            view = model.views[index]
            try:
                image = read_image(view, image_path)
            except ImageError as error:
                damaged[index] = error
                chains, graph = NO_CHAINS, build_edge_graph(NO_CHAINS, view, options.edge_graph)
            else:
                chains = detect_chains(gray_of(image), options.detection)
                graph = build_edge_graph(chains, view, options.edge_graph)
                if visit:
                    visit(index, image, chains, graph)
            stage.advance()
            store.add(index, graph)
            return ImageCounts(
                chains=len(chains.offsets) - 1,
                chain_pixels=len(chains.points),
                polylines=graph.num_polylines,
                closed_polylines=int(graph.closed.sum()),
                edge_pixels=len(graph.points),
            )

        found = map_threads(detect, len(model.views), thread_count(options))
        report_damaged(damaged, len(model.views))
        names = [model.views[index].name for index in sorted(damaged)]
        stage.counts = detection_counts(found, names)
    return store


@dataclass(frozen=True, kw_only=True)
class ImageCounts:
    """How much was detected in one image."""

    chains: int
    chain_pixels: int
    polylines: int
    closed_polylines: int
    edge_pixels: int


def detection_counts(found: Sequence[ImageCounts], damaged: list[str]) -> dict[str, Any]:
    """Counts of detection.

    Args:
        found: what was detected in each image.
        damaged: names of the images that could not be read.
    """
    return {
        "images": len(found),
        "images_damaged": len(damaged),
        "images_without_edges": sum(image.edge_pixels == 0 for image in found) - len(damaged),
        **{entry.name: sum(getattr(i, entry.name) for i in found) for entry in fields(ImageCounts)},
        "damaged": damaged,
    }


def report_damaged(damaged: Mapping[int, ImageError], num_images: int) -> None:
    """Log the images that could not be read; raise when only one or none could."""
    errors = [damaged[index] for index in sorted(damaged)]
    if errors and num_images - len(errors) < 2:
        raise ColmapEdgesError(f"{errors[0]} ({len(errors)} of {num_images} images are so)")
    for error in errors:
        logger.warning("%s; it is left out", error)


def map_threads(function: Callable[[int], Any], count: int, num_threads: int) -> list[Any]:
    """Results of `function` on 0..count-1, in order; the first error stops the rest."""
    executor = ThreadPoolExecutor(num_threads)
    try:
        return list(executor.map(function, range(count)))
    finally:
        executor.shutdown(cancel_futures=True)


def graph_writer(model: Model, folder: Path) -> Visitor:
    """Make the visitor that writes each view's edge graph as .npz and overlay PNG."""

    def write(index: int, image: np.ndarray[Any, Any], _chains: Chains, graph: EdgeGraph) -> None:
        name = model.views[index].name
        arrays = path_of_image(folder / "edge_graphs", name + ".npz")
        picture = path_of_image(folder / "overlays", name + ".png")
        for path in (arrays, picture):
            path.parent.mkdir(parents=True, exist_ok=True)
        packed = BytesIO()  # a .npz cut short on a full disk would complain when it is deleted
        np.savez(packed, **vars(graph))
        arrays.write_bytes(packed.getvalue())
        picture.write_bytes(encoded(".png", draw_edge_graph(image, graph)))

    return write


def edge_stages(
    model: Model, graphs: Sequence[EdgeGraph], options: PipelineOptions, stages: Stages
) -> tuple[Model, Edges3D]:
    """Reconstruct 3D edges; when asked to, refine the poses on them and reconstruct them anew.

    Returns:
        The model that the edges belong to, and the edges.
    """
    edges = trace_stage(model, graphs, options, stages)
    if not options.refine_poses:
        return model, edges
    refined = refine_stage(model, edges, graphs, options, stages)
    if refined is not model:
        edges = trace_stage(refined, graphs, options, stages, "trace again")
    return refined, edges


def refine_stage(
    model: Model,
    edges: Edges3D,
    graphs: Sequence[EdgeGraph],
    options: PipelineOptions,
    stages: Stages,
) -> Model:
    """Refine the poses on SfM points and edges; the model itself where that does not help."""
    from colmap_edges.bundle_adjustment import edge_normals, refine_poses

    with stages.stage("refine poses") as stage:
        normals = edge_normals(model, edges, graphs)
        refined, stats = refine_poses(model, edges, normals, options.bundle_adjustment)
        stage.counts = plain_counts(stats)
    return refined


def trace_stage(
    model: Model,
    graphs: Sequence[EdgeGraph],
    options: PipelineOptions,
    stages: Stages,
    name: str = "trace",
) -> Edges3D:
    """Reconstruct 3D edges from the 2D edge graphs."""
    from colmap_edges.paper_tracing import trace_edges_paper
    from colmap_edges.tracing import trace_edges

    threads = thread_count(options)
    paper = options.tracing.method == "paper"
    with stages.stage(name, 1 if paper else 2 * len(graphs)) as stage:
        edges, stats = (
            trace_edges_paper(model, graphs, options, threads)
            if paper
            else trace_edges(model, graphs, options, threads, stage.advance)
        )
        stage.counts = {"edges": edges.num_edges, "edge_points": edges.num_points}
        stage.counts["details"] = plain_counts(stats)
    return edges


def write_stage(
    model: Model,
    edges: Edges3D,
    image_path: Path,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
) -> Model:
    """Write the model with edge points, and the edges as PLY, OBJ and JSON.

    Returns:
        The model with the edge points after its own.
    """
    with stages.stage("write") as stage:
        colors = sample_colors(edges, model, image_path)
        ids = write_model(model, edges, folder / "sparse", options.output_type, colors)
        residuals = observation_residuals(model, edges)
        write_ply(edges, colors, folder / "edges.ply")
        write_obj(edges, folder / "edges.obj")
        write_glb(edges, colors, folder / "edges.glb")
        write_dxf(edges, folder / "edges.dxf")
        write_json(edges, model, ids, residuals, folder / "edges.json")
        stage.counts = {
            "edges": edges.num_edges,
            "edge_points": edges.num_points,
            "observations": len(residuals),
            "median_residual_px": round(float(np.median(residuals)), 4) if len(residuals) else None,
        }
    return with_edge_points(model, edges, ids, colors)


def mesh_stage(
    model: Model,
    edges: Edges3D | None,
    extended: Model,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
) -> Mesh:
    """Mesh a model's points and edges; `extended` is the model with the edges' points."""
    with stages.stage("mesh") as stage:
        curves = [] if edges is None else with_outlines(edges)
        mesh = mesh_with_curves(model, curves, options.meshing, thread_count(options))
        mesh = finished(mesh, extended, options.meshing)
        write_mesh(mesh, folder / f"mesh.{options.mesh_type.lower()}")
        stage.counts = {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
        stage.counts["details"] = plain_counts(mesh.stats)
    return mesh


def report_stage(contents: Contents, folder: Path, record: dict[str, Any], stages: Stages) -> None:
    """Write report.html: what was made, in 3D, over the images and in figures."""
    with stages.stage("report") as stage:
        stage.counts = write_report(folder / "report.html", contents, record)


def make_report(
    command: str, paths: Paths, options: PipelineOptions, stages: Stages
) -> dict[str, Any]:
    """Gather what report.json holds."""
    return {
        "command": command,
        "versions": versions(),
        "paths": asdict(paths),
        "options": asdict(options),
        "stages": stages.records(),
        "findings": [asdict(finding) for finding in diagnose(stages.records(), options)],
        "funnel": [asdict(step) for step in funnel(stages.records(), options)],
    }


def versions() -> dict[str, str]:
    """Versions of this package and of what it computes with."""
    found = {"colmap-edges": colmap_edges.__version__}
    for name in ("numpy", "opencv-contrib-python-headless", "pycolmap", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
