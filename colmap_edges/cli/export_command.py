"""The command `export`: writes the edges of an output folder in another program's format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

import click

from colmap_edges.cli.errors import one_line_errors
from colmap_edges.cli.help import Command
from colmap_edges.cli.imports import importing
from colmap_edges.cli.terminal import say

STRUCTURES = "structures"  # folder name required by LIMAP


@click.command(cls=Command, name="export")
@click.option(
    "--run_path",
    type=click.Path(path_type=Path, exists=True),
    required=True,
    help="Output folder of reconstruct, mesh or LIMAP, or LIMAP's alltracks.txt",
)
@click.option(
    "--output_path",
    type=click.Path(path_type=Path),
    required=True,
    help="File to write: .step, .stp, .dxf, .svg, .glb, .obj or .ply; or a folder named "
    "structures, for LIMAP",
)
@click.option("--svg", metavar="IMAGE", help="Image into which an .svg projects the edges")
@click.option("--overwrite", is_flag=True, help="Replace an existing file")
@click.option("--verbose", is_flag=True, help="Show the traceback of errors")
def export(verbose: bool, **values: Any) -> None:
    """Write the edges of an output folder for another program."""
    with one_line_errors(verbose):
        say(*export_edges(**values))


def export_edges(run_path: Path, output_path: Path, svg: str | None, overwrite: bool) -> list[str]:
    """Write edges in the format given by the output's suffix.

    Returns:
        Lines of text about the written file.

    Raises:
        ColmapEdgesError: the edges, the format or the image do not exist, or the output exists or
            cannot be written.
    """
    with importing():
        from colmap_edges.errors import ColmapEdgesError
        from colmap_edges.export.written import read_edges
        from colmap_edges.runtime.output import one_line

        write = writers().get(output_path.suffix.lower())
    if (output_path.name != STRUCTURES and write is None) or (
        (svg is not None) != (output_path.suffix.lower() == ".svg")
    ):
        raise ColmapEdgesError(
            f"cannot write edges as {output_path.name!r}; give a file named .step, .stp, .dxf, "
            ".glb, .obj, .ply, or .svg with --svg IMAGE, or a folder named structures"
        )
    check_place(output_path, run_path, write is not None, overwrite)
    written = read_edges(run_path)
    if not written.edges.num_edges:
        raise ColmapEdgesError(f"{run_path} holds no edges, so there is nothing to write")
    with one_line("cannot make", output_path.parent):
        output_path.parent.mkdir(parents=True, exist_ok=True)
    if write is None:
        from colmap_edges.export.limap import write_structures

        edges, curves, model = written.edges, written.curves, written.model
        count = write_structures(edges, curves, model, output_path, overwrite=overwrite)
        return [f"{count:,} lines in {output_path}; LIMAP reads them with the model of {run_path}"]
    return described(written, output_path, write(written, output_path, svg, overwrite))


def check_place(output_path: Path, run_path: Path, is_file: bool, overwrite: bool) -> None:
    """Check that the output is apart from the input, and may be written.

    Raises:
        ColmapEdgesError: otherwise.
    """
    from colmap_edges.runtime.output import check_apart, check_file, check_free, one_line

    with one_line("cannot write to", output_path):
        if run_path.is_dir():
            place = output_path.parent.resolve() / output_path.name
            check_apart("output_path", place, [run_path.resolve()])
        if is_file:
            check_file(output_path, overwrite)
        elif output_path.parent.exists():
            check_free(output_path, overwrite)


def described(written: Any, path: Path, step: Any) -> list[str]:
    """Lines about a written file; `step` is the result of `write_step`, or None."""
    all_curves = written.curves.num_curves
    text = f"{all_curves:,} curves of {written.edges.num_edges:,} edges: {path}"
    if step is None:
        return [text]
    notes = []
    if missing := all_curves - step.num_curves:
        notes.append(
            f"Note: {missing:,} of {all_curves:,} curves are left out, since they have no length "
            "that STEP files can hold."
        )
        text = f"{step.num_curves:,} of {text}"
    if step.unit_mm != 1:
        notes.append(
            f"Note: one unit of the model is {step.unit_mm:,.0f} mm in the file, since programs "
            "would take the ends of its short curves as one point."
        )
    return [*notes, text]


def writers() -> dict[str, Callable[[Any, Path, str | None, bool], Any]]:
    """Writer functions by file suffix."""
    from colmap_edges.export.dxf import write_dxf
    from colmap_edges.export.edges import write_obj
    from colmap_edges.export.glb import write_glb
    from colmap_edges.export.ply import write_ply
    from colmap_edges.export.step import write_step

    return {
        ".step": lambda found, path, _, over: write_step(found.curves, path, overwrite=over),
        ".stp": lambda found, path, _, over: write_step(found.curves, path, overwrite=over),
        ".dxf": lambda found, path, _, over: write_dxf(found.curves, path, overwrite=over),
        ".glb": lambda found, path, _, over: write_glb(found.edges, path, overwrite=over),
        ".obj": lambda found, path, _, over: write_obj(found.edges, path, overwrite=over),
        ".ply": lambda found, path, _, over: write_ply(found.edges, path, overwrite=over),
        ".svg": write_view,
    }


def write_view(written: Any, path: Path, name: str | None, overwrite: bool) -> None:
    """Write the edges projected into the image named `name`.

    Raises:
        ColmapEdgesError: there is no posed image of that name, or the file cannot be written.
    """
    from colmap_edges.errors import ColmapEdgesError
    from colmap_edges.export.svg import write_svg

    views = written.model.views
    names = [PurePosixPath(view.name) for view in views]  # without "./"
    if PurePosixPath(name or "") not in names:
        raise ColmapEdgesError(
            f"no posed image is named {name!r}; names look like {views[0].name!r}"
        )
    index = names.index(PurePosixPath(name or ""))
    write_svg(written.edges, written.curves, views[index], index, path, overwrite=overwrite)
