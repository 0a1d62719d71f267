"""The stages in order: read, detect, trace, write, mesh; and the report of what they did."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

import colmap_edges
from colmap_edges.array_types import FloatArray, IntArray
from colmap_edges.backdrop import Backdrop
from colmap_edges.cache import Cache, key_of
from colmap_edges.declared_options import derived
from colmap_edges.diagnosis import Finding, diagnose, funnel
from colmap_edges.edge_graph import EdgeGraph
from colmap_edges.edge_io import write_dxf, write_glb, write_json, write_obj, write_ply
from colmap_edges.edges import Edges3D, arrays_of_edges, edges_from_arrays
from colmap_edges.enlargement import enlarged
from colmap_edges.errors import ColmapEdgesError, ImageError, OptionError
from colmap_edges.executors import Workers, cluster_workers, local_workers, run_all
from colmap_edges.graph_store import GraphStore
from colmap_edges.image_graphs import (
    DetectedEdges,
    ImageCounts,
    ImageRecord,
    ImageWork,
    Visitor,
    load_graph,
    work_in_cache,
    work_on_image,
)
from colmap_edges.images import (
    check_images_exist,
    encoded,
    path_of_image,
    single_threaded_opencv,
)
from colmap_edges.masks import check_masks
from colmap_edges.meshing import Mesh, finished, mesh_with_curves, with_outlines, write_mesh
from colmap_edges.model import (
    Model,
    View,
    check_text_names,
    extend_reconstruction,
    load_model,
    model_from_reconstruction,
    observation_residuals,
    with_edge_points,
    write_model,
)
from colmap_edges.options import PipelineOptions
from colmap_edges.output import check_output_path, new_folder
from colmap_edges.overlay import draw_edge_graph
from colmap_edges.ownership import OUTPUT, REPORT_NAME, file_sizes
from colmap_edges.report import Contents, PictureTaker, write_report
from colmap_edges.silhouettes import Background, find_background
from colmap_edges.stages import Progress, Stage, Stages, no_progress, plain_counts
from colmap_edges.thinning import thinned
from colmap_edges.viewer import NO_VIEWER, Viewer

logger = logging.getLogger(__name__)

# More only take memory, of an image each, and in the end the system has none to give.
MAX_THREADS_PER_CORE = 4
# Options on which traced edges do not depend, besides those of detection, which makes the graphs.
NOT_OF_TRACING = {
    "detection",
    "edge_graph",
    "bundle_adjustment",
    "meshing",
    "use_edges",
    "report",
    "refine_poses",
    "output_type",
    "mesh_type",
    "num_threads",
    "max_graph_memory_gb",
    "masks_are_background",
}


@dataclass(frozen=True, kw_only=True)
class Paths:
    """Where a run reads and writes, absolute.

    Attributes:
        image_path: folder of the images; a mesh without edges needs none.
        input_path: folder of the COLMAP model.
        output_path: folder to make.
        mask_path: folder of masks named as COLMAP's are, or one mask of all images.
        cache_path: folder of results that later runs find again; none are kept without it.
    """

    image_path: Path | None = None
    input_path: Path
    output_path: Path
    mask_path: Path | None = None
    cache_path: Path | None = None

    @property
    def inputs(self) -> list[Path]:
        """The paths that no output may be in."""
        given = (self.image_path, self.input_path, self.mask_path, self.cache_path)
        return [path for path in given if path is not None]


@dataclass(frozen=True, kw_only=True)
class EdgeReconstruction:
    """What `reconstruct` gives back.

    Attributes:
        edges: the 3D edges with their tracks.
        point3D_ids: (N,) ids of the edge points in `reconstruction`.
        reconstruction: a new pycolmap.Reconstruction: the input plus the edge points; its poses
            and SfM points are the input's unless `refine_poses` is set.
        residuals_px: (T,) distance of each observation from the projection of its edge point.
        background: what the sight of a plain backdrop or, with `masks_are_background`, of what
            masks hide says, for `mesh`; none where no such background is seen.
        stages: records of the stages, as in report.json.
        findings: where edges were lost and what to do about it; empty when all went well.
    """

    edges: Edges3D
    point3D_ids: IntArray
    reconstruction: Any
    residuals_px: FloatArray
    background: Background | None
    stages: list[dict[str, Any]]
    findings: list[Finding]


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
    """Run `detect`, `reconstruct` or `mesh` from folders to a folder.

    The output folder appears whole at the end, or not at all.

    Args:
        command: what to run.
        paths: where to read and write.
        options: every stage's options.
        overwrite: replace an earlier output.
        progress: told of every step.
        scheduler: address of a dask.distributed scheduler whose workers share the work.
        viewer: is shown what the run makes.

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
        raise OptionError("a scheduler needs cache_path: through it graphs go to the workers")
    if command == "mesh":
        check_mesher()
    with (
        new_folder(paths.output_path, OUTPUT, overwrite) as folder,
        open_workers(options, paths.cache_path, scheduler) as workers,
    ):
        stages = Stages(progress)
        model = read_stage(paths.input_path, stages)
        viewer.show_model(model)
        if command == "mesh" and not options.use_edges:
            mesh = mesh_stage(model, None, model, folder, options, stages)
            viewer.show_mesh(mesh)
            contents = Contents(model=model, mesh=mesh)
        else:
            check_pictures(model, image_folder(paths), paths.mask_path, options)
            if command != "detect" and options.output_type == "TXT":
                check_text_names(model)
            contents = run_edges(command, model, paths, folder, options, stages, workers, viewer)
        report = make_report(command, paths, options, stages)
        if options.report and command != "detect":
            report_stage(contents, folder, report, stages)
            report["stages"] = stages.records()
        report["files"] = file_sizes(folder)
        text = json.dumps(report, indent=2, default=str, allow_nan=False) + "\n"
        (folder / REPORT_NAME).write_text(text, encoding="utf-8")
    return report


