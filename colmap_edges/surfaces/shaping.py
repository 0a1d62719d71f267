"""Well-shaped triangles: needles and caps of a mesh are replaced within the noise of its points."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.surfaces.extension import load_extension
from colmap_edges.surfaces.mesh import Mesh

# Triangles with a smaller angle are replaced.
MIN_ANGLE = np.radians(5)
# Points stay within this number of their standard deviations of the surface.
MAX_SIGMAS = 1.0
# By which faces may turn from those around them, in radians, and in standard deviations of their
# normals.
MAX_TURN, TURN_SIGMAS = np.radians(5), 3.0


def shaped(mesh: Mesh, information: FloatArray, num_threads: int) -> Mesh:
    """A mesh with fewer needles and caps, of which the points are within their noise.

    Args:
        mesh: a mesh.
        information: (V, 6) information of its vertices; see `information_of`.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The mesh; `point3D_ids` of new vertices are -1, their colours 0.
    """
    arrays = load_extension().shape(
        mesh.vertices,
        mesh.faces,
        mesh.creases,
        information,
        min_angle=MIN_ANGLE,
        max_sigmas=MAX_SIGMAS,
        max_turn=MAX_TURN,
        turn_sigmas=TURN_SIGMAS,
        num_threads=num_threads,
    )
    num_left = int(np.count_nonzero(arrays[1] >= 0))
    return mesh.rebuilt(
        *arrays,
        vertices_left_out=len(mesh.vertices) - num_left,
        vertices_inserted=len(arrays[1]) - num_left,
    )
