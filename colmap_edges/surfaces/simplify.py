"""Mesh simplification by MeshLab's quadric edge collapse."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from colmap_edges.errors import ColmapEdgesError, extra
from colmap_edges.surfaces.mesh import Mesh


def load_meshlab() -> Any:
    """Import pymeshlab.

    Raises:
        ColmapEdgesError: if it is not installed.
    """
    with extra("Meshing.max_faces", "meshlab"):
        import pymeshlab
    return pymeshlab


def simplify(mesh: Mesh, max_faces: int) -> Mesh:
    """Collapse edges by quadric errors until at most `max_faces` triangles are left.

    Borders and topology are preserved, so a manifold stays manifold. Vertices move and so have no
    point3D ids and are on no 3D edge; each gets the colour of the nearest vertex of `mesh`.

    Raises:
        ColmapEdgesError: if pymeshlab is not installed, or MeshLab fails.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    pymeshlab = load_meshlab()
    from scipy.spatial import cKDTree

    # Centred and scaled to size 1, so that MeshLab's single precision suffices.
    center = mesh.vertices.mean(axis=0)
    size = float(np.abs(mesh.vertices - center).max())
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh((mesh.vertices - center) / size, mesh.faces))
    try:
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=max_faces, preserveboundary=True, preservetopology=True, autoclean=False
        )
        meshes.meshing_remove_unreferenced_vertices()
    except pymeshlab.PyMeshLabException as error:
        raise ColmapEdgesError(f"MeshLab cannot simplify to {max_faces} faces: {error}") from error
    current = meshes.current_mesh()
    vertices = current.vertex_matrix() * size + center
    nearest = cKDTree(mesh.vertices).query(vertices)[1]
    return replace(
        mesh,
        vertices=vertices,
        faces=np.ascontiguousarray(current.face_matrix(), np.int32),
        point3D_ids=np.full(len(vertices), -1, np.int64),
        colors=mesh.colors[nearest],
        creases=np.zeros((0, 2), np.int32),
        stats={**mesh.stats, "faces_before_simplification": len(mesh.faces)},
    )
