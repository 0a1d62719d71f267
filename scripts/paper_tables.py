#!/usr/bin/env python3
"""The paper's tables over Strecha's and DTU's scenes together, computed from the images.

Rows are the SfM points alone, the paper's method, the default method ("edges"), and other systems,
such as Line3D++ and LIMAP, if --peers has their results. Finished rows are reused: run this once
for the models (OUT/SCENE/sparse), run the other systems on these, and run this again.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from colmap_edges.errors import ColmapEdgesError, exit_on_error
from colmap_edges.evaluation import benchmark, scenes
from colmap_edges.evaluation.protocols import dtu, strecha


@click.command(help=__doc__)
@click.option(
    "--strecha",
    "strecha_folders",
    type=(Path, Path),
    multiple=True,
    metavar="FOLDER REFERENCE",
    help="A scene of Strecha's; REFERENCE is its true mesh, cloud, or folder of depth maps.",
)
@click.option("--dtu", "dtu_path", type=Path, help="Root of DTU, official or as MVSNet packs it.")
@click.option("--scans", type=int, multiple=True, help="Default: the paper's, where present.")
@click.option("--light", default="", help="Light of the images: 'max', or '0_r5000' to '6_r5000'.")
@click.option(
    "--positions",
    default="all",
    show_default=True,
    metavar="odd|all|LIST",
    help="DTU's positions of the camera, counted from 1; a LIST as 1,3,5-9.",
)
@click.option("--methods", multiple=True, default=("SfM", "paper", "edges"), show_default=True)
@click.option(
    "--peers", multiple=True, help="NAME=PATH of a system's results; {scene} in it varies."
)
@click.option("--baseline", default="", help="Row of the average variation; default: the first.")
@click.option("--output_path", type=Path, required=True, help="Folder for models and tables.")
@exit_on_error()
def main(
    strecha_folders: tuple[tuple[Path, Path], ...],
    dtu_path: Path | None,
    scans: tuple[int, ...],
    light: str,
    positions: str,
    methods: tuple[str, ...],
    peers: tuple[str, ...],
    baseline: str,
    output_path: Path,
) -> None:
    if not strecha_folders and dtu_path is None:
        raise click.UsageError("give --strecha, --dtu or both")
    paths = scenes.parse_peers(peers)
    listed = [_strecha_scene(folder, reference, paths) for folder, reference in strecha_folders]
    if dtu_path is not None:
        listed += scenes.dtu_scenes(
            dtu_path,
            scans or dtu.scan_numbers(dtu_path),
            light=light,
            positions=dtu.parse_positions(positions),
            peer_paths=paths,
        )
    listed = _with_given_peers(listed, paths)
    benchmark.run(listed, output_path, methods, baseline=baseline, progress=click.echo)
    click.echo((output_path / "evaluation.md").read_text(encoding="utf-8"))


def _strecha_scene(folder: Path, reference: Path, peers: dict[str, str]) -> scenes.Scene:
    image_path, camera_path = strecha.find_folders(folder)
    name = folder.resolve().name
    return scenes.strecha_scene(
        image_path, reference, name=name, camera_path=camera_path, peer_paths=peers
    )


def _with_given_peers(listed: list[scenes.Scene], paths: dict[str, str]) -> list[scenes.Scene]:
    """The scenes, with only those peers whose results exist."""
    found = [
        replace(scene, peers={name: path for name, path in scene.peers.items() if path.exists()})
        for scene in listed
    ]
    missing = sorted(set(paths) - {name for scene in found for name in scene.peers})
    if missing:
        raise ColmapEdgesError(f"no scene has a result of {missing[0]} at {paths[missing[0]]}")
    return found


if __name__ == "__main__":
    main()
