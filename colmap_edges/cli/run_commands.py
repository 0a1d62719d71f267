"""The commands that run the pipeline: their flags, config files and paths."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from colmap_edges.cli.errors import one_line_errors
from colmap_edges.cli.flags import (
    Word,
    make_flags,
    names_of_stages,
    options_from_flags,
    read_config,
)
from colmap_edges.cli.help import Command
from colmap_edges.cli.imports import importing
from colmap_edges.cli.terminal import progress_bars, say, tell
from colmap_edges.colmap.workspace import find_images, find_model
from colmap_edges.options import METHODS, QUALITIES, PipelineOptions
from colmap_edges.runtime.stages import Progress


def load_config(ctx: click.Context, _param: click.Parameter, value: Path | None) -> None:
    """Use the values of the TOML file as defaults; flags on the command line override them."""
    if value:
        ctx.default_map = read_config(ctx, value)


def path_flag(name: str, help: str) -> click.Option:
    """Make a flag that takes a path."""
    return click.Option([f"--{name}"], type=click.Path(path_type=Path), help=help)


def preset_flags() -> list[click.Option]:
    """Make the flags that choose a preset."""
    return [
        click.Option(
            ["--quality"],
            type=Word(QUALITIES),
            metavar="|".join(QUALITIES),
            help="Preset: low is faster, high matches more views; other flags override it [medium]",
        ),
        click.Option(
            ["--method"],
            type=Word(METHODS),
            metavar="|".join(METHODS),
            help="Trace edges by depths along chains, or trace and mesh as in the paper of Bignoli "
            "et al.; other flags override its values [chains]",
        ),
    ]


def export_flag() -> click.Option:
    """Make the flag that chooses further formats."""
    return click.Option(
        ["--export"],
        default="",
        metavar="FORMAT,...",
        help="Further formats of the edges and the mesh, separated by commas: obj, glb, dxf, step, "
        "svg (a drawing of each image), limap",
    )


def cloud_flags() -> list[click.Option]:
    """Make the flags that name a dense cloud."""
    return [
        path_flag("dense_path", "COLMAP's dense workspace, whose fused.ply is meshed"),
        path_flag("points", "Dense cloud to mesh, as PLY (OpenMVS, laser scanners, ...)"),
        path_flag("visibility", "fused.ply.vis of --points [found by a depth test]"),
    ]


def recording_target(value: str) -> str:
    """Check the value of --rerun: 0, 1 or the name of a recording."""
    if value in ("0", "1") or value.lower().endswith(".rrd"):
        return value
    raise click.BadParameter(f"{value!r} is neither 0, 1 nor a FILE.rrd")


def run_flags(stages: Sequence[str]) -> list[click.Parameter]:
    """Make the flags of a command that runs these stages."""
    return [
        path_flag(
            "workspace_path",
            "COLMAP workspace with images and sparse/0; default of paths",
        ),
        path_flag("image_path", "Folder of the images [WORKSPACE/images]"),
        path_flag("input_path", "Folder of the COLMAP model, bin or txt [WORKSPACE/sparse/0]"),
        path_flag("output_path", "Output folder, made at the end [WORKSPACE/edges]"),
        path_flag(
            "mask_path",
            "Folder of masks named as in COLMAP, IMAGE.png, or one mask for all images; edges in "
            "black areas are ignored",
        ),
        path_flag(
            "edge_path",
            "Folder of edge images of another detector, IMAGE.png, white on black; used instead of "
            "EdgeDrawing",
        ),
        path_flag(
            "cache_path",
            "Cache folder for results that later runs reuse; can be deleted at any time",
        ),
        click.Option(
            ["--scheduler"],
            default="",
            metavar="ADDRESS",
            help="dask cluster, such as tcp://host:8786; needs --cache_path",
        ),
        *(cloud_flags() if "mesh" in stages else []),
        *([*preset_flags(), export_flag()] if "trace" in stages else []),
        click.Option(
            ["--config"],
            type=click.Path(path_type=Path, exists=True, dir_okay=False),
            is_eager=True,
            expose_value=False,
            callback=load_config,
            help="TOML file with flags as keys, groups as tables; the command line overrides it",
        ),
        click.Option(
            ["--rerun"],
            type=recording_target,
            metavar="0|1|FILE.rrd",
            default="0",
            help="Show the run live in the rerun viewer (1), or record it to a file [0]",
        ),
        click.Option(["--overwrite"], is_flag=True, help="Replace an existing output"),
        click.Option(
            ["--verbose"],
            is_flag=True,
            help="Log each step, list the results of each stage, show the traceback of errors",
        ),
        *make_flags(names_of_stages(*stages)),
    ]


def make_run_command(name: str, help: str, *stages: str) -> click.Command:
    """Make the command `name`, which runs these stages of the pipeline."""

    def callback(**values: Any) -> None:
        with one_line_errors(values["verbose"]):
            run_command(name, values)

    return Command(name, params=run_flags(stages), callback=callback, help=help)


def run_command(name: str, values: dict[str, Any]) -> None:
    """Run one command with the values of its flags and print the summary."""
    started = time.perf_counter()
    options = options_from_flags(values)
    paths = paths_from_flags(values, name != "mesh" or options.use_edges)
    with progress_bars() as progress:
        progress("read", 0, 1)  # before the imports, which take a second
        report = run_stages(name, values, paths, options, progress)
    from colmap_edges.cli.summary import summary

    if values["rerun"] not in ("0", "1"):
        say(f"The recording in {values['rerun']} opens in rerun's viewer: rerun {values['rerun']}")
    seconds = time.perf_counter() - started
    tell(*summary(report, paths["output_path"], seconds, values["verbose"]))


def run_stages(
    name: str,
    values: dict[str, Any],
    paths_of_flags: dict[str, Any],
    options: PipelineOptions,
    progress: Progress,
) -> dict[str, Any]:
    """Import the stages, run them, and return the report."""
    with importing():
        from colmap_edges.export.formats import formats_of
        from colmap_edges.pipeline.paths import Paths
        from colmap_edges.pipeline.run import run
        from colmap_edges.report.rerun_viewer import open_viewer

    names = ("mask_path", "edge_path", "cache_path", "dense_path", "points", "visibility")
    optional: dict[str, Any] = {name: values.get(name) for name in names}
    paths, overwrite = Paths(**paths_of_flags, **optional), values["overwrite"]
    exports = formats_of(values.get("export", ""))
    with open_viewer(values["rerun"], paths.output_path, overwrite, paths.inputs) as viewer:
        return run(
            name,
            paths,
            options,
            overwrite=overwrite,
            exports=exports,
            progress=progress,
            scheduler=values["scheduler"],
            viewer=viewer,
        )


def paths_from_flags(values: dict[str, Any], needs_images: bool) -> dict[str, Any]:
    """The paths of a run; required paths that are not given are taken from the workspace."""
    workspace = values["workspace_path"]
    finders: dict[str, Callable[[Path], Path]] = {
        "input_path": find_model,
        "output_path": lambda folder: folder / "edges",
    }
    if needs_images:
        finders = {"image_path": find_images, **finders}
    missing = [name for name in finders if values[name] is None]
    if missing and workspace is None:
        flags = ", ".join(f"--{name}" for name in missing)
        raise click.UsageError(f"Missing {flags}; or give --workspace_path")
    found = {name: find(workspace) for name, find in finders.items() if name in missing}
    return {"image_path": values["image_path"], **{n: values[n] for n in finders}, **found}
