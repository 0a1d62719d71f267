"""From images to the paper's tables: scenes meshed by several methods, measured, resumable."""

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
from colmap_edges.colmap.triangulation import PosedImage, triangulate
from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import pictures, tables
from colmap_edges.evaluation.metrics import clouds, depth, edges
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_geometry, load_mesh
from colmap_edges.evaluation.metrics.statistics import summarize
from colmap_edges.evaluation.protocols import dtu
from colmap_edges.evaluation.protocols.scene import views_named
from colmap_edges.evaluation.readers import peers
from colmap_edges.runtime.input_files import read_text

logger = logging.getLogger(__name__)

Record = dict[str, Any]
Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Reference:
    """What a scene is measured against; any part may be missing.

    Attributes:
        depths: Depth maps: meshes are judged by them, and points without `points`.
        points: (N, 3) dense cloud: points are judged by their distance to it.
        surface: Mesh: the same, where there is no cloud.
        dtu: DTU's benchmark data.
    """

    depths: Sequence[depth.ReferenceDepth] = ()
    points: FloatArray | None = None
    surface: Any = None
    dtu: dtu.DtuReference | None = None


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Images with what is known of them.

    Attributes:
        name: Name in the tables and of the output folder.
        image_path: Folder of the images.
        load_reference: Reads the reference, given the model.
        sparse_path: COLMAP model; None: triangulated from `posed`.
        posed: Images with poses.
        peers: Results of other systems by name, see `peers.load`.
        unit: Unit of its lengths.
        problem: Why it cannot be run; empty when it can.
    """

    name: str
    image_path: Path
    load_reference: Callable[[Model], Reference]
    sparse_path: Path | None = None
    posed: Sequence[PosedImage] = ()
    peers: Mapping[str, Path] = field(default_factory=dict)
    unit: str = "world unit"
    problem: str = ""


@dataclass(frozen=True, kw_only=True)
class Method:
    """A way from a model to a mesh: with or without edges, with changed meshing options."""

    use_edges: bool
    meshing: Mapping[str, Any] = field(default_factory=dict)


METHODS = {
    "SfM": Method(use_edges=False),
    "COLMAP-like": Method(use_edges=False, meshing={"quality_weight": 1.0}),
    "edges": Method(use_edges=True),
}


def run(
    scenes: Sequence[Scene],
    output_path: Path,
    methods: Sequence[str] = ("SfM", "edges"),
    *,
    progress: Progress = logger.info,
) -> Record:
    """Mesh and measure every scene by every method, and write evaluation.json and evaluation.md.

    What an earlier run finished is read again. A scene or method that fails is reported in its
    place and does not stop the others.

    Returns:
        What evaluation.json holds: by scene, by method.
    """
    output_path.mkdir(parents=True, exist_ok=True)
    results: Record = {}
    for number, scene in enumerate(scenes, start=1):
        progress(f"[{number}/{len(scenes)}] {scene.name}")
        folder = output_path / scene.name
        results[scene.name] = {"unit": scene.unit, "methods": {}}
        for method in [*methods, *scene.peers]:
            record = _run_method(scene, method, folder, progress)
            results[scene.name]["methods"][method] = record
        write_results(results, output_path)
    return results


def write_results(results: Record, output_path: Path) -> None:
    """Write evaluation.json and evaluation.md."""
    (output_path / "evaluation.json").write_text(json.dumps(results, indent=2) + "\n")
    (output_path / "evaluation.md").write_text(tables.paper_tables(results) + "\n")


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
    partial = done.with_suffix(".partial")
    partial.write_text(json.dumps(record, indent=2) + "\n")
    partial.replace(done)
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
    if method in scene.peers:
        points = mesh_peer(scene.peers[method], model, run_path)
    elif method in METHODS:
        points = mesh_own(METHODS[method], scene.image_path, sparse_path, model, run_path)
    else:
        raise ColmapEdgesError(f"no method {method}; choose from {', '.join(METHODS)}")
    mesh = load_mesh(run_path / "mesh.ply")
    return measure(mesh, points, scene.load_reference(model), run_path / "maps")


def triangulated(scene: Scene, path: Path) -> Path:
    """The sparse model of the scene's posed images, made once."""
    if not (path / "points3D.bin").is_file():
        partial = path.with_name(path.name + ".partial")
        triangulate(scene.posed, scene.image_path, partial)
        partial.rename(path)
    return path


def mesh_own(
    method: Method, image_path: Path, sparse_path: Path, model: Model, run_path: Path
) -> Model:
    """Run the pipeline into `run_path`; returns the points that count: the edges' or all."""
    from colmap_edges.options import PipelineOptions
    from colmap_edges.pipeline.paths import Paths
    from colmap_edges.pipeline.run import run as run_pipeline

    options = PipelineOptions(use_edges=method.use_edges)
    options = replace(options, meshing=replace(options.meshing, **method.meshing))
    paths = Paths(image_path=image_path, input_path=sparse_path, output_path=run_path)
    run_pipeline("mesh", paths, options, overwrite=True)
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


