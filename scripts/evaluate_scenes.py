#!/usr/bin/env python3
"""Compute the paper's tables for any COLMAP models, meshed by several methods.

Results of finished scenes are reused; remove a scene's folder below --output_path to redo it.
"""

from __future__ import annotations

from pathlib import Path

import click

from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation import benchmark, scenes


@click.command(help=__doc__)
@click.option(
    "--scene",
    "entries",
    type=(str, Path, Path, Path),
    multiple=True,
    required=True,
    metavar="NAME IMAGES SPARSE REFERENCE",
    help="A scene; REFERENCE is a folder of depth maps, a mesh or a point cloud.",
)
@click.option("--unit", default="world unit", show_default=True, help="Unit of the lengths.")
@click.option("--view_names", multiple=True, help="Views that see a reference mesh, or 'all'.")
@click.option("--methods", multiple=True, default=("SfM", "edges", "faces"), show_default=True)
@click.option("--peers", multiple=True, help="NAME=PATH of a peer's result; {scene} in it varies.")
@click.option("--baseline", default="", help="Row of the average variation; default: the first.")
@click.option("--output_path", type=Path, required=True, help="Folder for meshes and tables.")
@exit_on_error()
def main(
    entries: tuple[tuple[str, Path, Path, Path], ...],
    unit: str,
    view_names: tuple[str, ...],
    methods: tuple[str, ...],
    peers: tuple[str, ...],
    baseline: str,
    output_path: Path,
) -> None:
    found = scenes.parse_peers(peers)
    listed = [
        scenes.Scene(
            name=name,
            image_path=image_path,
            sparse_path=sparse_path,
            load_reference=scenes.file_reference(reference_path, view_names),
            peers=scenes.peers_of(found, scene=name),
            unit=unit,
        )
        for name, image_path, sparse_path, reference_path in entries
    ]
    benchmark.run(listed, output_path, methods, baseline=baseline, progress=click.echo)
    click.echo((output_path / "evaluation.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
