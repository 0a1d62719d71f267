"""Chains -> 2D edge graph: joining, smoothing, regular-length filter (paper: 2D Edge-Graphs)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class EdgeGraph:
    """The 2D edge graph of one image: polylines between nodes, dense and sub-pixel.

    Attributes:
        points: (N, 2) float64 dense chain points (about 1 px apart), image pixels, COLMAP's
            origin; those of one polyline are contiguous.
        ideal: (N, 2) float64 the same points in the view's ideal (undistorted) pixels.
        normals: (N, 2) float64 unit vectors across the edge, dark to bright, in ideal pixels.
        polyline_offsets: (P + 1,) int64; polyline p is points[offsets[p]:offsets[p + 1]].
        closed: (P,) bool; the last point of a closed polyline connects to its first.
        end_nodes: (P, 2) int32 node of the first and last point; polylines that share a node
            meet there; a closed polyline has its one node twice.
        smoothed: (S,) int64 indices into `points` that Douglas-Peucker keeps.
        smoothed_offsets: (P + 1,) int64 CSR of `smoothed` by polyline.
    """

    points: NDArray[np.float64]
    ideal: NDArray[np.float64]
    normals: NDArray[np.float64]
    polyline_offsets: NDArray[np.int64]
    closed: NDArray[np.bool_]
    end_nodes: NDArray[np.int32]
    smoothed: NDArray[np.int64]
    smoothed_offsets: NDArray[np.int64]

    @property
    def num_polylines(self) -> int:
        """Number of polylines."""
        return len(self.closed)
