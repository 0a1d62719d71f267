"""Meshes as files: PLY, OBJ and GLB."""

from __future__ import annotations

from pathlib import Path

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.mesh import Mesh

MESH_FORMATS = (".ply", ".obj", ".glb")


def write_mesh(mesh: Mesh, path: Path | str) -> None:
    """Write a mesh with colours as PLY, OBJ or GLB: the whole file or none.

    Raises:
        ColmapEdgesError: when the suffix is another one or the file cannot be written.
    """
    import trimesh

    path = Path(path)
    if path.suffix.lower() not in MESH_FORMATS:
        raise ColmapEdgesError(
            f"cannot write a mesh as {path.name!r}; choose one of: {', '.join(MESH_FORMATS)}"
        )
    exported = trimesh.Trimesh(
        mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False, validate=False
    ).export(file_type=path.suffix.lower()[1:])
    data = exported.encode() if isinstance(exported, str) else exported
    write_whole(path, data, "mesh")
