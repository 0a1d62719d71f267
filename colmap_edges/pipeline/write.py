"""The writing stage: model with edge points, edges, and reports."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

import colmap_edges
from colmap_edges.colmap.model import Model, observation_residuals
from colmap_edges.colmap.writing import points_of_tracks, with_edge_points, write_model
from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.formats import FORMATS, notes_on
from colmap_edges.export.meshes import MESH_FORMATS, write_mesh
from colmap_edges.export.ply import write_ply
from colmap_edges.export.written import read_edges
from colmap_edges.options import PipelineOptions, recorded
from colmap_edges.pipeline.paths import Paths
from colmap_edges.report.contents import Contents
from colmap_edges.report.diagnosis import diagnose
from colmap_edges.report.funnel import funnel
from colmap_edges.report.page import write_report
from colmap_edges.runtime.cache import library_version
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.patches.finding import NO_PATCHES, Patches

logger = logging.getLogger(__name__)


def write_stage(
    model: Model,
    edges: Edges3D,
    curves: Curves3D,
    folder: Path,
    options: PipelineOptions,
    stages: Stages,
    patches: Patches = NO_PATCHES,
) -> Model:
    """Write the model with edge points, and the edges as polylines and curves.

    With `write_patches` the model has the patches, too.

    Returns:
        The model with the edge points appended.
    """
    with stages.stage("write") as stage:
        residuals = observation_residuals(model, edges)
        sparse = folder / "sparse"
        added = None
        if options.write_patches:
            textured = patches.textured
            grays = patches.grays[: len(textured.points)]
            added = points_of_tracks(model, *textured, grays)
        ids = write_model(model, edges, sparse, options.output_type, residuals, added)
        write_ply(edges, folder / "edges.ply")
        write_json(edges, curves, model, ids, residuals, folder / "edges.json")
        stage.counts = {
            "edges": edges.num_edges,
            "edge_points": edges.num_distinct,
            "length": float(f"{edges.lengths().sum():.6g}"),
            "observations": len(edges.distinct()[0].observations.views),
            "median_residual_px": round(float(np.median(residuals)), 4) if len(residuals) else None,
        }
    return with_edge_points(model, edges, ids)


def export_stage(
    folder: Path, mesh: Mesh | None, names: Sequence[str], stages: Stages, up: FloatArray
) -> None:
    """Write the edges of an output folder, and the mesh, in further formats.

    Args:
        folder: the folder, whose edges are read back; without any, none are written.
        mesh: the mesh, written in those formats that hold meshes.
        names: the formats.
        stages: the stages of the run.
        up: (3,) upward direction.
    """
    if not names:
        return
    with stages.stage("export") as stage:
        written = read_edges(folder) if (folder / "edges.json").exists() else None
        for name in names:
            if written and written.edges.num_edges:
                place, write = FORMATS[name]
                result = write(written, folder / place, True, up, "")
                for note in notes_on(written, result):
                    logger.warning(note)
            if mesh and f".{name}" in MESH_FORMATS:
                write_mesh(mesh, folder / f"mesh.{name}", up=up)
        stage.counts = {"formats": len(names)}


def report_stage(contents: Contents, folder: Path, record: dict[str, Any], stages: Stages) -> None:
    """Write report.html, with 3D viewer, overlays and figures."""
    with stages.stage("report") as stage:
        stage.counts = write_report(folder / "report.html", contents, record)


def make_report(
    command: str,
    paths: Paths,
    options: PipelineOptions,
    settings: PipelineOptions,
    stages: Stages,
) -> dict[str, Any]:
    """Make the content of report.json."""
    return {
        "command": command,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "versions": versions(),
        "paths": asdict(paths),
        "options": asdict(options),
        "settings": recorded(settings),
        "stages": stages.records(),
        "findings": [found._asdict() for found in diagnose(stages.records(), options)],
        "funnel": [asdict(step) for step in funnel(stages.records(), options)],
    }


def versions() -> dict[str, str]:
    """Versions of this package and its libraries."""
    names = ("numpy", "opencv-contrib-python-headless", "pycolmap", "scipy")
    found = {name: library_version(name) for name in names}
    own = {"colmap-edges": colmap_edges.__version__}
    return own | {name: number for name, number in found.items() if number}
