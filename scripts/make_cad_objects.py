#!/usr/bin/env python3
"""Make textureless CAD objects with their views, true surface and true sharp curves.

Needs manifold3d in addition to the extra "evaluation". Each object is a folder of images/, sparse/
(poses without points), surface.ply and curves.npz, for `colmap-edges` and
`evaluate.py edges`. curves.npz holds the curve of each edge of the mesh, and kind and radii of
each curve.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
import trimesh
from cad_objects.shading import CREASE, NUM_VIEWS, SIZE, make_model, render
from cad_objects.solids import OBJECTS, in_unit_box
from cad_objects.true_curves import curves_by_kind


@click.command(help=__doc__)
@click.option("--output_path", type=Path, required=True, help="Folder for the objects' folders.")
@click.option(
    "--names",
    multiple=True,
    type=click.Choice(list(OBJECTS)),
    default=list(OBJECTS),
    help="Objects to make; default: all.",
)
@click.option("--num_views", type=click.IntRange(2), default=NUM_VIEWS, show_default=True)
@click.option("--size", type=click.IntRange(16), default=SIZE, show_default=True, help="Pixels.")
def main(output_path: Path, names: tuple[str, ...], num_views: int, size: int) -> None:
    for name in names:
        mesh = mesh_of(name)
        folder = output_path / name
        (folder / "sparse").mkdir(parents=True, exist_ok=True)
        mesh.export(folder / "surface.ply")
        points, edges = sharp_curves(mesh)
        curves, kinds, radii = curves_by_kind(points, edges)
        np.savez_compressed(
            folder / "curves.npz",
            points=points,
            edges=edges,
            curves=curves,
            kinds=kinds,
            radii=radii,
        )
        model = make_model(num_views, size)
        model.write(folder / "sparse")
        render(mesh, model, folder / "images")
        click.echo(f"{name}: {len(mesh.faces)} triangles, {len(kinds)} sharp curves")


def mesh_of(name: str) -> trimesh.Trimesh:
    """The closed surface of an object."""
    mesh = in_unit_box(OBJECTS[name]()).to_mesh64()
    return trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], mesh.tri_verts)


def sharp_curves(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) points and (E, 2) edges at which faces meet at `CREASE` or more."""
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles >= CREASE]
    used, edges = np.unique(sharp, return_inverse=True)
    return mesh.vertices[used], edges.reshape(sharp.shape).astype(np.int32)


if __name__ == "__main__":
    main()
