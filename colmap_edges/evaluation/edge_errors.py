"""Errors of 3D edges against curves, depth maps and their own observations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import nearest_pixel_sizes
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import pictures
from colmap_edges.evaluation.metrics import (
    curves,
    depth,
    edge_graphs,
    edges,
    kinds,
)
from colmap_edges.evaluation.metrics.raycasting import load_mesh
from colmap_edges.evaluation.metrics.statistics import Record
from colmap_edges.evaluation.readers.curves import Curves, load_curves, read_curves
from colmap_edges.export import peers
from colmap_edges.export.edges_json import load_edges
from colmap_edges.export.written import read_edges


def evaluate_edges(
    edges_path: Path,
    sparse_path: Path,
    input_path: Path | None = None,
    *,
    reference_path: Path | None = None,
    reference_depth_path: Path | None = None,
    image_path: Path | None = None,
    pictures_path: Path | None = None,
    **choices: Any,
) -> Record:
    """Measure 3D edges against curves and depth maps, and against their own observations.

    Args:
        edges_path: Edge graph as PLY with `vertex` and `edge` elements, or a peer's lines.
        sparse_path: COLMAP model with the edge points; a peer's are sampled from its lines.
        input_path: Model without them; without it every point counts as an edge point.
        reference_path: True curves (.npz or .ply).
        reference_depth_path: Folder of depth maps.
        image_path: Images, over which points with a reference depth are drawn.
        pictures_path: Folder for these pictures.
        choices: Of the comparison with curves, see `against_curves`.

    Returns:
        The content of `evaluation.json`.
    """
    model = load_model(sparse_path)
    sfm = None if input_path is None else load_model(input_path)
    found, run = read_curves(edges_path), run_edges(edges_path, model)
    record: Record = {
        "edges": str(edges_path),
        "lengths": edges.segment_lengths(found),
        "twins": twins(found, run, model),
    }
    if edges_path.suffix in (".ply", ".npz"):
        points = model if sfm is None else edges.edge_points(model, sfm)
        record["reprojection"] = edges.reprojection_errors(points)
    else:  # other lines are sampled at their projections
        points = edges.points_of_edges(peers.load(edges_path, model), model)
    if reference_path is not None:
        record |= against_curves(edges_path, reference_path, found, model, sfm, run, **choices)
    if reference_depth_path is not None:
        references = depth.load_reference_depths(reference_depth_path, model)
        if image_path is not None and pictures_path is not None:
            pictures.write_edge_overlays(pictures_path, points, references, image_path)
        record["depth"] = {
            name: edges.summarize_depth(edges.depth_window_errors(kind, references))
            for name, kind in (("edge_points", points), ("sfm_points", sfm))
            if kind is not None
        }
    return record


def against_curves(
    edges_path: Path,
    reference_path: Path,
    found: Curves,
    model: Model,
    sfm: Model | None,
    run: Edges3D | None,
    *,
    surface_path: Path | None = None,
    thresholds: Sequence[float] = (),
    thresholds_px: Sequence[float] = (1.0, 2.0),
    unit_size: bool = False,
    crop: bool = False,
) -> Record:
    """Measure the curves `found` in a file against true ones.

    Args:
        edges_path: Their file; kinds of curves are those of edges.json beside it.
        reference_path: True curves (.npz or .ply).
        found: The curves.
        model: Model with the views.
        sfm: Model with the SfM points, which are compared with the surface, too.
        run: The edges of an output folder, whose corners are compared.
        surface_path: True surface; with it recall counts true curves that three views see.
        thresholds: Distances for precision and recall; default 0.005, 0.01, 0.02 of the size.
        thresholds_px: The same in pixels at the scene's depth, with `surface_path`.
        unit_size: Scale so that the longest side of the reference's box is 1.
        crop: Count only what lies in the reference's box.

    Raises:
        ColmapEdgesError: There is no true curve.
    """
    true = load_curves(reference_path)
    if not len(true.points):
        raise ColmapEdgesError(f"{reference_path} holds no curve to compare edges with")
    size = float(np.ptp(true.points, axis=0).max())
    unit = size if unit_size else 1.0
    limits = thresholds or [share * size / unit for share in (0.005, 0.01, 0.02)]
    record: Record = {"times_found": edge_graphs.times_found(found, true, limits, unit)}
    if surface_path is None:
        scores = curves.compare_curves(found, true, limits, unit_size=unit_size, crop=crop)
        record |= against_kinds(edges_path, reference_path, min(limits) * unit)
    else:
        surface = load_mesh(surface_path)
        scores = curves.compare_visible_curves(
            found, true, model.views, surface, thresholds_px=thresholds_px
        )
        if sfm is not None:
            scores["sfm_points_on_surface"] = curves.on_surface(
                sfm.points3D_xyz, model.views, surface, thresholds_px
            )
    if run is not None and len(true.segments):
        corners, wanted = edge_graphs.found_corners(run), edge_graphs.true_corners(true)
        record["corners"] = {
            "scores": edge_graphs.compare_corners(corners / unit, wanted / unit, limits),
            "result_corners": len(corners),
            "reference_corners": len(wanted),
        }
    return record | {"curves": scores}


def run_edges(edges_path: Path, model: Model) -> Edges3D | None:
    """The edges of an output folder with their tracks and nodes; None for edges without these."""
    beside = edges_path.parent
    is_run = (beside / "edges.json").is_file() and (beside / "sparse").is_dir()
    if edges_path.name != "edges.ply" or not is_run:
        return None
    return load_edges(beside, model)


def twins(found: Curves, run: Edges3D | None, model: Model) -> list[Record]:
    """Shares of the edges' length with parallel twins, in pixels of the observing views."""
    if run is None:
        _, sizes = curves.visibility(found.points, model.views, None)
    else:
        seen = run.observations
        sizes = nearest_pixel_sizes(model.views, run.points, seen.points, seen.views)
    sizes = np.where(np.isfinite(sizes), sizes, np.median(sizes[np.isfinite(sizes)], axis=0))
    return edge_graphs.twin_shares(found, sizes)


def against_kinds(edges_path: Path, reference_path: Path, threshold: float) -> Record:
    """Errors of kinds and radii, if reference and output folder hold them."""
    true = kinds.true_curves(reference_path, threshold / 5)
    if true is None or not (edges_path.parent / "edges.json").is_file():
        return {}
    found = read_edges(edges_path.parent).curves
    return {"kinds": kinds.compare_kinds(found, true, threshold)}
