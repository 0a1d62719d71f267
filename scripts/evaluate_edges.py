#!/usr/bin/env python3
"""Errors of 3D edges against true curves, depth maps and their own observations."""

from __future__ import annotations

import json
from pathlib import Path

import click

from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation import tables
from colmap_edges.evaluation.protocols import scene
from colmap_edges.runtime.output import write_whole


@click.command(help=__doc__)
@click.option("--edges_path", type=Path, required=True, help="edges.ply, or a peer's lines.")
@click.option("--sparse_path", type=Path, required=True, help="COLMAP model with edge points.")
@click.option("--input_path", type=Path, help="Model without edge points.")
@click.option("--reference_path", type=Path, help="True curves: .npz (points, edges) or .ply.")
@click.option(
    "--surface_path",
    type=Path,
    help="True surface (.ply); recall then counts curves that three views see, at --thresholds_px.",
)
@click.option("--reference_depth_path", type=Path, help="Folder of depth maps (*.npz).")
@click.option(
    "--thresholds",
    multiple=True,
    type=float,
    help="Distances for precision and recall; default 0.005, 0.01, 0.02 of the reference's size.",
)
@click.option("--thresholds_px", multiple=True, type=float, default=(1.0, 2.0), show_default=True)
@click.option("--unit_size", type=bool, default=False, help="Scale the reference to size 1.")
@click.option("--crop", type=bool, default=False, help="Evaluate only inside the reference's box.")
@click.option("--output_path", type=Path, help="File for the figures as JSON.")
@exit_on_error()
def main(output_path: Path | None, **arguments: object) -> None:
    record = scene.evaluate_edges(**arguments)  # type: ignore[arg-type]
    if output_path is not None:
        output_path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(output_path, f"{json.dumps(record, indent=2)}\n".encode(), "figures")
    click.echo(tables.edge_tables(record))


if __name__ == "__main__":
    main()
