"""The formats in which edges are written on request: one table for runs and for `export`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import OptionError
from colmap_edges.export.dxf import write_dxf
from colmap_edges.export.edges import write_obj
from colmap_edges.export.glb import write_glb
from colmap_edges.export.limap import write_structures
from colmap_edges.export.meshes import MESH_FORMATS
from colmap_edges.export.ply import write_ply
from colmap_edges.export.step import StepFile, check_kernel, write_step
from colmap_edges.export.svg import write_svgs
from colmap_edges.export.written import WrittenEdges


class Format(NamedTuple):
    """One format.

    Attributes:
        place: name of its file or folder in the output folder of a run.
        write: writes edges to a path; further arguments say whether to replace an earlier output,
            which (3,) direction is up, and the unit of the coordinates, which may be empty.
    """

    place: str
    write: Callable[[WrittenEdges, Path, bool, FloatArray, str], Any]


def ply(written: WrittenEdges, path: Path, overwrite: bool, _up: FloatArray, _unit: str) -> None:
    """Write edges as PLY."""
    write_ply(written.edges, path, overwrite=overwrite)


def obj(written: WrittenEdges, path: Path, overwrite: bool, up: FloatArray, unit: str) -> None:
    """Write edges as OBJ."""
    write_obj(written.edges, path, up=up, unit=unit, overwrite=overwrite)


def glb(written: WrittenEdges, path: Path, overwrite: bool, up: FloatArray, unit: str) -> None:
    """Write edges as GLB."""
    write_glb(written.edges, path, up=up, unit=unit, overwrite=overwrite)


def dxf(written: WrittenEdges, path: Path, overwrite: bool, _up: FloatArray, unit: str) -> None:
    """Write curves as DXF."""
    write_dxf(written.curves, path, unit=unit, overwrite=overwrite)


def step(written: WrittenEdges, path: Path, overwrite: bool, _up: FloatArray, unit: str) -> Any:
    """Write curves and faces of revolution as STEP."""
    return write_step(
        written.curves, path, round_faces=written.round_faces, unit=unit, overwrite=overwrite
    )


def svg(written: WrittenEdges, path: Path, overwrite: bool, _up: FloatArray, _unit: str) -> None:
    """Write curves as one SVG for each image."""
    edges, curves, views = written.edges, written.curves, written.model.views
    write_svgs(edges, curves, views, path, overwrite=overwrite)


def limap(written: WrittenEdges, path: Path, overwrite: bool, _up: FloatArray, _unit: str) -> int:
    """Write lines for LIMAP."""
    edges, curves, model = written.edges, written.curves, written.model
    return write_structures(edges, curves, model, path, overwrite=overwrite)


FORMATS = {
    "ply": Format("edges.ply", ply),
    "obj": Format("edges.obj", obj),
    "glb": Format("edges.glb", glb),
    "dxf": Format("edges.dxf", dxf),
    "step": Format("edges.step", step),
    "svg": Format("svg", svg),
    "limap": Format("structures", limap),
}
OF_MODEL = ("svg", "limap")  # which are used with the model's cameras


def formats_of(text: str) -> list[str]:
    """The formats in a list with commas, once each.

    Raises:
        OptionError: if one is unknown.
    """
    names = [word.strip().lower() for word in text.split(",") if word.strip()]
    for name in names:
        if name not in FORMATS:
            raise OptionError(f"export is {name!r}; choose from: {', '.join(FORMATS)}")
    return list(dict.fromkeys(names))


def check_formats(names: Sequence[str], has_edges: bool) -> None:
    """Check before a run that its output can be written in these formats.

    Raises:
        ColmapEdgesError: if a library is missing, or there will be neither edges nor a mesh.
    """
    if "step" in names:
        check_kernel()
    for name in names:
        if not has_edges and f".{name}" not in MESH_FORMATS:
            raise OptionError(
                f"export is {name!r} and use_edges 0, but {name} holds edges and no mesh; "
                "set use_edges 1"
            )


def notes_on(written: WrittenEdges, result: Any, unit: str = "") -> list[str]:
    """Differences between edges and their file, as sentences.

    Args:
        written: the edges.
        result: that of a `Format.write`.
        unit: unit of the coordinates, or empty if unknown.
    """
    if not isinstance(result, StepFile):
        return []
    notes, num_curves = [], written.curves.num_curves
    if missing := num_curves - result.num_curves:
        notes.append(
            f"{missing:,} of {num_curves:,} curves are left out, since they have no length that "
            "STEP files can hold."
        )
    if not unit and result.unit_mm != 1:
        notes.append(
            f"one unit of the model is {result.unit_mm:,.0f} mm in the STEP file, since programs "
            "would take the ends of its short curves as one point."
        )
    elif not unit:
        notes.append(
            "one unit of the model is 1 mm in the STEP file, since its scale is unknown; "
            "`colmap-edges export` with --edge_length or --unit sets it."
        )
    return notes
