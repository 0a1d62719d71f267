"""Evaluation of a mesh or 3D edges on any scene, with any kind of reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import pictures
from colmap_edges.evaluation.metrics import (
    clouds,
    curves,
    depth,
    edge_graphs,
    edges,
    kinds,
    normals,
    visible_curves,
)
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_geometry, load_mesh
from colmap_edges.evaluation.metrics.statistics import summarize
from colmap_edges.evaluation.readers.curves import Curves, load_curves, read_curves
from colmap_edges.export import peers
from colmap_edges.export.edges_json import load_edges
from colmap_edges.export.written import read_edges

Record = dict[str, Any]
THRESHOLDS = (0.005, 0.01, 0.02)  # relative to the longest side of the reference's box


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
    model = load_model(input_path)
    mesh = load_mesh(mesh_path)
    record: Record = {"mesh": str(mesh_path), "faces": len(mesh.faces), "unit": "world unit"}
    caster = RayCaster(mesh.vertices, mesh.faces)
    if reference_path is None:
        return record | _against_points(caster, model)
    if reference_path.is_dir():
        references = depth.load_reference_depths(reference_path, model)
        return record | _against_depth(caster, references, pictures_path)
    reference = load_geometry(reference_path)
    if len(getattr(reference, "faces", ())):
        views = views_named(model, view_names)
        true = RayCaster(reference.vertices, reference.faces)
        record |= _against_depth(caster, depth.render_references(true, views), pictures_path)
        points = sample_surface(reference.vertices, reference.faces)
    else:
        points = np.asarray(reference.vertices, dtype=np.float64)
    return record | _against_cloud(mesh, points, thresholds)


def views_named(model: Model, names: Sequence[str]) -> list[Any]:
    """The views called `names`, `all` of them, or (none named) the central one.

    Raises:
        ColmapEdgesError: The model holds no view of that name.
    """
    if not names:
        return [depth.central_view(model)]
    if list(names) == ["all"]:
        return list(model.views)
    views = {view.name: view for view in model.views}
    missing = [name for name in names if name not in views]
    if missing:
        raise ColmapEdgesError(f"the model holds no image {', '.join(missing)}")
    return [views[name] for name in names]


def sample_surface(vertices: Any, faces: Any, count: int = 200_000, seed: int = 0) -> Any:
    """`count` points (count, 3) spread over a surface by area."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return np.asarray(points, dtype=np.float64)


def _against_depth(
    caster: RayCaster, references: list[depth.ReferenceDepth], pictures_path: Path | None
) -> Record:
    results = [depth.depth_errors(caster, reference) for reference in references]
    if pictures_path is not None:
        pictures.write_error_maps(pictures_path, results)
    views = {result.name: result.record() for result in results}
    names = ("coverage", *depth.RIGHT_WITHIN, *normals.NORMALS_WITHIN)
    mean = {
        name: float(np.mean([view[name] for view in views.values() if name in view]))
        for name in names
        if any(name in view for view in views.values())
    }
    return {"depth": {"pooled": depth.pool(results), "mean_of_views": mean, "views": views}}


def _against_points(caster: RayCaster, model: Model) -> Record:
    if not len(model.points3D_xyz):
        raise ColmapEdgesError("without a reference the model must hold points, and it has none")
    return {"points_depth": depth.observation_depth_statistics(caster, model)}


def _against_cloud(mesh: Any, points: Any, thresholds: Sequence[float]) -> Record:
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    thresholds = thresholds or [share * diagonal for share in (0.001, 0.002, 0.005, 0.01)]
    samples = sample_surface(mesh.vertices, mesh.faces)
    to_reference = clouds.cloud_to_cloud(samples, points)
    to_mesh = clouds.cloud_to_mesh(points, mesh.vertices, mesh.faces)
    return {
        "accuracy": asdict(summarize(to_reference)),
        "completeness": asdict(summarize(to_mesh)),
        "scores": [asdict(s) for s in clouds.scores(to_reference, to_mesh, thresholds)],
    }


