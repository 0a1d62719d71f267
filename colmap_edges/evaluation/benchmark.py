"""Benchmark of several methods on several scenes, as in the paper's tables; resumable."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.colmap.triangulation import triangulate
from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import pictures, tables
from colmap_edges.evaluation.metrics import clouds, depth, dtu_distances, edges
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_mesh
from colmap_edges.evaluation.metrics.statistics import summarize
from colmap_edges.evaluation.scenes import Reference, Scene
from colmap_edges.export import peers
from colmap_edges.options import PipelineOptions, preset
from colmap_edges.runtime.input_files import read_text
from colmap_edges.runtime.output import write_whole

logger = logging.getLogger(__name__)

Record = dict[str, Any]
Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Method:
    """A method of meshing a model.

    Attributes:
        use_edges: Whether edges are meshed, too.
        use_faces: Whether planar faces between edges are meshed, too.
        paper: Whether the options are those of `--method paper`, including its mesher.
        meshing: Changed meshing options.
    """

    use_edges: bool
    use_faces: bool = False
    paper: bool = False
    meshing: Mapping[str, Any] = field(default_factory=dict)


METHODS = {
    "SfM": Method(use_edges=False),
    "SfM-paper": Method(use_edges=False, paper=True),
    "COLMAP-like": Method(use_edges=False, meshing={"quality_weight": 1.0}),
    "paper": Method(use_edges=True, paper=True),
    "edges": Method(use_edges=True),
    "faces": Method(use_edges=True, use_faces=True),
}


def pipeline_options(method: Method) -> PipelineOptions:
    """The pipeline options of a method."""
    options = preset("paper" if method.paper else "medium")
    meshing = replace(options.meshing, **method.meshing)
    return replace(options, use_edges=method.use_edges, use_faces=method.use_faces, meshing=meshing)


def run(
    scenes: Sequence[Scene],
    output_path: Path,
    methods: Sequence[str] = ("SfM", "edges"),
    *,
    baseline: str = "",
    progress: Progress = logger.info,
) -> Record:
    """Mesh and measure every scene by every method, and write evaluation.json and evaluation.md.

    Finished results of an earlier run are reused. A scene or method that fails is reported and does
    not stop the others.

    Args:
        scenes: The scenes.
        output_path: Folder for models, meshes and tables.
        methods: Names in `METHODS`; peers of the scenes come after them.
        baseline: Method or peer to which the average variation refers; default: the first method.
        progress: Called with a line of text for every step.

    Returns:
        The content of evaluation.json, by scene and method.

    Raises:
        ColmapEdgesError: A method is unknown, the baseline is not among the rows, or
            `output_path` holds results from other images of a scene.
    """
    rows = list(dict.fromkeys([*methods, *(peer for scene in scenes for peer in scene.peers)]))
    check_names(methods, baseline, rows)
    for scene in scenes:
        keep_image_names(scene, output_path / scene.name)
    output_path.mkdir(parents=True, exist_ok=True)
    results: Record = {}
    for number, scene in enumerate(scenes, start=1):
        progress(f"[{number}/{len(scenes)}] {scene.name}")
        folder = output_path / scene.name
        results[scene.name] = {"unit": scene.unit, "methods": {}}
        shared = with_one_reference(scene)
        for method in [*methods, *scene.peers]:
            record = _run_method(shared, method, folder, progress)
            results[scene.name]["methods"][method] = record
        write_results(results, output_path, baseline or rows[0])
    return results


def check_names(methods: Sequence[str], baseline: str, rows: Sequence[str]) -> None:
    """Check that methods are known and the baseline is among the rows.

    Raises:
        ColmapEdgesError: One is not.
    """
    unknown = [method for method in methods if method not in METHODS]
    if unknown:
        raise ColmapEdgesError(f"unknown method {unknown[0]}; choose from {', '.join(METHODS)}")
    if baseline and baseline not in rows:
        raise ColmapEdgesError(f"unknown baseline {baseline}; choose from {', '.join(rows)}")


def keep_image_names(scene: Scene, folder: Path) -> None:
    """Record the images of the scene's results, or compare them with the record.

    Raises:
        ColmapEdgesError: The folder holds results from other images.
    """
    names = "".join(f"{image.name}\n" for image in scene.posed)
    path = folder / "images.txt"
    if names and path.is_file() and read_text(path) != names:
        raise ColmapEdgesError(
            f"{folder} holds results of other images (see {path.name} in it); "
            "choose another --output_path or remove it"
        )
    if names:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, names.encode(), "names of images")


def with_one_reference(scene: Scene) -> Scene:
    """The scene with a reference that is read once for all methods."""
    read: list[Reference] = []

    def load_reference(model: Model) -> Reference:
        if not read:
            read.append(scene.load_reference(model))
        return read[0]

    return replace(scene, load_reference=load_reference)


def write_results(results: Record, output_path: Path, baseline: str) -> None:
    """Write evaluation.json and evaluation.md."""
    figures, text = json.dumps(results, indent=2), tables.paper_tables(results, baseline)
    write_whole(output_path / "evaluation.json", f"{figures}\n".encode(), "figures")
    write_whole(output_path / "evaluation.md", f"{text}\n".encode(), "tables")


def _run_method(scene: Scene, method: str, folder: Path, progress: Progress) -> Record:
    slug = method.replace(" ", "_").replace("/", "_")
    done = folder / f"{slug}.json"
    if done.is_file():
        progress(f"  {method}: done before")
        return dict(json.loads(read_text(done)))
    started = time.perf_counter()
    try:
        record = evaluate_method(scene, method, folder, folder / slug)
    except Exception as error:
        logger.debug("%s, %s", scene.name, method, exc_info=True)
        progress(f"  {method}: failed: {error}")
        return {"error": " ".join(str(error).split()) or type(error).__name__}
    record["seconds"] = round(time.perf_counter() - started, 2)
    write_whole(done, f"{json.dumps(record, indent=2)}\n".encode(), "figures")
    progress(f"  {method}: {record['seconds']} s")
    return record


def evaluate_method(scene: Scene, method: str, folder: Path, run_path: Path) -> Record:
    """Mesh one scene by one method into `run_path` and measure mesh and points.

    Raises:
        ColmapEdgesError: Something is missing or fails; see its message.
    """
    if scene.problem:
        raise ColmapEdgesError(scene.problem)
    folder.mkdir(parents=True, exist_ok=True)
    sparse_path = scene.sparse_path or triangulated(scene, folder / "sparse")
    model = load_model(sparse_path)
    reference = scene.load_reference(model)  # read first, since meshing takes longest
    if method in scene.peers:
        points = mesh_peer(scene.peers[method], model, run_path)
    else:
        points = mesh_own(METHODS[method], scene.image_path, sparse_path, model, run_path)
    mesh = load_mesh(run_path / "mesh.ply")
    sfm_points = None if points is model else model
    return measure(mesh, points, reference, run_path / "maps", sfm_points=sfm_points)


def triangulated(scene: Scene, path: Path) -> Path:
    """The sparse model triangulated from the scene's posed images; reused if it exists."""
    if not (path / "points3D.bin").is_file():
        partial = path.with_name(path.name + ".partial")
        triangulate(scene.posed, scene.image_path, partial)
        partial.rename(path)
    return path


