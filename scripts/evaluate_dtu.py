#!/usr/bin/env python3
"""From DTU's images to the paper's tables.

Reads the official layout (Rectified/scanN or Cleaned/scanN, Calibration/cal18, Points, ObsMask) or
a NeuS/IDR folder (image/, cameras*.npz). Finished scans are not done again.
"""

from __future__ import annotations

from pathlib import Path

import click

from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation import benchmark
from colmap_edges.evaluation.protocols import dtu


@click.command(help=__doc__)
@click.option("--input_path", type=Path, required=True, help="Root of the data, or one folder.")
@click.option("--output_path", type=Path, required=True, help="Folder for models and tables.")
@click.option("--scans", type=int, multiple=True, help="Default: the paper's that are there.")
@click.option("--light", default="", help="Light of the official images, as 'max' or '3_r5000'.")
@click.option(
    "--reference_path",
    type=Path,
    help="Of a NeuS/IDR folder: depth maps, mesh, cloud, or the root of the official data.",
)
@click.option("--methods", multiple=True, default=("SfM", "edges"), show_default=True)
@click.option("--peers", multiple=True, help="NAME=PATH of a peer's result; {scan} in it varies.")
@exit_on_error()
def main(
    input_path: Path,
    output_path: Path,
    scans: tuple[int, ...],
    light: str,
    reference_path: Path | None,
    methods: tuple[str, ...],
    peers: tuple[str, ...],
) -> None:
    found = benchmark.parse_peers(peers)
    if dtu.is_repackaged(input_path):
        scenes = [benchmark.repackaged_scene(input_path, reference_path, found)]
    else:
        numbers = scans or dtu.scan_numbers(input_path)
        scenes = benchmark.dtu_scenes(input_path, numbers, light, found)
    benchmark.run(scenes, output_path, methods, progress=click.echo)
    click.echo((output_path / "evaluation.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
