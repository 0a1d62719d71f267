#!/usr/bin/env python3
"""Compute the paper's tables from DTU's images.

Reads the official layout (Rectified/scanN or Cleaned/scanN, Calibration/cal18, Points, ObsMask),
MVSNet's (Cameras, Rectified/scanN_train, Depths) or a NeuS/IDR folder (image/, cameras*.npz).
Results of finished scans are reused.
"""

from __future__ import annotations

from pathlib import Path

import click

from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation import benchmark, scenes
from colmap_edges.evaluation.protocols import dtu


@click.command(help=__doc__)
@click.option("--input_path", type=Path, required=True, help="Root of the data, or one folder.")
@click.option("--output_path", type=Path, required=True, help="Folder for models and tables.")
@click.option("--scans", type=int, multiple=True, help="Default: the paper's, where present.")
@click.option("--light", default="", help="Light of the images: 'max', or '0_r5000' to '6_r5000'.")
@click.option(
    "--positions",
    default="all",
    show_default=True,
    metavar="odd|all|LIST",
    help="Positions of the camera, counted from 1; a LIST as 1,3,5-9.",
)
@click.option(
    "--reference_path",
    type=Path,
    help="Of a NeuS/IDR folder: depth maps, mesh, cloud, or the root of the official data; of "
    "MVSNet's layout: that root.",
)
@click.option("--methods", multiple=True, default=("SfM", "edges"), show_default=True)
@click.option("--peers", multiple=True, help="NAME=PATH of a peer's result; {scan} in it varies.")
@click.option("--baseline", default="", help="Row of the average variation; default: the first.")
@exit_on_error()
def main(
    input_path: Path,
    output_path: Path,
    scans: tuple[int, ...],
    light: str,
    positions: str,
    reference_path: Path | None,
    methods: tuple[str, ...],
    peers: tuple[str, ...],
    baseline: str,
) -> None:
    found = scenes.parse_peers(peers)
    if dtu.is_repackaged(input_path):
        if light or positions != "all":
            raise click.UsageError("a NeuS/IDR folder has no --light and no --positions")
        listed = [scenes.repackaged_scene(input_path, reference_path, found)]
    else:
        listed = scenes.dtu_scenes(
            input_path,
            scans or dtu.scan_numbers(input_path),
            light=light,
            positions=dtu.parse_positions(positions),
            peer_paths=found,
            reference_root=reference_path,
        )
    benchmark.run(listed, output_path, methods, baseline=baseline, progress=click.echo)
    click.echo((output_path / "evaluation.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