def mesh_own(
    method: Method, image_path: Path, sparse_path: Path, model: Model, run_path: Path
) -> Model:
    """Run the pipeline into `run_path`; returns the evaluated points: the edges' or all."""
    from colmap_edges.pipeline.paths import Paths
    from colmap_edges.pipeline.run import run as run_pipeline

    paths = Paths(image_path=image_path, input_path=sparse_path, output_path=run_path)
    run_pipeline("mesh", paths, pipeline_options(method), overwrite=True)
    if not method.use_edges:
        return model
    return edges.edge_points(load_model(run_path / "sparse"), model)


def mesh_peer(path: Path, model: Model, run_path: Path) -> Model:
    """Mesh a peer's lines with the model's points into `run_path`; returns the lines' points."""
    from colmap_edges.export.meshes import write_mesh
    from colmap_edges.surfaces.mesher import mesh

    found = peers.load(path, model)
    run_path.mkdir(parents=True, exist_ok=True)
    write_mesh(mesh(model, edges=found), run_path / "mesh.ply")
    return edges.points_of_edges(found, model)


def measure(
    mesh: Any,
    points: Model,
    reference: Reference,
    maps_path: Path | None,
    *,
    sfm_points: Model | None = None,
) -> Record:
    """Errors of a mesh and of its points.

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
        results = [depth.depth_errors(caster, known) for known in reference.depths]
        record["mesh"] = depth.pool(results)
        if maps_path is not None:
            pictures.write_error_maps(maps_path, results)
    if reference.dtu is not None:
        record["dtu"] = asdict(dtu_distances.evaluate_mesh(mesh, reference.dtu))
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
    return (asdict(summarize(errors)) | {"of": of} if of else {}) | {"count": count}