def read_stage(input_path: Path, stages: Stages) -> Model:
    """Read the model.

    Raises:
        ColmapEdgesError: when it cannot be read or has fewer than two posed images.
    """
    with stages.stage("read") as stage:
        model = load_model(input_path)
        check_model(model, str(input_path))
        stage.counts = model_counts(model)
    return model


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
    """Run the stages of `command` that need images into `folder`."""
    images, masks = image_folder(paths), paths.mask_path
    model = enlarged(model, images, options.detection)
    if command == "detect":
        check_file_names(model.views)
        detect_stage(model, images, options, stages, GraphWriter(folder), workers, masks)
        return Contents(model=model)
    wanted = options.report or viewer is not NO_VIEWER
    taker = PictureTaker(len(model.views)) if wanted else None
    graphs = detect_stage(model, images, options, stages, taker, workers, masks)
    pictures = taker.pictures() if taker else ()
    for picture in pictures:
        viewer.show_picture(model.views[picture.view], picture)
    given = model
    model, edges = edge_stages(model, graphs, options, stages, workers)
    if model is not given:
        viewer.show_model(model)
    viewer.show_edges(edges, len(model.views))
    extended = write_stage(model, edges, folder, options, stages)
    mesh = None
    if command == "mesh":
        mesh = mesh_stage(model, edges, extended, folder, options, stages, graphs.backdrops)
        viewer.show_mesh(mesh)
    return Contents(model=model, pictures=pictures, edges=edges, mesh=mesh)


def reconstruct(
    reconstruction: Any,
    image_path: Path | str,
    options: PipelineOptions | None = None,
    cache_path: Path | str | None = None,
    mask_path: Path | str | None = None,
) -> EdgeReconstruction:
    """Reconstruct the 3D edges of a pycolmap.Reconstruction from its images.

    Args:
        reconstruction: the sparse model, a pycolmap.Reconstruction; it is not changed. Its
            cameras may be of any model, with distortion; images without poses are left out.
        image_path: folder of its images, as they were when the model was made.
        options: every stage's options, `preset("high")` for instance; defaults when not given.
        cache_path: folder of edge graphs and edges that later calls find again; none are kept
            when not given.
        mask_path: folder of masks named as COLMAP's are, or one mask of all images; edges are not
            looked for where they are black.

    Returns:
        The edges as arrays, and a new pycolmap.Reconstruction with the edge points in it.

    Raises:
        ColmapEdgesError: when the model has fewer than two posed images or is inconsistent, or
            images or all masks are missing, of another size, or all images but one damaged.
    """
    options = options or PipelineOptions()
    image_path = Path(image_path)
    mask_path = Path(mask_path) if mask_path else None
    stages = Stages()
    model = model_from_reconstruction(reconstruction)
    check_model(model, "the reconstruction")
    check_pictures(model, image_path, mask_path, options)
    model = enlarged(model, image_path, options.detection)
    with open_workers(options, Path(cache_path) if cache_path else None) as workers:
        graphs = detect_stage(model, image_path, options, stages, None, workers, mask_path)
        model, edges = edge_stages(model, graphs, options, stages, workers)
    residuals = observation_residuals(model, edges)
    extended, ids = extend_reconstruction(model, edges, residuals)
    return EdgeReconstruction(
        edges=edges,
        point3D_ids=ids,
        reconstruction=extended,
        residuals_px=residuals,
        background=find_background(model, graphs.backdrops, options.masks_are_background, edges),
        stages=stages.records(),
        findings=diagnose(stages.records(), options),
    )


