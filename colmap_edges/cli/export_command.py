"""The command `export`: writes the edges of an output folder in another program's format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

import click

from colmap_edges.cli.errors import one_line_errors
from colmap_edges.cli.help import Command
from colmap_edges.cli.terminal import say

FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
STRUCTURES = "structures"  # folder name required by LIMAP


@click.command(cls=Command, name="export")
@click.option(
    "--run_path",
    type=FOLDER,
    required=True,
    help="Output folder of reconstruct, mesh or LIMAP",
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
        say(export_edges(**values))


def export_edges(run_path: Path, output_path: Path, svg: str | None, overwrite: bool) -> str:
    """Write edges in the format given by the output's suffix.

    Returns:
        A line of text about the written file.

    Raises:
        ColmapEdgesError: the edges, the format or the image do not exist, or the output exists.
    """
    from colmap_edges.errors import ColmapEdgesError
    from colmap_edges.evaluation.readers.results import read_edges

    write = writers().get(output_path.suffix.lower())
    if (output_path.name != STRUCTURES and write is None) or (
        (svg is not None) != (output_path.suffix.lower() == ".svg")
    ):
        raise ColmapEdgesError(
            f"cannot write edges as {output_path.name!r}; give a file named .step, .stp, .dxf, "
            ".glb, .obj, .ply, or .svg with --svg IMAGE, or a folder named structures"
        )
    if output_path.exists() and not overwrite:
        raise ColmapEdgesError(
            f"{output_path} exists already; choose another path or add --overwrite"
        )
    if run_path.resolve() in output_path.resolve().parents:
        raise ColmapEdgesError(f"{output_path} is inside {run_path}; give a path outside of it")
    written = read_edges(run_path)
    output_path.parent.mkdir(parents=True, exist_ok=True)
    if write is None:
        from colmap_edges.export.limap import write_structures

        count = write_structures(written.edges, written.curves, written.model, output_path)
        return f"{count:,} lines in {output_path}; LIMAP reads them with the model of {run_path}"
    write(written, output_path, svg)
    return (
        f"{written.curves.num_curves:,} curves of {written.edges.num_edges:,} edges: {output_path}"
    )


def writers() -> dict[str, Callable[[Any, Path, str | None], None]]:
    """Writer functions by file suffix."""
    from colmap_edges.export.dxf import write_dxf
    from colmap_edges.export.edges import write_obj, write_ply
    from colmap_edges.export.glb import write_glb
    from colmap_edges.export.step import write_step

    return {
        ".step": lambda written, path, _: write_step(written.curves, path),
        ".stp": lambda written, path, _: write_step(written.curves, path),
        ".dxf": lambda written, path, _: write_dxf(written.curves, path),
        ".glb": lambda written, path, _: write_glb(written.edges, path),
        ".obj": lambda written, path, _: write_obj(written.edges, path),
        ".ply": lambda written, path, _: write_ply(written.edges, path),
        ".svg": write_view,
    }


def write_view(written: Any, path: Path, name: str | None) -> None:
    """Write the edges projected into the image named `name`.

    Raises:
        ColmapEdgesError: there is no posed image of that name.
    """
    from colmap_edges.errors import ColmapEdgesError
    from colmap_edges.export.svg import write_svg

    names = [PurePosixPath(view.name) for view in written.model.views]  # without "./"
    if PurePosixPath(name or "") not in names:
        raise ColmapEdgesError(
            f"no posed image is named {name!r}; names look like {written.model.views[0].name!r}"
        )
    index = names.index(PurePosixPath(name or ""))
    write_svg(written.edges, written.curves, written.model.views[index], index, path)
