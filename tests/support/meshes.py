"""Meshes of given vertices and faces, each vertex with a 3D point of its own."""

import numpy as np

from colmap_edges.surfaces.mesh import Mesh


def make_mesh(vertices, faces, creases=()):
    count = len(vertices)
    return Mesh(
        vertices=np.asarray(vertices, np.float64),
        faces=np.ascontiguousarray(faces, np.int32),
        point3D_ids=np.arange(count, dtype=np.int64),
        colors=np.full((count, 3), 7, np.uint8),
        creases=np.array(creases, np.int32).reshape(-1, 2),
    )
