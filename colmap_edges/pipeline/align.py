"""A run in another frame: its model, edges, faces, mesh and further formats."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model, observation_residuals
from colmap_edges.colmap.writing import write_moved
from colmap_edges.core.similarity import Similarity
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.export.alignment import (
    RECORD,
    Alignment,
    Wanted,
    aligned,
    alignment_of,
    alignment_record,
    moved_mesh,
    read_alignment,
)
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.faces import write_faces
from colmap_edges.export.formats import FORMATS
from colmap_edges.export.meshes import MESH_FORMATS, read_mesh, write_mesh
from colmap_edges.export.written import FACES, WrittenEdges, read_edges
from colmap_edges.pipeline.write import versions
from colmap_edges.runtime.input_files import read_json
from colmap_edges.runtime.output import check_output_path, new_folder, write_whole
from colmap_edges.runtime.ownership import OUTPUT, file_sizes


def align_run(
    run_path: Path, output_path: Path, wanted: Wanted, *, overwrite: bool = False
) -> list[str]:
    """Write an output folder in another frame; the original is not changed.

    Model, edges, faces, mesh and further formats are written if they are in the original. The
    report is not: it shows the original frame, but numbers of edges are the same.

    Args:
        run_path: output folder of a run.
        output_path: folder to make.
        wanted: the frame.
        overwrite: replace an existing output.

    Returns:
        Lines of text about the output.

    Raises:
        ColmapEdgesError: if nothing is asked for, there is no such edge or no ground, or the
            output cannot be written.
    """
    if not wanted.moves:
        raise OptionError("nothing to do; give up, ground, scale, edge_length or unit")
    run = Path(os.path.realpath(run_path))
    output = Path(os.path.realpath(output_path.parent), output_path.name)
    check_output_path(output, [run], overwrite)
    if not (run / "edges.json").is_file():
        raise ColmapEdgesError(
            f"{run_path} holds no edges.json; give the output folder of reconstruct or mesh"
        )
    written, earlier = read_edges(run), read_alignment(run)
    alignment = alignment_of(written, wanted, earlier.get("unit", ""))
    record, scale = alignment_record(alignment, earlier), alignment.aligned_from_model.scale
    with new_folder(output, OUTPUT, overwrite) as folder:
        model = write_sparse(written.model, alignment.aligned_from_model, folder)
        write_edges(aligned(written, alignment.aligned_from_model), model, folder)
        write_exports(run, alignment, folder)
        write_whole(folder / RECORD, text_of(record), "alignment")
        write_whole(
            folder / OUTPUT.record, text_of(report_of(run, record, scale, folder)), "report"
        )
    return description(alignment, output_path)


def write_sparse(model: Model, moved: Similarity, folder: Path) -> Model:
    """Write the model in the new frame, and read it back."""
    sparse = folder / "sparse"
    write_moved(model.reconstruction, moved.scale, moved.rotation, moved.translation, sparse)
    return load_model(sparse)


def write_edges(written: WrittenEdges, model: Model, folder: Path) -> None:
    """Write edges.json and, where there are faces, faces.json."""
    edges, curves, ids = written.edges, written.curves, written.point3D_ids
    residuals = observation_residuals(model, edges)
    write_json(edges, curves, model, ids, residuals, folder / "edges.json")
    if written.faces or written.round_faces:
        write_faces(written.faces, model, folder / FACES, round_faces=written.round_faces)


def write_exports(run: Path, alignment: Alignment, folder: Path) -> None:
    """Write the edges and the mesh in the formats of the original."""
    written, up, unit = read_edges(folder), alignment.up, alignment.unit
    for place, write in FORMATS.values():
        if (run / place).exists() and written.edges.num_edges:
            write(written, folder / place, True, up, unit)
    meshes = [run / f"mesh{suffix}" for suffix in MESH_FORMATS]
    for path in meshes:
        if path.is_file():  # each by itself, since not all formats hold a texture
            mesh = moved_mesh(read_mesh(path), alignment.aligned_from_model)
            write_mesh(mesh, folder / path.name, up=up, unit=unit)


def report_of(run: Path, alignment: dict[str, Any], scale: float, folder: Path) -> dict[str, Any]:
    """The content of report.json: that of the run with the alignment, lengths and the files."""
    path = run / OUTPUT.record
    record: dict[str, Any] = {"command": "align", "stages": []}
    if path.is_file():
        record = read_json(path)
    changed = {"alignment": alignment, "versions": versions(), "files": file_sizes(folder)}
    for stage in record["stages"]:
        for name, power in (("length", 1), ("area", 2)):
            if name in stage["counts"]:
                stage["counts"][name] *= scale**power
    return record | changed


def text_of(record: dict[str, Any]) -> bytes:
    """The bytes of a JSON file."""
    return f"{json.dumps(record, indent=2, allow_nan=False)}\n".encode()


def description(alignment: Alignment, output: Path) -> list[str]:
    """Lines about the new frame."""
    moved = alignment.aligned_from_model
    texts = {
        "Up": ", ".join(f"{value:.4g}" for value in moved.rotation[2] + 0.0) + " became z",
        "Scale": f"{moved.scale:.6g}, unit {alignment.unit or 'unknown'}",
        "Ground": f"{-moved.translation[2] / moved.scale:.4g} above the origin became z = 0",
        "Look at": f"{output} (colmap gui, Blender, CAD programs)",
    }
    if np.array_equal(moved.rotation, np.eye(3)):
        del texts["Up"]
    if not moved.translation.any():
        del texts["Ground"]
    return [f"{name + ':':9} {text}" for name, text in texts.items()]
