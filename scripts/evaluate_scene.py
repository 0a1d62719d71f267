#!/usr/bin/env python3
"""Errors of a mesh against depth maps, a mesh, a point cloud, or held-out SfM points."""

from __future__ import annotations

import json
from pathlib import Path

import click

from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation import tables
from colmap_edges.evaluation.protocols import scene
from colmap_edges.runtime.output import write_whole


@click.command(help=__doc__)
@click.option("--mesh_path", type=Path, required=True, help="Mesh to evaluate.")
@click.option("--input_path", type=Path, required=True, help="COLMAP model with the views.")
@click.option(
    "--reference_path",
    type=Path,
    help="Folder of depth maps (*.npz), a mesh or a point cloud; none: the depth at the "
    "observations of the points of --input_path (give points the mesh was made without).",
)
@click.option("--view_names", multiple=True, help="Views for a reference mesh, or 'all'.")
@click.option("--thresholds", multiple=True, type=float, help="Distances for precision, recall.")
@click.option("--output_path", type=Path, help="Folder for evaluation.json and error maps.")
@exit_on_error()
def main(
    mesh_path: Path,
    input_path: Path,
    reference_path: Path | None,
    view_names: tuple[str, ...],
    thresholds: tuple[float, ...],
    output_path: Path | None,
) -> None:
    record = scene.evaluate_mesh(
        mesh_path,
        input_path,
        reference_path,
        view_names=view_names,
        thresholds=thresholds,
        pictures_path=output_path,
    )
    if output_path is not None:
        output_path.mkdir(parents=True, exist_ok=True)
        figures = f"{json.dumps(record, indent=2)}\n".encode()
        write_whole(output_path / "evaluation.json", figures, "figures")
    click.echo(tables.mesh_tables(record))


if __name__ == "__main__":
    main()