def absolute(paths: Paths) -> Paths:
    """The same paths from the root on; a link at the output, which is not followed, stays."""
    resolved = {name: path and Path(os.path.realpath(path)) for name, path in vars(paths).items()}
    output = paths.output_path
    if os.path.islink(output):  # noqa: PTH114 - False where one may not look
        resolved["output_path"] = Path(os.path.realpath(output.parent), output.name)
    return Paths(**resolved)


def check_paths(paths: Paths, overwrite: bool) -> None:
    """Check that the inputs are folders and the output can be made."""
    for name in ("image_path", "input_path"):
        path = getattr(paths, name)
        if path and not path.is_dir():
            raise ColmapEdgesError(f"{name} {path} is no folder")
    check_output_path(paths.output_path, paths.inputs, overwrite)


def image_folder(paths: Paths) -> Path:
    """The folder of the images.

    Raises:
        OptionError: when it is not given.
    """
    if paths.image_path is None:
        raise OptionError("image_path is not given; only a mesh without edges needs no images")
    return paths.image_path


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
            "3D edges need at least 3: run `colmap mapper` on more images first"
        )


def check_pictures(
    model: Model, image_path: Path, mask_path: Path | None, options: PipelineOptions
) -> None:
    """Check that the images are there, and masks where they are asked for.

    Raises:
        ColmapEdgesError: when they are not.
    """
    check_images_exist(model.views, image_path)
    if mask_path:
        check_masks(model.views, mask_path)
    elif options.masks_are_background:
        raise OptionError("masks_are_background is 1 and there are no masks; give mask_path")


def model_counts(model: Model) -> dict[str, Any]:
    """Counts of the input model."""
    return {
        "images_with_poses": len(model.views),
        "images_without_poses": len(model.unposed_names),
        "points3D": len(model.point3D_ids),
        **({"points3D_too_far": len(model.far_point3D_ids)} if len(model.far_point3D_ids) else {}),
        "observations": len(model.track_views),
    }


def thread_count(options: PipelineOptions) -> int:
    """Number of threads the options ask for, as far as that many are of any use."""
    has_affinity = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    return (
        min(options.num_threads, MAX_THREADS_PER_CORE * cores) if options.num_threads > 0 else cores
    )


@contextmanager
def open_workers(
    options: PipelineOptions, cache_path: Path | None = None, scheduler: str = ""
) -> Iterator[Workers]:
    """The workers of a run: those of a cluster, or threads of this process."""
    cache = Cache(cache_path) if cache_path else None
    if scheduler and cache:
        with cluster_workers(scheduler, cache) as workers:
            yield workers
    else:
        with local_workers(thread_count(options), cache) as workers:
            yield workers


def detect_stage(
    model: Model,
    image_path: Path,
    options: PipelineOptions,
    stages: Stages,
    visitor: Visitor | None = None,
    workers: Workers | None = None,
    mask_path: Path | None = None,
) -> GraphStore:
    """Detect the 2D edge graph of every view, in the views' order.

    As many images are in memory at once as there are threads. Damaged images are left out: they
    get an empty graph and are counted. Graphs beyond the memory meant for them wait on disk.

    Raises:
        ColmapEdgesError: when fewer than two images can be read.
    """
    if workers is None:
        with open_workers(options) as workers:
            return detect_stage(model, image_path, options, stages, visitor, workers, mask_path)
    work = ImageWork(
        image_path=image_path,
        detection=options.detection,
        edge_graph=options.edge_graph,
        mask_path=mask_path,
        masks_are_background=options.masks_are_background,
        cache=workers.cache,
        visitor=visitor,
    )
    with stages.stage("detect", len(model.views)) as stage, single_threaded_opencv():
        store, records = find_graphs(work, model.views, options, workers, stage)
        damaged = {i: r.damage for i, r in enumerate(records) if r.damage}
        report_damaged(damaged, len(records))
        names = [model.views[index].name for index in damaged]
        stage.counts = detection_counts([record.counts for record in records], names)
        stage.counts["image_scale"] = model.scale
        if mask_path:
            stage.counts["images_masked"] = sum(record.masked for record in records)
        if workers.cache:
            stage.counts["images_reused"] = sum(record.reused for record in records)
    return store


