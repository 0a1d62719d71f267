"""Straight pieces of the 2D chains of all views, whose viewing rays may touch a cylinder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, Table
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

STRAIGHT_PX = 0.7  # maximum distance of a piece's points from its chord
MIN_LENGTH_PX = 16.0  # minimum length of a piece


@dataclass(frozen=True, kw_only=True)
class Lines(Table):
    """Straight pieces of chains.

    Attributes:
        views: (L,) int32 views, ascending.
        centers: (L, 3) their centres.
        rays: (L, 2, 3) unit directions to both ends.
        focals: (L,) focal lengths of the views, pixels.
        lengths: (L,) lengths in pixels.
        fixed: (L,) shares of their points that fixed 3D edges observe.
    """

    views: Int32Array
    centers: FloatArray
    rays: FloatArray
    focals: FloatArray
    lengths: FloatArray
    fixed: FloatArray


def lines_of(view: View, index: int, graph: EdgeGraph, is_fixed: BoolArray) -> Lines:
    """The straight pieces of a view's chains; fixed 3D edges observe (n,) of their points."""
    points, offsets = graph.undistorted.astype(np.float64), graph.polyline_offsets
    kept, kept_offsets = _kernels.douglas_peucker(points, offsets, STRAIGHT_PX)
    is_last = np.zeros(len(kept), bool)
    is_last[np.asarray(kept_offsets)[1:] - 1] = True
    first = np.flatnonzero(~is_last)
    ends = points[np.column_stack([kept[first], kept[first + 1]])]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    long = np.flatnonzero(lengths >= MIN_LENGTH_PX)
    ends, first = ends[long], first[long]
    local = np.concatenate([ends / view.focal_px, np.ones((len(long), 2, 1))], axis=2)
    seen = np.concatenate([[0], np.cumsum(is_fixed)])
    start, stop = kept[first], kept[first + 1] + 1
    return Lines(
        views=np.full(len(long), index, np.int32),
        centers=np.tile(view.center, (len(long), 1)),
        rays=unit(local @ view.rotation),
        focals=np.full(len(long), view.focal_px),
        lengths=lengths[long],
        fixed=(seen[stop] - seen[start]) / (stop - start),
    )
