"""Benchmark of several methods on several scenes, as in the paper's tables; resumable."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import tables
from colmap_edges.evaluation.mesh_errors import measure
from colmap_edges.evaluation.metrics import edges
from colmap_edges.evaluation.metrics.raycasting import load_mesh
from colmap_edges.evaluation.metrics.statistics import Record
from colmap_edges.evaluation.scenes import Reference, Scene
from colmap_edges.evaluation.triangulation import triangulate
from colmap_edges.export import peers
from colmap_edges.options import PipelineOptions, preset
from colmap_edges.runtime.input_files import read_text
from colmap_edges.runtime.output import write_whole

logger = logging.getLogger(__name__)

Progress = Callable[[str], None]


def methods() -> dict[str, PipelineOptions]:
    """The options of each method of meshing a model, from SfM points alone to all that is found."""
    faces = replace(preset("medium"), use_patches=False)
    own, paper = replace(faces, use_faces=False), preset("paper")
    quality = replace(own.meshing, quality_weight=1.0)
    return {
        "SfM": replace(own, use_edges=False),
        "SfM-paper": replace(paper, use_edges=False),
        "COLMAP-like": replace(own, use_edges=False, meshing=quality),
        "paper": paper,
        "edges": own,
        "faces": faces,
        "patches": preset("medium"),
    }


def run(
    scenes: Sequence[Scene],
    output_path: Path,
    names: Sequence[str] = ("SfM", "edges"),
    *,
    peer_paths: dict[str, str] | None = None,
    baseline: str = "",
    progress: Progress = logger.info,
) -> Record:
    """Mesh and measure every scene by every method, and write evaluation.json and evaluation.md.

    Finished results of an earlier run are reused. A scene or method that fails is reported and does
    not stop the others.

    Args:
        scenes: The scenes.
        output_path: Folder for models, meshes and tables.
        names: Names of `methods`; peers come after them.
        peer_paths: Results of other systems by name (see `peers.load` and `Scene.peers`), used in
            the scenes for which they exist.
        baseline: Method or peer to which the average variation refers; default: the first method.
        progress: Called with a line of text for every step.

    Returns:
        The content of evaluation.json, by scene and method.

    Raises:
        ColmapEdgesError: A method is unknown, the baseline is not among the rows, no scene has a
            result of a peer, or `output_path` holds results from other images of a scene.
    """
    found = [
        {name: path for name, path in scene.peers(peer_paths or {}).items() if path.exists()}
        for scene in scenes
    ]
    rows = list(dict.fromkeys([*names, *(peer for each in found for peer in each)]))
    check_names(names, baseline, rows, peer_paths or {})
    for scene in scenes:
        keep_image_names(scene, output_path / scene.name)
    output_path.mkdir(parents=True, exist_ok=True)
    results: Record = {}
    for number, (scene, peer_results) in enumerate(zip(scenes, found, strict=True), start=1):
        progress(f"[{number}/{len(scenes)}] {scene.name}")
        folder = output_path / scene.name
        results[scene.name] = {"unit": scene.unit, "methods": {}}
        inputs = cache(partial(prepared, scene, folder))
        for method in [*names, *peer_results]:
            record = _run_method(inputs, method, folder, peer_results.get(method), progress)
            results[scene.name]["methods"][method] = record
        write_results(results, output_path, baseline or rows[0])
    return results


def check_names(
    names: Sequence[str], baseline: str, rows: Sequence[str], peer_paths: dict[str, str]
) -> None:
    """Check that methods are known, and that the baseline and every peer are among the rows.

    Raises:
        ColmapEdgesError: One is not.
    """
    known = methods()
    for name in names:
        if name not in known:
            raise ColmapEdgesError(f"unknown method {name}; choose from {', '.join(known)}")
    for name, path in peer_paths.items():
        if name not in rows:
            raise ColmapEdgesError(f"no scene has a result of {name} at {path}")
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


class Inputs(NamedTuple):
    """The inputs that all methods of a scene share."""

    image_path: Path
    sparse_path: Path
    model: Model
    reference: Reference


def prepared(scene: Scene, folder: Path) -> Inputs:
    """The model of a scene, triangulated in `folder` unless given or there already; its reference.

    Raises:
        ColmapEdgesError: Something is missing; see its message.
    """
    if scene.problem:
        raise ColmapEdgesError(scene.problem)
    folder.mkdir(parents=True, exist_ok=True)
    sparse_path = scene.sparse_path or folder / "sparse"
    if scene.sparse_path is None and not (sparse_path / "points3D.bin").is_file():
        partial_path = folder / "sparse.partial"
        triangulate(scene.posed, scene.image_path, partial_path)
        partial_path.rename(sparse_path)
    model = load_model(sparse_path)
    return Inputs(scene.image_path, sparse_path, model, scene.load_reference(model))


def write_results(results: Record, output_path: Path, baseline: str) -> None:
    """Write evaluation.json and evaluation.md."""
    tables.write_figures(output_path / "evaluation.json", results)
    text = f"{tables.paper_tables(results, baseline)}\n"
    write_whole(output_path / "evaluation.md", text.encode(), "tables")


def _run_method(
    inputs: Callable[[], Inputs], method: str, folder: Path, peer: Path | None, progress: Progress
) -> Record:
    slug = method.replace(" ", "_").replace("/", "_")
    done = folder / f"{slug}.json"
    if done.is_file():
        progress(f"  {method}: done before")
        return dict(json.loads(read_text(done)))
    started = time.perf_counter()
    try:
        record = evaluate_method(inputs(), method, folder / slug, peer)
    except Exception as error:
        logger.debug("%s, %s", folder.name, method, exc_info=True)
        progress(f"  {method}: failed: {error}")
        return {"error": " ".join(str(error).split()) or type(error).__name__}
    record["seconds"] = round(time.perf_counter() - started, 2)
    tables.write_figures(done, record)
    progress(f"  {method}: {record['seconds']} s")
    return record


def evaluate_method(
    inputs: Inputs, method: str, run_path: Path, peer: Path | None = None
) -> Record:
    """Mesh one scene by one method, or by a peer's lines, into `run_path`; measure mesh and points.

    Raises:
        ColmapEdgesError: Something is missing or fails; see its message.
    """
    if peer is None:
        points = mesh_own(inputs, methods()[method], run_path)
    else:
        points = mesh_peer(inputs.model, peer, run_path)
    mesh = load_mesh(run_path / "mesh.ply")
    sfm_points = None if points is inputs.model else inputs.model
    return measure(mesh, points, inputs.reference, run_path / "maps", sfm_points=sfm_points)


def mesh_own(inputs: Inputs, options: PipelineOptions, run_path: Path) -> Model:
    """Run the pipeline into `run_path`; returns the evaluated points: the edges' or all."""
    from colmap_edges.pipeline.paths import Paths
    from colmap_edges.pipeline.run import run as run_pipeline

    paths = Paths(image_path=inputs.image_path, input_path=inputs.sparse_path, output_path=run_path)
    run_pipeline("mesh", paths, options, overwrite=True)
    if not options.use_edges:
        return inputs.model
    return edges.edge_points(load_model(run_path / "sparse"), inputs.model)


def mesh_peer(model: Model, path: Path, run_path: Path) -> Model:
    """Mesh a peer's lines with the model's points into `run_path`; returns the lines' points."""
    from colmap_edges.export.meshes import write_mesh
    from colmap_edges.surfaces.mesher import mesh

    found = peers.load(path, model)
    run_path.mkdir(parents=True, exist_ok=True)
    write_mesh(mesh(model, edges=found), run_path / "mesh.ply")
    return edges.points_of_edges(found, model)