def find_graphs(
    work: ImageWork,
    views: Sequence[View],
    options: PipelineOptions,
    workers: Workers,
    stage: Stage,
) -> tuple[GraphStore, list[ImageRecord]]:
    """Have the work on every image done; the graphs, and what is said of each image."""
    # Tracing holds the same graphs in the kernels' form too, which takes as much again.
    max_bytes = options.max_graph_memory_gb * 1e9 / 2
    cache = workers.cache
    if workers.remote and cache:
        store = GraphStore(len(views), max_bytes, lambda i: load_graph(cache, store.keys[i]))
        calls = [(work_in_cache, (work, i, view)) for i, view in enumerate(views)]
        records = run_all(workers.images, calls, stage.advance)
    else:
        store = GraphStore(len(views), max_bytes)

        def put(index: int, view: View) -> ImageRecord:
            graph, record = work_on_image(work, index, view)
            store.add(index, graph)
            return record

        records = run_all(workers.images, ((put, pair) for pair in enumerate(views)), stage.advance)
    for index, record in enumerate(records):
        if work.visitor and record.visited is not None:
            work.visitor.collect(index, record.visited)
    store.keys = [record.key for record in records if record.key]
    store.backdrops = [record.backdrop for record in records]
    return store, records


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


@dataclass(frozen=True)
class GraphWriter:
    """Writes each view's edge graph as .npz and overlay PNG into a folder."""

    folder: Path

    def visit(self, _index: int, view: View, read: Callable[[], Any], found: DetectedEdges) -> None:
        """Write the files of a view."""
        arrays = path_of_image(self.folder / "edge_graphs", view.name + ".npz")
        picture = path_of_image(self.folder / "overlays", view.name + ".png")
        for path in (arrays, picture):
            path.parent.mkdir(parents=True, exist_ok=True)
        packed = BytesIO()  # a .npz cut short on a full disk would complain when it is deleted
        np.savez(packed, **vars(found.graph))
        arrays.write_bytes(packed.getvalue())
        picture.write_bytes(encoded(".png", draw_edge_graph(read(), found.graph)))

    def collect(self, index: int, kept: None) -> None:
        """Nothing is kept."""


def check_file_names(views: Sequence[View]) -> None:
    """Check that the files of no two images would be one, or one the folder of the other.

    Raises:
        ColmapEdgesError: naming the two images.
    """
    names: dict[PurePosixPath, str] = {}
    for view in views:
        path = PurePosixPath(view.name + ".npz")  # without "./" and "//"
        if path in names:
            raise ColmapEdgesError(
                f"the images {names[path]} and {view.name} of the model are one file, and so would "
                "be what is written of them; delete one from the model"
            )
        names[path] = view.name
    for path, name in names.items():
        inside = next((names[parent] for parent in path.parents if parent in names), None)
        if inside:
            raise ColmapEdgesError(
                f"the folder of image {name} has the name of the file that is written of image "
                f"{inside}; rename one"
            )


def edge_stages(
    model: Model,
    graphs: Sequence[EdgeGraph],
    options: PipelineOptions,
    stages: Stages,
    workers: Workers | None = None,
) -> tuple[Model, Edges3D]:
    """Reconstruct 3D edges; when asked to, refine the poses on them and reconstruct them anew.

    Returns:
        The model that the edges belong to, and the edges.
    """
    if not options.refine_poses:
        return model, trace_stage(model, graphs, options, stages, workers=workers)
    first = options_for_poses(options)
    edges = trace_stage(model, graphs, first, stages, workers=workers)
    refined = refine_stage(model, edges, graphs, options, stages)
    if refined is not model or first != options:
        edges = trace_stage(refined, graphs, options, stages, "trace again", workers)
    return refined, edges


