"""Straight pieces of the chains of an edge graph, and which chain points 3D edges observe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

REACH = 4  # chain points on each side of an observation that belong to the observed edge
MIN_LENGTH_PX = 16.0  # minimum length of a piece


class StraightPieces(NamedTuple):
    """Straight pieces of chains.

    Attributes:
        ends: (L, 2, 2) undistorted pixels of both ends.
        lengths: (L,) lengths in pixels.
        observed: (L,) shares of their points that 3D edges observe.
    """

    ends: FloatArray
    lengths: FloatArray
    observed: FloatArray


def straight_pieces(
    graph: EdgeGraph, is_observed: BoolArray, max_distance_px: float
) -> StraightPieces:
    """Split chains where they bend.

    Args:
        graph: the edge graph.
        is_observed: (N,) whether 3D edges observe a point of the graph.
        max_distance_px: maximum distance of the points of a piece from its chord.
    """
    points, offsets = graph.undistorted.astype(np.float64), graph.polyline_offsets
    kept, kept_offsets = _kernels.douglas_peucker(points, offsets, max_distance_px)
    is_last = np.zeros(len(kept), bool)
    is_last[np.asarray(kept_offsets)[1:] - 1] = True
    first = np.flatnonzero(~is_last)
    ends = points[np.column_stack([kept[first], kept[first + 1]])]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    long = np.flatnonzero(lengths >= MIN_LENGTH_PX)
    seen = np.concatenate([[0], np.cumsum(is_observed)])
    start, stop = kept[first[long]], kept[first[long] + 1] + 1
    return StraightPieces(ends[long], lengths[long], (seen[stop] - seen[start]) / (stop - start))


def near_observations(count: int, positions: FloatArray) -> BoolArray:
    """(count,) whether chain points are within `REACH` of observed (n,) positions."""
    near = np.zeros(count + 2 * REACH + 1, np.int64)
    at = np.clip(np.nan_to_num(positions, nan=-1.0), -1, count - 1).astype(np.int64)
    at = at[at >= 0]
    np.add.at(near, at, 1)
    np.add.at(near, at + 2 * REACH + 1, -1)
    return np.asarray(np.cumsum(near)[REACH : REACH + count] > 0)
