"""Whether 32-bit coordinates are precise enough for polylines and meshes."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray


def needs_double(points: FloatArray, segments: IntArray | Int32Array) -> bool:
    """Whether rounding to 32 bits would distort segments, as it does far from the origin.

    Args:
        points: (N, 3) coordinates.
        segments: (S, 2) indices of the ends of polylines' segments or of triangles' sides.
    """
    if not len(segments):
        return False
    lengths = np.linalg.norm(points[segments[:, 1]] - points[segments[:, 0]], axis=1)
    moved = np.abs(points.astype(np.float32) - points).max()
    # A hundredth of the length of all but the shortest hundredth.
    return bool(moved > 0.01 * np.quantile(lengths, 0.01))
