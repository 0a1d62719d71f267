"""The command `export`: writes the edges of an output folder in another program's format."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import click

from colmap_edges.cli.align_command import frame_flags
from colmap_edges.cli.errors import one_line_errors
from colmap_edges.cli.help import Command
from colmap_edges.cli.imports import importing
from colmap_edges.cli.terminal import tell


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
@click.option("--polylines", is_flag=True, help="Write a .dxf of 3D polylines instead of curves")
@frame_flags
@click.option("--overwrite", is_flag=True, help="Replace an existing file")
@click.option("--verbose", is_flag=True, help="Show the traceback of errors")
def export(verbose: bool, **values: Any) -> None:
    """Write the edges of an output folder for another program."""
    with one_line_errors(verbose):
        tell(*export_edges(**values))


def export_edges(
    run_path: Path,
    output_path: Path,
    svg: str | None,
    polylines: bool,
    overwrite: bool,
    **frame: Any,
) -> list[str]:
    """Write edges in the format given by the output's suffix.

    Returns:
        Lines of text about the written file.

    Raises:
        ColmapEdgesError: the edges, the format or the image do not exist, or the output exists or
            cannot be written.
    """
    with importing():
        from colmap_edges.errors import ColmapEdgesError
        from colmap_edges.export.alignment import Wanted, aligned, alignment_of, read_alignment
        from colmap_edges.export.dxf import write_dxf_polylines
        from colmap_edges.export.formats import FORMATS, notes_on
        from colmap_edges.export.written import read_edges
        from colmap_edges.runtime.output import one_line

    name, wanted = format_of(output_path), Wanted(**frame)
    check_format(name, output_path, svg is not None, polylines, wanted.moves)
    check_place(output_path, run_path, name != "limap", overwrite)
    written = read_edges(run_path)
    if not written.edges.num_edges:
        raise ColmapEdgesError(f"{run_path} holds no edges, so there is nothing to write")
    earlier = read_alignment(run_path)
    frame_of = alignment_of(written, wanted, earlier.get("unit", ""))
    written = aligned(written, frame_of.aligned_from_model)
    with one_line("cannot make", output_path.parent):
        output_path.parent.mkdir(parents=True, exist_ok=True)
    result, what = None, ""
    if svg is not None:
        write_view(written, output_path, svg, overwrite)
        what = f"{written.curves.num_curves:,} curves of "
    elif polylines:
        write_dxf_polylines(written.edges, output_path, unit=frame_of.unit, overwrite=overwrite)
        what = "polylines of "
    else:
        write = FORMATS[name].write
        result = write(written, output_path, overwrite, frame_of.up, frame_of.unit)
        what = f"{getattr(result, 'num_curves', written.curves.num_curves):,} curves of "
    if name == "limap":
        return [f"{result:,} lines in {output_path}; LIMAP reads them with the model of {run_path}"]
    notes = [f"Note: {note}" for note in notes_on(written, result, frame_of.unit)]
    return [*notes, f"{what}{written.edges.num_edges:,} edges: {output_path}"]


def check_format(name: str, path: Path, has_image: bool, polylines: bool, moves: bool) -> None:
    """Check that edges can be written to a path with these flags.

    Raises:
        ColmapEdgesError: if they cannot.
    """
    from colmap_edges.errors import ColmapEdgesError, OptionError
    from colmap_edges.export.formats import FORMATS, OF_MODEL

    if name not in FORMATS or has_image != (name == "svg"):
        raise ColmapEdgesError(
            f"cannot write edges as {path.name!r}; give a file named .step, .stp, .dxf, "
            ".glb, .obj, .ply, or .svg with --svg IMAGE, or a folder named structures"
        )
    if polylines and name != "dxf":
        raise OptionError(f"polylines is for .dxf files, but the file is {path.name!r}")
    if moves and name in OF_MODEL:
        raise OptionError(
            f"{path.name} must stay in the frame of its cameras; run `colmap-edges align` to move "
            "both"
        )


def format_of(output_path: Path) -> str:
    """Name of the format of a file or folder of this name."""
    if output_path.name == "structures":  # as LIMAP requires
        return "limap"
    suffix = output_path.suffix.lower().removeprefix(".")
    return {"stp": "step", "limap": ""}.get(suffix, suffix)


def check_place(output_path: Path, run_path: Path, is_file: bool, overwrite: bool) -> None:
    """Check that the output is apart from the input, or no file of the run, and may be written.

    Raises:
        ColmapEdgesError: otherwise.
    """
    from colmap_edges.errors import ColmapEdgesError
    from colmap_edges.runtime.output import check_apart, check_file, check_free, one_line
    from colmap_edges.runtime.ownership import OUTPUT, files_of

    with one_line("cannot write to", output_path):
        place = output_path.parent.resolve() / output_path.name
        run, files = run_path.resolve(), None
        if run_path.is_dir() and run in place.parents:
            files = files_of(run, OUTPUT)
        if files is None and run_path.is_dir():
            check_apart("output_path", place, [run])
        elif files is not None:
            relative = place.relative_to(run).as_posix()
            # Whoever reads the model takes all that is in its folder.
            if relative in {*files, OUTPUT.record} or relative.startswith("sparse/"):
                raise ColmapEdgesError(
                    f"{output_path} is a file of the run itself; choose another name"
                )
        if is_file:
            check_file(output_path, overwrite)
        elif output_path.parent.exists():
            check_free(output_path, overwrite)


def write_view(written: Any, path: Path, name: str, overwrite: bool) -> None:
    """Write the edges projected into the image named `name`.

    Raises:
        ColmapEdgesError: there is no posed image of that name, or the file cannot be written.
    """
    from colmap_edges.errors import ColmapEdgesError
    from colmap_edges.export.svg import write_svg

    views = written.model.views
    names = [PurePosixPath(view.name) for view in views]  # without "./"
    if PurePosixPath(name) not in names:
        raise ColmapEdgesError(
            f"no posed image is named {name!r}; names look like {views[0].name!r}"
        )
    index = names.index(PurePosixPath(name))
    write_svg(written.edges, written.curves, views[index], index, path, overwrite=overwrite)
