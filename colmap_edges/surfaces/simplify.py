"""Mesh simplification: few triangles where the surface is flat, creases kept."""

from __future__ import annotations

from colmap_edges.surfaces.extension import load_extension
from colmap_edges.surfaces.mesh import Mesh


def simplify(mesh: Mesh, max_faces: int, num_threads: int = 1) -> Mesh:
    """Collapse vertices onto neighbours until at most `max_faces` triangles are left.

    The vertices that are left keep their positions, colours and point3D ids. Creases and borders
    are simplified along themselves, no triangle passes through another one, and the topology stays.
    More triangles are left if no vertex can be collapsed under these conditions.

    Args:
        mesh: a mesh without a texture.
        max_faces: number of triangles.
        num_threads: threads to use; the result does not depend on it.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    arrays = load_extension().simplify(
        mesh.vertices, mesh.faces, mesh.creases, max_faces, num_threads
    )
    return mesh.rebuilt(*arrays, faces_before_simplification=len(mesh.faces))
