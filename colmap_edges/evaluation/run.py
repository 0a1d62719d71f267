"""The command `evaluate`: errors of an output folder, as figures and pictures."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

import colmap_edges
from colmap_edges.colmap.model import Model, load_model
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import held_out, tables
from colmap_edges.evaluation.edge_errors import evaluate_edges
from colmap_edges.evaluation.mesh_errors import evaluate_mesh
from colmap_edges.export.edges_json import load_edges
from colmap_edges.export.meshes import MESH_FORMATS
from colmap_edges.runtime.output import new_folder, write_whole
from colmap_edges.runtime.ownership import EVALUATION, PROGRAM, file_sizes


def run(
    run_path: Path,
    input_path: Path,
    reference_path: Path | None = None,
    *,
    curves_path: Path | None = None,
    image_path: Path | None = None,
    held_out_views: int = 0,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Evaluate the output of `colmap-edges mesh` and write figures and pictures to RUN/evaluation/.

    Args:
        run_path: Output folder; its mesh is evaluated, and edges.ply with sparse/ if present.
        input_path: COLMAP model the run started from.
        reference_path: Depth maps, mesh or point cloud; without it a mesh of half of the model's
            points (and the run's edges) is compared with the other half.
        curves_path: Reference 3D curves.
        image_path: Images, for `held_out_views` and for overlays of edges.
        held_out_views: Leave out every n-th image and evaluate edges in it; 0 disables.
        overwrite: Replace an existing evaluation.

    Returns:
        The content of evaluation.json.

    Raises:
        ColmapEdgesError: Something is missing; see its message.
    """
    output = run_path / "evaluation"
    find_mesh(run_path)
    if os.path.lexists(output) and not overwrite:
        raise ColmapEdgesError(f"{output} exists already; add --overwrite to replace it")
    if held_out_views and image_path is None:
        raise ColmapEdgesError("held-out views need the images; give --image_path")
    with new_folder(output, EVALUATION, overwrite) as folder:
        record = figures(run_path, input_path, reference_path, curves_path, image_path, folder)
        if held_out_views and image_path is not None:
            record["held_out_views"] = held_out.left_out_view_errors(
                input_path, image_path, held_out_views, pictures_path=folder
            )
        text = tables.run_tables(record) + "\n"
        write_whole(folder / "evaluation.md", text.encode(), "tables")
        record["versions"] = {PROGRAM: colmap_edges.__version__}
        record["files"] = file_sizes(folder)
        tables.write_figures(folder / EVALUATION.record, record)
    return record


def figures(
    run_path: Path,
    input_path: Path,
    reference_path: Path | None,
    curves_path: Path | None,
    image_path: Path | None,
    pictures_path: Path,
) -> dict[str, Any]:
    """Figures of the mesh and edges of `run_path`; see `run`."""
    record: dict[str, Any] = {}
    has_depths = reference_path is not None and reference_path.is_dir()
    if reference_path is not None:
        record["mesh"] = evaluate_mesh(
            find_mesh(run_path), input_path, reference_path, pictures_path=pictures_path
        )
    else:
        record["held_out_points"] = held_out_points(run_path, input_path)
    if (run_path / "edges.ply").is_file():
        record["edges"] = evaluate_edges(
            run_path / "edges.ply",
            run_path / "sparse",
            input_path,
            reference_path=curves_path,
            reference_depth_path=reference_path if has_depths else None,
            image_path=image_path,
            pictures_path=pictures_path,
        )
    return record


def find_mesh(run_path: Path) -> Path:
    """The mesh of an output folder, of any format.

    Raises:
        ColmapEdgesError: There is none.
    """
    for suffix in MESH_FORMATS:
        if (path := run_path / f"mesh{suffix}").is_file():
            return path
    names = ", ".join(f"mesh{suffix}" for suffix in MESH_FORMATS)
    raise ColmapEdgesError(
        f"{run_path} holds no mesh ({names}); give an output of colmap-edges mesh"
    )


def held_out_points(run_path: Path, input_path: Path) -> dict[str, Any]:
    """Errors of a mesh of half of the points at the other half, without and with the edges.

    Cameras, poses and points are those of the run, which may have refined them.
    The edges were traced with all points; only the mesh is made without the held-out ones.
    """
    given = load_model(input_path)
    has_edges = (run_path / "edges.json").is_file()
    model, where = sfm_points_of(run_path, given) if has_edges else given, str(input_path)
    record = {"SfM only": held_out.split_half_errors(model, where=where)}
    if has_edges:
        edges = load_edges(run_path, model)
        record["with edges"] = held_out.split_half_errors(model, edges, where)
    return record


def sfm_points_of(run_path: Path, given: Model) -> Model:
    """The given model as a run refined its cameras, poses and points, without edge points."""
    model = load_model(run_path / "sparse")
    return model.selected(np.isin(model.point3D_ids, given.point3D_ids))
