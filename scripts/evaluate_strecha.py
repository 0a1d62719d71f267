#!/usr/bin/env python3
"""Compute the paper's tables from images with Strecha's .camera files."""

from __future__ import annotations

from pathlib import Path

import click

from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation import benchmark, scenes


@click.command(help=__doc__)
@click.option("--image_path", type=Path, required=True, help="Images, and K.txt if there is one.")
@click.option("--camera_path", type=Path, help="Folder of NAME.camera; default: the images'.")
@click.option("--reference_path", type=Path, help="True mesh, cloud, or folder of depth maps.")
@click.option("--output_path", type=Path, required=True, help="Folder for model and tables.")
@click.option("--name", default="fountain-P11", show_default=True, help="Name in the tables.")
@click.option("--methods", multiple=True, default=("SfM", "edges"), show_default=True)
@click.option("--peers", multiple=True, help="NAME=PATH of a peer's result.")
@click.option("--baseline", default="", help="Row of the average variation; default: the first.")
@exit_on_error()
def main(
    image_path: Path,
    camera_path: Path | None,
    reference_path: Path | None,
    output_path: Path,
    name: str,
    methods: tuple[str, ...],
    peers: tuple[str, ...],
    baseline: str,
) -> None:
    scene = scenes.strecha_scene(
        image_path,
        reference_path,
        name=name,
        camera_path=camera_path,
        peer_paths=scenes.parse_peers(peers),
    )
    benchmark.run([scene], output_path, methods, baseline=baseline, progress=click.echo)
    click.echo((output_path / "evaluation.md").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
