"""The command line: parse, call the pipeline, say what came out, exit."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NoReturn

import click

from colmap_edges import __version__
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.flags import (
    Word,
    make_flags,
    normalize,
    options_from_flags,
    read_config,
    with_dashes,
)
from colmap_edges.memory import reuse_freed_memory
from colmap_edges.options import PRESETS, PipelineOptions
from colmap_edges.terminal import (
    STOPPED,
    heed,
    heeded_signals,
    open_streams,
    progress_bars,
    say,
    show_usage_error,
    start_logging,
)
from colmap_edges.workspace import find_images, find_model

# Options of each command.
MESH_FLAGS = {entry.name for entry in fields(PipelineOptions)}
RECONSTRUCT_FLAGS = MESH_FLAGS - {"meshing", "use_edges", "masks_are_background"}
DETECT_FLAGS = {"num_threads", "max_graph_memory_gb", "random_seed", "detection", "edge_graph"}
# What to open the files of an output folder with.
VIEWERS = {
    "sparse": "COLMAP model: colmap gui, or any program that reads COLMAP models",
    "edges.ply": "3D edges: MeshLab, Blender",
    "edges.obj": "3D edges as polylines: Blender, CloudCompare",
    "edges.glb": "3D edges: glTF viewers, Blender, game engines",
    "edges.dxf": "3D edges as 3D polylines: CAD programs",
    "edges.json": "what each edge is: its points in the model, length, views, residual",
    "mesh.ply": "mesh: MeshLab, Blender, CloudCompare",
    "mesh.obj": "mesh: MeshLab, Blender, CloudCompare",
    "mesh.glb": "mesh: Blender, any glTF viewer",
    "edge_graphs": "2D edge graphs: numpy.load",
    "overlays": "pictures of the 2D edge graphs",
    "report.html": "all of it to look at: a web browser, no network needed",
    "report.json": "options, versions, counts, times and memory of every stage",
}
FULL = f"{__name__}.full_help"
HEEDED: list[int] = []  # signals that end a run
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)


class Command(click.Command):
    """A command that lists the flags of each option group under the group's name."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Make a command as click does, with --help_full."""
        super().__init__(*args, **kwargs)
        self.params.append(full_help_flag())

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the flags, those of no group first; --help_full writes all."""
        groups: dict[str, list[tuple[str, str]]] = {}
        left_out = 0
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if record and not (FULL in ctx.meta or getattr(param, "basic", True)):
                left_out += 1
            elif record:
                group = param.opts[0].removeprefix("--").rpartition(".")[0]
                groups.setdefault(group, []).append(record)
        for group in sorted(groups, key=lambda name: name != ""):
            with formatter.section(group or "Options"):
                formatter.write_dl(groups[group], col_max=45)
        if left_out:
            with formatter.indentation():
                formatter.write(f"\n--help_full shows {left_out} more options of single steps.\n")


def show_full_help(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    """Write the help with every flag and exit."""
    if value and not ctx.resilient_parsing:
        ctx.meta[FULL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


def full_help_flag(
    help: str = "Show all options, also those of single steps, and exit",
) -> click.Option:
    """Make the flag that shows every flag."""
    return click.Option(
        ["--help_full"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=show_full_help,
        help=help,
    )


def load_config(ctx: click.Context, _param: click.Parameter, value: Path | None) -> None:
    """Take what the TOML file says as defaults; flags of the command line go before."""
    if value:
        ctx.default_map = read_config(ctx, value)


def path_flag(name: str, help: str) -> click.Option:
    """Make a flag that takes a path."""
    return click.Option([f"--{name}"], type=click.Path(path_type=Path), help=help)


def quality_flag() -> click.Option:
    """Make the flag that chooses a preset."""
    return click.Option(
        ["--quality"],
        type=Word(PRESETS),
        metavar="|".join(PRESETS),
        help="Preset: low is faster, high compares more views; other flags go before [medium]",
    )


def recording_target(value: str) -> str:
    """Take what --rerun says: 0, 1 or the name of a recording."""
    if value in ("0", "1") or value.lower().endswith(".rrd"):
        return value
    raise click.BadParameter(f"{value!r} is neither 0, 1 nor a FILE.rrd")


def run_flags(names: set[str]) -> list[click.Parameter]:
    """Make the flags of a command that runs stages."""
    return [
        path_flag(
            "workspace_path", "COLMAP workspace: has images and sparse/0; gives the paths below"
        ),
        path_flag("image_path", "Folder of the images [WORKSPACE/images]"),
        path_flag("input_path", "Folder of the COLMAP model, bin or txt [WORKSPACE/sparse/0]"),
        path_flag("output_path", "Folder to make; appears when all is done [WORKSPACE/edges]"),
        path_flag(
            "mask_path",
            "Folder of masks named as COLMAP's, IMAGE.png, or one mask of all images: no edges are "
            "looked for where they are black",
        ),
        path_flag(
            "cache_path",
            "Folder of results that later runs find again: made when missing, can be deleted",
        ),
        click.Option(
            ["--scheduler"],
            default="",
            metavar="ADDRESS",
            help="Let a dask.distributed cluster work, such as tcp://host:8786; needs --cache_path",
        ),
        *([quality_flag()] if "tracing" in names else []),
        click.Option(
            ["--config"],
            type=click.Path(path_type=Path, exists=True, dir_okay=False),
            is_eager=True,
            expose_value=False,
            callback=load_config,
            help="TOML file with flags as keys, groups as tables; flags given here go before",
        ),
        click.Option(
            ["--rerun"],
            type=recording_target,
            metavar="0|1|FILE.rrd",
            default="0",
            help="Show the run in rerun's viewer as it goes, or record it for the viewer [0]",
        ),
        click.Option(["--overwrite"], is_flag=True, help="Replace an earlier output"),
        click.Option(["--verbose"], is_flag=True, help="Log each step; show where errors arise"),
        *make_flags(names),
    ]


def make_run_command(name: str, help: str, names: set[str]) -> click.Command:
    """Make the command that runs the pipeline up to the stage `name`."""

    def callback(**values: Any) -> None:
        with one_line_errors(values["verbose"]):
            run_command(name, values)

    return Command(name, params=run_flags(names), callback=callback, help=help)


def run_command(name: str, values: dict[str, Any]) -> None:
    """Run one command with the values of its flags and print the summary."""
    options = options_from_flags(values)
    from colmap_edges.pipeline import Paths, run  # heavy imports, after parsing
    from colmap_edges.viewer import open_viewer

    heed(HEEDED)
    started = time.perf_counter()
    optional = {name: values[name] for name in ("mask_path", "cache_path")}
    needs_images = name != "mesh" or options.use_edges
    paths = Paths(**paths_from_flags(values, needs_images), **optional)
    target, overwrite = values["rerun"], values["overwrite"]
    with (
        open_viewer(target, paths.output_path, overwrite, paths.inputs) as viewer,
        progress_bars() as progress,
    ):
        report = run(
            name,
            paths,
            options,
            overwrite=overwrite,
            progress=progress,
            scheduler=values["scheduler"],
            viewer=viewer,
        )
    say(*summary(report, paths.output_path, time.perf_counter() - started))
    if target not in ("0", "1"):
        say(f"The recording in {target} opens in rerun's viewer: rerun {target}")


def paths_from_flags(values: dict[str, Any], needs_images: bool) -> dict[str, Any]:
    """The paths of a run; those that are needed and not given come from the workspace."""
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


def summary(report: dict[str, Any], output: Path, seconds: float) -> list[str]:
    """Say what came out, where the files are and what opens them."""
    lines = []
    for stage in report["stages"]:
        counts = (f"{value:,} {key.replace('_', ' ')}" for key, value in scalars(stage["counts"]))
        lines.append(f"{stage['name']:>8}  {stage['wall_s']:6.1f} s  {', '.join(counts)}")
    for finding in report["findings"]:
        lines.append(f"Note: {finding['text']}. To change that: {finding['remedy']}.")
    lines.append(f"Done in {seconds:.1f} s. In {output}:")
    for name, what in VIEWERS.items():
        if (output / name).exists():
            lines.append(f"  {name:12} {what}")
    return lines


def scalars(counts: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """The counts that are single numbers."""
    for key, value in counts.items():
        if isinstance(value, int | float):
            yield key, value


@contextmanager
def one_line_errors(verbose: bool) -> Iterator[None]:
    """Turn known errors into one line and exit 1; usage errors exit 2."""
    start_logging(verbose)
    try:
        yield
    except OptionError as error:
        command = click.get_current_context().command
        raise click.UsageError(with_dashes(str(error), command)) from error
    except BrokenPipeError as error:  # what reads the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise click.exceptions.Exit(1) from error
    except (ColmapEdgesError, OSError, MemoryError) as error:
        if STOPPED:
            raise
        if verbose:
            say(*traceback.format_exc().rstrip().split("\n"), err=True)
        say(f"Error: {str(error).strip() or 'out of memory'}", err=True)
        raise click.exceptions.Exit(1) from error


@click.command(cls=Command, name="info")
@click.argument("path", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--verbose", is_flag=True, help="Show where errors arise")
def info(path: Path, verbose: bool) -> None:
    """Say what PATH holds: a COLMAP model, or an output folder."""
    with one_line_errors(verbose):
        from colmap_edges.info import describe

        say(*describe(path).split("\n"))


@click.command(cls=Command, name="evaluate")
@click.option("--run_path", type=FOLDER, required=True, help="Output folder of mesh")
@click.option("--input_path", type=FOLDER, required=True, help="COLMAP model it started from")
@click.option(
    "--reference_path",
    type=click.Path(path_type=Path, exists=True),
    help="Depth maps, mesh or point cloud; without it half of the model's points are held out",
)
@click.option(
    "--curves_path",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="True 3D curves (.npz or .ply)",
)
@click.option(
    "--image_path", type=FOLDER, help="Images, for --held_out_views and pictures of edges"
)
@click.option(
    "--held_out_views",
    type=click.IntRange(0, 1_000_000),
    default=0,
    show_default=True,
    help="Judge edges in every n-th image, left out of their reconstruction; 0 does not",
)
@click.option("--overwrite", is_flag=True, help="Replace an earlier evaluation")
@click.option("--verbose", is_flag=True, help="Log each step; show where errors arise")
def evaluate(verbose: bool, **values: Any) -> None:
    """Judge an output folder: errors of its mesh and edges, with pictures."""
    with one_line_errors(verbose):
        from colmap_edges import evaluation, model  # noqa: F401 - heavy imports, after parsing

        heed(HEEDED)
        evaluation.run(**values)
        output = values["run_path"] / "evaluation"
        say(*(output / "evaluation.md").read_text(encoding="utf-8").split("\n"))
        say(f"Figures and pictures are in {output}")


def version_text() -> str:
    """Versions of this program and of what it computes with."""
    parts = [f"colmap-edges {__version__}"]
    names = {"pycolmap": "pycolmap", "OpenCV": "opencv-contrib-python-headless", "numpy": "numpy"}
    for name, distribution in names.items():
        try:
            parts.append(f"{name} {version(distribution)}")
        except PackageNotFoundError:
            continue
    return ", ".join([*parts, cgal_text()])


def cgal_text() -> str:
    """Version of the CGAL that the mesher was built with."""
    try:
        from colmap_edges import _mesher
    except ImportError:
        return "no CGAL, so no meshing"
    return f"CGAL {_mesher.cgal_version}"


def show_version(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    """Write the versions and exit."""
    if value and not ctx.resilient_parsing:
        click.echo(version_text())
        ctx.exit()


@click.group(context_settings={"token_normalize_func": normalize, "max_content_width": 100})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=show_version,
    help="Show the versions of this program and of what it computes with, and exit",
)
def cli() -> None:
    """3D edges, straight and curved, for COLMAP models, and meshes that follow them."""


cli.params.append(full_help_flag("Show this; after a command, all of its options, and exit"))
cli.add_command(
    make_run_command(
        "detect", "Detect 2D edge graphs: one .npz and one overlay an image.", DETECT_FLAGS
    )
)
cli.add_command(
    make_run_command(
        "reconstruct",
        "Reconstruct 3D edges and write them into the COLMAP model.",
        RECONSTRUCT_FLAGS,
    )
)
cli.add_command(
    make_run_command(
        "mesh", "Reconstruct 3D edges, write them, and mesh points and edges.", MESH_FLAGS
    )
)
cli.add_command(info)
cli.add_command(evaluate)


def main(argv: list[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0, 1 on bad input, 2 on bad usage, 130 on Ctrl-C."""
    # Each image or view has a thread of its own; those of BLAS would wait for them at full speed,
    # and round by how many they are. It looks when numpy is loaded, by the command that needs it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_streams()
    HEEDED[:] = heeded_signals()
    reuse_freed_memory()
    run: Callable[..., Any] = cli.main
    try:
        code = run(argv, prog_name="colmap-edges", standalone_mode=False)
    except click.ClickException as error:
        show_usage_error(error)
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        say("Interrupted; nothing was written.", err=True)
        sys.exit(130)
    except Exception:
        if not STOPPED:
            raise
        # Some libraries take the signal, raised inside them, for an error of their own.
        say("Interrupted; nothing was written.", err=True)
        sys.exit(128 + STOPPED[0])
    sys.exit(code if isinstance(code, int) else 0)
