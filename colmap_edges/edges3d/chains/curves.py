"""Curves on the chains of one reference view: points with inverse depths."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import FloatArray, IntArray, RaggedTable
from colmap_edges.core.polylines import curve_tangents


@dataclass(frozen=True, kw_only=True)
class Curves(RaggedTable):
    """Curves on chains of one reference view.

    Attributes:
        undistorted: (N, 2) float64 points on the reference view's chains, undistorted pixels.
        inverse_depths: (N,) float64 in the reference view.
        indices: (N,) int64 indices of these points in the reference view's graph.
        offsets: (E + 1,) int64 CSR of the points by curve.
        sides: (N,) int8 +1 or -1, the side of the tangent on which the edge is bright.
    """

    undistorted: FloatArray
    inverse_depths: FloatArray
    indices: IntArray
    sides: NDArray[np.int8]

    @property
    def normals(self) -> FloatArray:
        """(N, 2) unit normals of the curves in the reference view's image."""
        tangents = curve_tangents(self.undistorted, self.offsets)
        tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
        return np.column_stack([-tangents[:, 1], tangents[:, 0]])

    @property
    def curve_ids(self) -> IntArray:
        """(N,) curve of each point."""
        return self.owners


def replace_depths(curves: Curves, inverse_depths: FloatArray) -> Curves:
    """The curves with new depths; depths behind the reference camera are not replaced."""
    depths = np.where(inverse_depths > 0, inverse_depths, curves.inverse_depths)
    return replace(curves, inverse_depths=depths)
