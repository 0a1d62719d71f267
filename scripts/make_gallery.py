#!/usr/bin/env python3
"""Draw the mesh, the 3D edges and the faces of a run for docs/gallery.md.

Writes NAME_mesh.webp, NAME_edges.webp and, for a run with faces, NAME_faces.webp.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import cv2
import numpy as np

from colmap_edges import Mesh, read_edges
from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation.metrics.raycasting import load_mesh
from colmap_edges.report.contents import Contents
from colmap_edges.report.faces3d import triangulated
from colmap_edges.report.still import WEBP, still_picture

WIDTH_PX = 800


@click.command(help=__doc__)
@click.option("--run_path", type=Path, required=True, help="Output folder of colmap-edges mesh.")
@click.option("--name", required=True, help="Prefix of the pictures' names.")
@click.option("--output_path", type=Path, default=Path("docs/gallery"), show_default=True)
@exit_on_error()
def main(run_path: Path, name: str, output_path: Path) -> None:
    output_path.mkdir(parents=True, exist_ok=True)
    for what, contents in contents_of(run_path).items():
        encoded = np.frombuffer(still_picture(contents), np.uint8)
        picture = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
        size = WIDTH_PX, round(WIDTH_PX * picture.shape[0] / picture.shape[1])
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        path = output_path / f"{name}_{what}.webp"
        cv2.imwrite(str(path), small, WEBP)
        click.echo(path)


def contents_of(run_path: Path) -> dict[str, Contents]:
    """Scenes to draw by name: the mesh alone, edges on it, edges on faces."""
    written = read_edges(run_path)
    read = load_mesh(run_path / "mesh.ply")
    colors = np.asarray(read.visual.vertex_colors)[:, :3].astype(np.uint8)
    mesh = mesh_of(read.vertices, read.faces, colors)
    found = {"mesh": mesh, "edges": mesh}
    if written.faces:
        found["faces"] = mesh_of(*triangulated(written.faces))
    every = Contents(model=written.model, edges=written.edges)
    shown = {what: replace(every, mesh=surface) for what, surface in found.items()}
    shown["mesh"] = replace(shown["mesh"], edges=None)
    return shown


def mesh_of(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> Mesh:
    """A mesh without tracks, for drawing."""
    ids = np.full(len(vertices), -1)
    return Mesh(vertices=vertices, faces=faces, point3D_ids=ids, colors=colors)


if __name__ == "__main__":
    main()
