"""Entry point of the command line: parses flags and calls the commands."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import click

from colmap_edges.cli.align_command import align
from colmap_edges.cli.errors import one_line_errors
from colmap_edges.cli.export_command import export
from colmap_edges.cli.flags import in_given_case, normalize
from colmap_edges.cli.help import Command, full_help_flag
from colmap_edges.cli.imports import importing
from colmap_edges.cli.run_commands import make_run_command
from colmap_edges.cli.terminal import (
    HANDLED,
    RECEIVED,
    handle_signals,
    handled_signals,
    open_streams,
    say,
    show_usage_error,
    tell,
)
from colmap_edges.cli.version import show_version
from colmap_edges.errors import extra
from colmap_edges.runtime.memory import reuse_freed_memory

FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)


@click.command(cls=Command, name="info")
@click.argument("path", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--verbose", is_flag=True, help="Show all counts; show the traceback of errors")
def info(path: Path, verbose: bool) -> None:
    """Describe the COLMAP model or output folder at PATH."""
    with one_line_errors(verbose):
        with importing():
            from colmap_edges.cli.info import describe

        tell(*describe(path, verbose))


@click.command(cls=Command, name="evaluate")
@click.option("--run_path", type=FOLDER, required=True, help="Output folder of colmap-edges mesh")
@click.option(
    "--input_path", type=FOLDER, required=True, help="COLMAP model that the run started from"
)
@click.option(
    "--reference_path",
    type=click.Path(path_type=Path, exists=True),
    help="Reference depth maps, mesh or point cloud; by default half of the SfM points",
)
@click.option(
    "--curves_path",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Reference 3D curves (.npz or .ply)",
)
@click.option(
    "--image_path", type=FOLDER, help="Images, needed for --held_out_views and pictures of edges"
)
@click.option(
    "--held_out_views",
    type=click.IntRange(0, 1_000_000),
    default=0,
    show_default=True,
    help="Leave every n-th image out of the reconstruction and evaluate edges in it; 0 disables",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing evaluation")
@click.option("--verbose", is_flag=True, help="Log each step; show the traceback of errors")
def evaluate(verbose: bool, **values: Any) -> None:
    """Evaluate an output folder: errors of its mesh and edges, with pictures."""
    with one_line_errors(verbose):
        with importing(), extra("evaluate", "evaluation"):
            from colmap_edges.evaluation import run as evaluation

        evaluation.run(**values)
        output = values["run_path"] / "evaluation"
        say(*(output / "evaluation.md").read_text(encoding="utf-8").split("\n"))
        say(f"Figures and pictures are in {output}")


@click.group(context_settings={"token_normalize_func": normalize, "max_content_width": 100})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=show_version,
    help="Show the versions of this program and its libraries, and exit",
)
def cli() -> None:
    """Reconstruct straight and curved 3D edges of COLMAP models, and meshes that follow them."""


cli.params.append(full_help_flag("Show this help; after a command, all of its options, and exit"))
for command in (
    make_run_command(
        "detect", "Detect 2D edge graphs: one .npz and one overlay per image.", "detect"
    ),
    make_run_command(
        "reconstruct",
        "Reconstruct 3D edges and write them into the COLMAP model.",
        *("detect", "trace", "write"),
    ),
    make_run_command(
        "mesh",
        "Reconstruct 3D edges, write them, and mesh points and edges.",
        *("detect", "trace", "write", "mesh"),
    ),
    *(info, evaluate, export, align),
):
    cli.add_command(command)


def main(argv: list[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0, 1 on bad input, 2 on bad usage, 130 on Ctrl-C."""
    # Images and views are processed by our own threads. BLAS threads would compete with them, and
    # make rounding depend on their number. BLAS reads the setting when numpy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Libraries make many objects at import, and arrays are freed without collections of garbage.
    gc.set_threshold(50_000)
    open_streams()
    HANDLED[:] = handled_signals()
    handle_signals(HANDLED)
    reuse_freed_memory()
    run: Callable[..., Any] = cli.main
    try:
        code = run(argv, prog_name="colmap-edges", standalone_mode=False)
    except click.NoSuchOption as error:
        show_usage_error(in_given_case(error, sys.argv[1:] if argv is None else argv))
        sys.exit(error.exit_code)
    except click.ClickException as error:
        show_usage_error(error)
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        say("Interrupted; nothing was written.", err=True)
        sys.exit(130)
    except Exception:
        if not RECEIVED:
            raise
        # Some libraries turn an interrupt into an exception of their own.
        say("Interrupted; nothing was written.", err=True)
        sys.exit(128 + RECEIVED[0])
    sys.exit(code if isinstance(code, int) else 0)
