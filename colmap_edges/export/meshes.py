"""Export of meshes as PLY, OBJ and GLB."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from colmap_edges.core.arrays import Int32Array
from colmap_edges.core.checks import checked
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.edges import formatted
from colmap_edges.export.glb import TRIANGLES, as_glb
from colmap_edges.export.ply import mesh_as_ply
from colmap_edges.export.precision import needs_double
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.mesh import Mesh

MESH_FORMATS = (".ply", ".obj", ".glb")


@checked
def write_mesh(mesh: Mesh, path: Path | str, *, overwrite: bool = True) -> bool:
    """Write a mesh with colours as PLY, OBJ or GLB, complete or not at all.

    Returns:
        Whether 32-bit coordinates would distort the mesh, because it lies far from the origin. Then
            a PLY has 64-bit coordinates and a GLB an offset; an OBJ is precise in any case.

    Raises:
        ColmapEdgesError: if the suffix is unknown, the file cannot be written, or exists and
            `overwrite` is false.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_FORMATS:
        raise ColmapEdgesError(
            f"cannot write a mesh as {path.name!r}; choose one of: {', '.join(MESH_FORMATS)}"
        )
    far = needs_double(mesh.vertices, sides_of(mesh))
    if suffix == ".ply":
        data = mesh_as_ply(mesh, "f8" if far else "f4")
    elif suffix == ".obj":
        data = as_obj(mesh)
    else:
        data = as_glb("mesh", mesh.vertices, mesh.colors, mesh.faces, TRIANGLES, far=far)
    write_whole(path, data, "mesh", overwrite=overwrite)
    return far


def sides_of(mesh: Mesh) -> Int32Array:
    """(3 F, 2) the sides of all triangles, by their vertices."""
    return mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def as_obj(mesh: Mesh) -> bytes:
    """An OBJ of the mesh, with colours from 0 to 1 after the coordinates."""
    rows = np.column_stack([mesh.vertices, mesh.colors / 255])
    text = formatted("v %.15g %.15g %.15g %.4g %.4g %.4g\n", rows)
    faces = formatted("f %d %d %d\n", mesh.faces + 1)
    return f"# mesh by colmap-edges\n{text}{faces}".encode("ascii")
