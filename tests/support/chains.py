"""Chains of hand-made points."""

import numpy as np

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges2d.detection import Chains


def make_chains(*parts):
    """Chains of (points, side): the normal lies on that side of the direction."""
    normals = []
    for points, side in parts:
        tangents = np.gradient(points, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        normals.append(side * np.column_stack([-tangents[:, 1], tangents[:, 0]]))
    return Chains(
        points=np.concatenate([points for points, _ in parts]),
        normals=np.concatenate(normals),
        sides=np.zeros((sum(len(points) for points, _ in parts), 2), np.uint8),
        offsets=offsets_of(np.array([len(points) for points, _ in parts])),
    )
