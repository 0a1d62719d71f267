"""Straight pieces of the 2D chains of all views, whose viewing rays may touch a cylinder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

STRAIGHT_PX = 0.7  # maximum distance of a piece's points from its chord
MIN_LENGTH_PX = 16.0  # minimum length of a piece
REACH = 4  # chain points on each side of an observation that belong to the observed edge


@dataclass(frozen=True, kw_only=True)
class Lines:
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

    def chosen(self, rows: IntArray) -> Lines:
        """Some of the lines."""
        return Lines(**{name: array[rows] for name, array in vars(self).items()})


def find_lines(views: Sequence[View], graphs: Graphs, edges: Edges3D) -> Lines:
    """The straight pieces of the chains of all views.

    Args:
        views: all views.
        graphs: their edge graphs.
        edges: fixed 3D edges that observe the graphs.
    """
    observed = edges.observations
    rows_of = rows_by_view(observed.views, len(views))
    parts = [
        lines_of(view, index, graphs.load(index), observed.positions[rows])
        for index, (view, rows) in enumerate(zip(views, rows_of, strict=True))
    ]
    arrays = (np.concatenate(part) for part in zip(*map(astuple, parts), strict=True))
    return Lines(**dict(zip(Lines.__annotations__, arrays, strict=True)))


def lines_of(view: View, index: int, graph: EdgeGraph, positions: FloatArray) -> Lines:
    """The straight pieces of a view's chains; 3D edges observe (n,) `positions` on them."""
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
    seen = np.concatenate([[0], np.cumsum(are_observed(len(points), positions))])
    start, stop = kept[first], kept[first + 1] + 1
    return Lines(
        views=np.full(len(long), index, np.int32),
        centers=np.tile(view.center, (len(long), 1)),
        rays=unit(local @ view.rotation),
        focals=np.full(len(long), view.focal_px),
        lengths=lengths[long],
        fixed=(seen[stop] - seen[start]) / (stop - start),
    )


def are_observed(count: int, positions: FloatArray) -> BoolArray:
    """(count,) whether chain points are within `REACH` of observed (n,) positions."""
    near = np.zeros(count + 2 * REACH + 1, np.int64)
    at = np.clip(np.nan_to_num(positions, nan=-1.0), -1, count - 1).astype(np.int64)
    at = at[at >= 0]
    np.add.at(near, at, 1)
    np.add.at(near, at + 2 * REACH + 1, -1)
    return np.asarray(np.cumsum(near)[REACH : REACH + count] > 0)