def evaluate_edges(
    edges_path: Path,
    sparse_path: Path,
    input_path: Path | None = None,
    *,
    reference_path: Path | None = None,
    surface_path: Path | None = None,
    reference_depth_path: Path | None = None,
    thresholds: Sequence[float] = (),
    thresholds_px: Sequence[float] = (1.0, 2.0),
    unit_size: bool = False,
    crop: bool = False,
) -> Record:
    """Measure 3D edges against curves and depth maps, and against their own observations.

    Args:
        edges_path: Edge graph as PLY with `vertex` and `edge` elements, or a peer's lines.
        sparse_path: COLMAP model with the edge points; a peer's are sampled from its lines.
        input_path: Model without them; without it every point counts as an edge point.
        reference_path: True curves (.npz or .ply).
        surface_path: True surface; if given, recall counts true curves visible in at least three
            views, and `thresholds_px` apply.
        reference_depth_path: Folder of depth maps.
        thresholds: Distances for precision and recall; default 0.005, 0.01 and 0.02 of the
            longest side of the reference's box.
        thresholds_px: The same in pixels at the scene's depth, with `surface_path`.
        unit_size: Scale so that the longest side of the reference's box is 1.
        crop: Count only what lies in the reference's box.

    Returns:
        The content of `evaluation.json`.
    """
    model = load_model(sparse_path)
    found = read_curves(edges_path)
    run = run_edges(edges_path, model)
    record: Record = {
        "edges": str(edges_path),
        "lengths": asdict(edges.segment_lengths(found)),
        "twins": _twins(found, run, model),
    }
    points = _edge_points(edges_path, model, input_path)
    if edges_path.suffix in (".ply", ".npz"):  # other lines are sampled at their projections
        record["reprojection"] = asdict(edges.reprojection_errors(points))
    if reference_path is not None:
        true = load_curves(reference_path)
        limits = thresholds or default_thresholds(true, unit_size)
        if surface_path is not None:
            record["curves"] = _against_visible_curves(
                found, true, model, input_path, surface_path, thresholds_px
            )
        else:
            scores = curves.compare_curves(found, true, limits, unit_size=unit_size, crop=crop)
            record["curves"] = asdict(scores)
            limit = min(limits) * (np.ptp(true.points, axis=0).max() if unit_size else 1.0)
            record |= _against_kinds(edges_path, reference_path, float(limit))
        record |= _as_graph(found, run, true, limits, unit_size=unit_size)
    if reference_depth_path is not None:
        references = depth.load_reference_depths(reference_depth_path, model)
        record["depth"] = _points_against_depth(points, input_path, references)
    return record


def _edge_points(edges_path: Path, model: Model, input_path: Path | None) -> Model:
    """The points of edges: those of a model that its input lacks, or samples of lines."""
    if edges_path.suffix not in (".ply", ".npz"):
        return edges.points_of_edges(peers.load(edges_path, model), model)
    return model if input_path is None else edges.edge_points(model, load_model(input_path))


def _against_kinds(edges_path: Path, reference_path: Path, threshold: float) -> Record:
    """Errors of kinds and radii, if reference and output folder hold them."""
    true = kinds.true_curves(reference_path, threshold / kinds.SAMPLES)
    if true is None or not (edges_path.parent / "edges.json").is_file():
        return {}
    found = read_edges(edges_path.parent).curves
    return {"kinds": asdict(kinds.compare_kinds(found, true, threshold))}


def run_edges(edges_path: Path, model: Model) -> Edges3D | None:
    """The edges of an output folder with their tracks and nodes; None for edges without these."""
    beside = edges_path.parent
    is_run = (beside / "edges.json").is_file() and (beside / "sparse").is_dir()
    if edges_path.name != "edges.ply" or not is_run:
        return None
    return load_edges(edges_path.parent, model)


def _twins(found: Curves, run: Edges3D | None, model: Model) -> list[Record]:
    """Shares of the edges' length with parallel twins, in pixels of the observing views."""
    if run is None:
        sizes = visible_curves.visibility(found.points, model.views, None).pixel_size
    else:
        sizes = edge_graphs.observed_pixel_sizes(run, model.views)
    sizes = np.where(np.isfinite(sizes), sizes, np.median(sizes[np.isfinite(sizes)], axis=0))
    return [asdict(share) for share in edge_graphs.twin_shares(found, sizes)]


def _as_graph(
    found: Curves,
    run: Edges3D | None,
    true: Curves,
    thresholds: Sequence[float],
    *,
    unit_size: bool,
) -> Record:
    """How often true edges are found and, with nodes, precision and recall of corners."""
    unit = float(np.ptp(true.points, axis=0).max()) if unit_size else 1.0
    times = edge_graphs.times_found(found, true, thresholds, unit)
    record: Record = {"times_found": [asdict(row) for row in times]}
    if run is not None and len(true.segments):
        ends = (edge_graphs.found_corners(run) / unit, edge_graphs.true_corners(true) / unit)
        scores = edge_graphs.compare_corners(*ends, thresholds)
        record["corners"] = {
            "scores": [asdict(row) for row in scores],
            "result_corners": len(ends[0]),
            "reference_corners": len(ends[1]),
        }
    return record


def _points_against_depth(
    points: Model, input_path: Path | None, references: Sequence[depth.ReferenceDepth]
) -> Record:
    """Errors of edge points and, measured the same way, of SfM points."""
    models = {"edge_points": points}
    if input_path is not None:
        models["sfm_points"] = load_model(input_path)
    return {
        name: asdict(edges.summarize_depth(edges.depth_window_errors(kind, references)))
        for name, kind in models.items()
    }


def _against_visible_curves(
    found: Curves,
    true: Curves,
    model: Model,
    input_path: Path | None,
    surface_path: Path,
    thresholds_px: Sequence[float],
) -> Record:
    """Errors in pixels, and those of the SfM points against the same surface."""
    surface = load_mesh(surface_path)
    record: Record = asdict(
        visible_curves.compare_visible_curves(
            found, true, model.views, surface, thresholds_px=thresholds_px
        )
    )
    if input_path is not None:
        points = load_model(input_path).points3D_xyz
        record["sfm_points_on_surface"] = visible_curves.on_surface(
            points, model.views, surface, thresholds_px
        )
    return record


def default_thresholds(reference: Curves, unit_size: bool) -> list[float]:
    """0.005, 0.01 and 0.02 of the longest side of the reference's box."""
    side = 1.0 if unit_size else float(np.ptp(reference.points, axis=0).max())
    return [share * side for share in THRESHOLDS]