def options_for_poses(options: PipelineOptions) -> PipelineOptions:
    """How the edges are traced that poses are refined on.

    By the first round alone, whose edges are the surest, in views that look from near by, and by
    their places across the chains, for nothing else is known of edges when poses are refined. More
    densely sampled chains give more of them. The paper's tracing has none of these options.
    """
    if options.tracing.method == "paper":
        return options
    selection, depths = options.view_selection, options.chain_depth
    return replace(
        options,
        chain_depth=derived(depths, sample_step_px=4 * depths.sample_step_px // 5),
        view_selection=replace(selection, max_witness_angle_deg=selection.max_angle_deg),
        refinement=replace(options.refinement, side_gray_weight=0.0),
        tracing=replace(options.tracing, num_rounds=1),
    )


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
    workers: Workers | None = None,
) -> Edges3D:
    """Reconstruct 3D edges from the 2D edge graphs, unless the cache has them."""
    if workers is None:
        with open_workers(options) as workers:
            return trace_stage(model, graphs, options, stages, name, workers)
    keys = graphs.keys if isinstance(graphs, GraphStore) else []
    cache = workers.cache if keys else None
    key = key_of_edges(model, keys, options) if cache else ""
    steps = 1 if options.tracing.method == "paper" else 2 * len(graphs) * options.tracing.num_rounds
    with stages.stage(name, steps) as stage:
        entry = cache.load("edges", key) if cache else None
        if entry is None:
            edges, stats = trace(model, graphs, options, stage.advance, workers)
            details = plain_counts(stats)
            if cache:
                text = np.array(json.dumps(details))
                cache.save("edges", key, arrays_of_edges(edges) | {"details": text})
        else:
            details = json.loads(str(entry.pop("details")))
            edges = edges_from_arrays(entry)
        stage.counts = {"edges": edges.num_edges, "edge_points": edges.num_points}
        if cache:
            stage.counts["edges_reused"] = edges.num_edges if entry is not None else 0
        stage.counts["details"] = details
    return edges


def trace(
    model: Model,
    graphs: Sequence[EdgeGraph],
    options: PipelineOptions,
    advance: Callable[[], None],
    workers: Workers,
) -> tuple[Edges3D, dict[str, Any]]:
    """Reconstruct 3D edges by the method that the options name."""
    threads = thread_count(options)
    model = thinned(model, options.random_seed)
    if options.tracing.method == "paper":
        from colmap_edges.paper_tracing import trace_edges_paper

        return trace_edges_paper(model, graphs, options, threads)
    from colmap_edges.tracing import trace_edges

    return trace_edges(model, graphs, options, threads, advance, workers)


def key_of_edges(model: Model, graph_keys: list[str], options: PipelineOptions) -> str:
    """The key of traced edges: of the graphs, the poses, the SfM points and the options."""
    groups = {name: group for name, group in asdict(options).items() if name not in NOT_OF_TRACING}
    poses = np.array([[*view.rotation.ravel(), *view.translation] for view in model.views])
    tracks = (model.track_offsets, model.track_views, model.track_points2D)
    return key_of("edges", graph_keys, groups, poses, model.points3D_xyz, *tracks)


def write_stage(
    model: Model,
    edges: Edges3D,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
) -> Model:
    """Write the model with edge points, and the edges as PLY, OBJ and JSON.

    Returns:
        The model with the edge points after its own.
    """
    with stages.stage("write") as stage:
        residuals = observation_residuals(model, edges)
        sparse = folder / "sparse"
        ids = write_model(model, edges, sparse, options.output_type, residuals)
        write_ply(edges, folder / "edges.ply")
        write_obj(edges, folder / "edges.obj")
        write_glb(edges, folder / "edges.glb")
        write_dxf(edges, folder / "edges.dxf")
        write_json(edges, model, ids, residuals, folder / "edges.json")
        stage.counts = {
            "edges": edges.num_edges,
            "edge_points": edges.num_points,
            "observations": len(residuals),
            "median_residual_px": round(float(np.median(residuals)), 4) if len(residuals) else None,
        }
    return with_edge_points(model, edges, ids)


def mesh_stage(
    model: Model,
    edges: Edges3D | None,
    extended: Model,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
    backdrops: Sequence[Backdrop] = (),
) -> Mesh:
    """Mesh a model's points and edges; `extended` is the model with the edges' points."""
    with stages.stage("mesh") as stage:
        curves = [] if edges is None else with_outlines(edges)
        background = None
        if edges and backdrops and options.meshing.background_weight:
            are_masks = options.masks_are_background
            background = find_background(model, backdrops, are_masks, edges)
        threads = thread_count(options)
        mesh = mesh_with_curves(model, curves, options.meshing, threads, background)
        mesh = finished(mesh, extended, options.meshing)
        write_mesh(mesh, folder / f"mesh.{options.mesh_type.lower()}")
        stage.counts = {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
        if background:
            stage.counts["background_rays"] = len(background.rays.cameras)
            stage.counts["silhouette_points"] = len(background.silhouettes.points)
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