def measure(mesh: Any, points: Model, reference: Reference, maps_path: Path | None) -> Record:
    """Errors of a mesh and of the points that a method adds (of all points without edges)."""
    record: Record = {"faces": len(mesh.faces), "points": point_errors(points, reference)}
    if reference.depths:
        caster = RayCaster(mesh.vertices, mesh.faces)
        results = [depth.depth_errors(caster, known) for known in reference.depths]
        pooled, coverage = depth.pool(results)
        record["mesh"] = asdict(pooled) | {"coverage": coverage}
        if maps_path is not None:
            pictures.write_error_maps(maps_path, results)
    if reference.dtu is not None:
        record["dtu"] = asdict(dtu.evaluate_mesh(mesh, reference.dtu))
    return record


def point_errors(points: Model, reference: Reference) -> Record:
    """Statistics of points against the reference (see the module's tables) and their number."""
    xyz = points.points3D_xyz
    if reference.points is not None:
        errors, of = clouds.cloud_to_cloud(xyz, reference.points), "distance to the cloud"
    elif reference.surface is not None:
        mesh = reference.surface
        errors, of = clouds.cloud_to_mesh(xyz, mesh.vertices, mesh.faces), "distance to the mesh"
    elif reference.depths:
        errors = edges.depth_window_errors(points, reference.depths, relative=False)
        of = "depth in observing views"
    else:
        return {"count": len(xyz)}
    return asdict(summarize(errors)) | {"of": of, "count": len(xyz)}


def file_reference(
    path: Path | None, view_names: Sequence[str] = ()
) -> Callable[[Model], Reference]:
    """Reader of a folder of depth maps, a mesh, a cloud (seen by the central view), or nothing.

    Args:
        path: File or folder of the reference, or none.
        view_names: Views that see a mesh, or `all`; default: the central one.
    """

    def read(model: Model) -> Reference:
        if path is None:
            return Reference()
        if path.is_dir():
            return Reference(depths=depth.load_reference_depths(path, model))
        geometry = load_geometry(path)
        vertices = np.asarray(geometry.vertices, dtype=np.float64)
        if len(getattr(geometry, "faces", ())):
            caster = RayCaster(vertices, geometry.faces)
            depths = depth.render_references(caster, views_named(model, view_names))
            return Reference(depths=depths, surface=geometry)
        central = depth.cloud_depth(vertices, depth.central_view(model))
        return Reference(depths=[central], points=vertices)

    return read


def dtu_reference(root: Path, scan: int) -> Callable[[Model], Reference]:
    """Reader of DTU's data: cloud, its depth from the central camera, mask."""

    def read(model: Model) -> Reference:
        data = dtu.load_reference(root, scan)
        view = depth.central_view(model)
        depths = [depth.cloud_depth(data.points, view)]
        return Reference(depths=depths, points=data.points, dtu=data)

    return read


def dtu_scene(
    root: Path, scan: int, light: str = "", peer_paths: Mapping[str, str] | None = None
) -> Scene:
    """A scan in the official layout; `{scan}` in a peer's path becomes the scan's number."""
    image_path, posed = dtu.posed_images(root, scan, light=light)
    found = {name: Path(path.format(scan=scan)) for name, path in (peer_paths or {}).items()}
    return Scene(
        name=f"DTU-{scan:03d}",
        image_path=image_path,
        posed=posed,
        load_reference=dtu_reference(root, scan),
        peers=found,
        unit="mm",
    )


def repackaged_scene(
    folder: Path, reference_path: Path | None, peer_paths: Mapping[str, str] | None = None
) -> Scene:
    """A folder in the NeuS/IDR layout.

    Args:
        folder: With image/ and cameras*.npz.
        reference_path: Depth maps, mesh or cloud; or the official data's root, then the number in
            the folder's name is the scan; or none.
        peer_paths: Results of other systems; `{scan}` becomes the folder's name.
    """
    image_path, posed = dtu.repackaged_images(folder)
    digits = "".join(c for c in folder.name if c.isdigit())
    reader = file_reference(reference_path)
    if reference_path is not None and reference_path.is_dir() and digits:
        has_points = any((reference_path / p / "Points").is_dir() for p in dtu.PARTS)
        if has_points:
            reader = dtu_reference(reference_path, int(digits))
    found = {name: Path(p.format(scan=folder.name)) for name, p in (peer_paths or {}).items()}
    return Scene(
        name=folder.name,
        image_path=image_path,
        posed=posed,
        load_reference=reader,
        peers=found,
        unit="mm",
    )


def parse_peers(entries: Sequence[str]) -> dict[str, str]:
    """Split NAME=PATH entries.

    Raises:
        ColmapEdgesError: One is of another form.
    """
    found = {}
    for entry in entries:
        name, sign, path = entry.partition("=")
        if not (name and sign and path):
            raise ColmapEdgesError(f"{entry!r} names no peer; write NAME=PATH")
        found[name] = path
    return found


def dtu_scenes(
    root: Path, scans: Sequence[int], light: str = "", peer_paths: Mapping[str, str] | None = None
) -> list[Scene]:
    """Scenes of several scans; one that cannot be read becomes a scene that fails when run."""
    scenes = []
    for scan in scans:
        try:
            scenes.append(dtu_scene(root, scan, light, peer_paths))
        except ColmapEdgesError as error:
            scenes.append(
                Scene(
                    name=f"DTU-{scan:03d}",
                    image_path=root,
                    load_reference=file_reference(None),
                    unit="mm",
                    problem=str(error),
                )
            )
    return scenes
