"""The command `align`, and the flags of a frame that it shares with `export`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from colmap_edges.cli.errors import one_line_errors
from colmap_edges.cli.flags import Word
from colmap_edges.cli.help import Command
from colmap_edges.cli.imports import importing
from colmap_edges.cli.terminal import tell
from colmap_edges.export.units import AXES, METRES

FLAGS = ("up", "scale", "edge_length", "unit", "ground")


def measured_edge(value: str) -> tuple[int, float]:
    """The number of an edge and its length, from a text such as 12=2.40."""
    edge, _, length = value.partition("=")
    try:
        found = int(edge), float(length)
    except ValueError:
        found = -1, 0.0
    if found[0] < 0 or not 0 < found[1] < float("inf"):
        raise click.BadParameter(
            f"{value!r} is not the number of an edge, an equals sign and its length, such as "
            "12=2.40"
        )
    return found


def frame_flags(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the flags of a frame to a command."""
    flags = (
        click.option(
            "--up",
            type=Word(("auto", *AXES)),
            metavar="|".join(("auto", *AXES)),
            help="Turn this axis of the model to z; auto estimates what is up from images and "
            "straight edges [no turn]",
        ),
        click.option(
            "--scale",
            type=click.FloatRange(0, min_open=True),
            metavar="FACTOR",
            help="Multiply all lengths",
        ),
        click.option(
            "--edge_length",
            type=measured_edge,
            metavar="EDGE=LENGTH",
            help="Scale so that the edge of this number in the report gets this length: 12=2.40",
        ),
        click.option(
            "--unit",
            type=Word(METRES),
            metavar="|".join(METRES),
            help="Unit of the new coordinates; converts them if the unit is known from align",
        ),
        click.option(
            "--ground",
            is_flag=True,
            help="Put the largest horizontal plane at z = 0; made level unless --up names an axis",
        ),
    )
    for flag in reversed(flags):
        command = flag(command)
    return command


@click.command(cls=Command, name="align")
@click.option(
    "--run_path",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    required=True,
    help="Output folder of reconstruct, mesh or align",
)
@click.option(
    "--output_path",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder to write: model, edges and mesh in the new frame",
)
@frame_flags
@click.option("--overwrite", is_flag=True, help="Replace an existing output")
@click.option("--verbose", is_flag=True, help="Show the traceback of errors")
def align(run_path: Path, output_path: Path, overwrite: bool, verbose: bool, **values: Any) -> None:
    """Turn, scale and shift an output folder: model, edges, mesh and faces."""
    with one_line_errors(verbose):
        with importing():
            from colmap_edges.export.alignment import Wanted
            from colmap_edges.pipeline.align import align_run

        lines = align_run(run_path, output_path, Wanted(**values), overwrite=overwrite)
        tell(*lines)
