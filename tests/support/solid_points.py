"""Points on solids, and meshes of them as trimesh knows them."""

import numpy as np
import trimesh


def fibonacci_sphere(count):
    """`count` evenly spread points on the unit sphere."""
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)]) * np.sqrt(
        1 - z[:, None] ** 2
    ) + np.column_stack([np.zeros((count, 2)), z])


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
