"""The formats in which edges are written on request: one table for runs and for `export`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

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
        write: writes edges to a path; the last argument says whether to replace an earlier output.
    """

    place: str
    write: Callable[[WrittenEdges, Path, bool], Any]


FORMATS = {
    "ply": Format("edges.ply", lambda e, path, over: write_ply(e.edges, path, overwrite=over)),
    "obj": Format("edges.obj", lambda e, path, over: write_obj(e.edges, path, overwrite=over)),
    "glb": Format("edges.glb", lambda e, path, over: write_glb(e.edges, path, overwrite=over)),
    "dxf": Format("edges.dxf", lambda e, path, over: write_dxf(e.curves, path, overwrite=over)),
    "step": Format("edges.step", lambda e, path, over: write_step(e.curves, path, overwrite=over)),
    "svg": Format(
        "svg",
        lambda e, path, over: write_svgs(e.edges, e.curves, e.model.views, path, overwrite=over),
    ),
    "limap": Format(
        "structures",
        lambda e, path, over: write_structures(e.edges, e.curves, e.model, path, overwrite=over),
    ),
}


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


def notes_on(written: WrittenEdges, result: Any) -> list[str]:
    """What differs between edges and their file; `result` is that of a `Format.write`."""
    if not isinstance(result, StepFile):
        return []
    notes, num_curves = [], written.curves.num_curves
    if missing := num_curves - result.num_curves:
        notes.append(
            f"{missing:,} of {num_curves:,} curves are left out, since they have no length that "
            "STEP files can hold."
        )
    if result.unit_mm != 1:
        notes.append(
            f"one unit of the model is {result.unit_mm:,.0f} mm in the STEP file, since programs "
            "would take the ends of its short curves as one point."
        )
    return notes
