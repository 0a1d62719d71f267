"""Export of meshes as PLY, OBJ and GLB."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from colmap_edges.core.checks import checked
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.mesh import Mesh

MESH_FORMATS = (".ply", ".obj", ".glb")
PLY_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])
PLY_FACE = np.dtype([("count", "u1"), ("indices", "<i4", 3)])
PLY_HEADER = """ply
format binary_little_endian 1.0
comment mesh by colmap-edges
element vertex {vertices}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property uchar alpha
element face {faces}
property list uchar int vertex_indices
end_header
"""


@checked
def write_mesh(mesh: Mesh, path: Path | str) -> None:
    """Write a mesh with colours as PLY, OBJ or GLB, atomically.

    Raises:
        ColmapEdgesError: if the suffix is unknown or the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_FORMATS:
        raise ColmapEdgesError(
            f"cannot write a mesh as {path.name!r}; choose one of: {', '.join(MESH_FORMATS)}"
        )
    write_whole(path, as_ply(mesh) if suffix == ".ply" else by_trimesh(mesh, suffix), "mesh")


def as_ply(mesh: Mesh) -> bytes:
    """A binary PLY of the mesh; coordinates in float32, as most readers expect."""
    vertices = np.full(len(mesh.vertices), 255, PLY_VERTEX)
    vertices["xyz"], vertices["rgba"][:, :3] = mesh.vertices, mesh.colors
    faces = np.full(len(mesh.faces), 3, PLY_FACE)
    faces["indices"] = mesh.faces
    header = PLY_HEADER.format(vertices=len(vertices), faces=len(faces))
    return header.encode() + vertices.tobytes() + faces.tobytes()


def by_trimesh(mesh: Mesh, suffix: str) -> bytes:
    """The mesh in one of the other formats."""
    import trimesh  # takes a second

    exported = trimesh.Trimesh(
        mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False, validate=False
    ).export(file_type=suffix[1:])
    return exported.encode() if isinstance(exported, str) else exported
