"""The edge graphs of all views in flat arrays, searchable: places on chains, what is near them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    owners_of,
)
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

GRID_CELL_PX = 16.0  # side of a cell of the search grid; only speed depends on it


@dataclass(frozen=True, kw_only=True)
class ChainPositions:
    """Places on chains: a share of the way from a point to the next one of its polyline.

    Attributes:
        segments: (N,) int64 index of the point before the place, over all views.
        fractions: (N,) float64 in [0, 1].
    """

    segments: IntArray
    fractions: FloatArray

    def __len__(self) -> int:
        """Number of places."""
        return len(self.segments)

    def select(self, index: Any) -> ChainPositions:
        """The places at a numpy index."""
        return ChainPositions(segments=self.segments[index], fractions=self.fractions[index])


@dataclass(frozen=True, kw_only=True)
class NearPolylines:
    """Polylines near queried pixels, CSR by query; by ascending polyline within a query.

    Attributes:
        offsets: (Q + 1,) int64.
        polylines: (M,) int32 over all views.
        positions: (M) the nearest place on each.
        distances: (M,) float64 pixels.
    """

    offsets: IntArray
    polylines: Int32Array
    positions: ChainPositions
    distances: FloatArray

    @property
    def queries(self) -> IntArray:
        """(M,) query of each row."""
        return owners_of(self.offsets)


@dataclass(frozen=True, kw_only=True)
class EdgeField:
    """Edge graphs of all views, concatenated; points and polylines count over all views.

    Attributes:
        views: (V) the views.
        kernel: the searchable C++ counterpart.
        points: (N, 2) float64 image pixels, COLMAP's origin.
        ideal: (N, 2) float64 ideal pixels.
        colors: (N, 3) uint8 RGB.
        next_points: (N,) int64 next point of the polyline, -1 at the end of an open one.
        polyline_offsets: (P + 1,) int64.
        polyline_views: (P,) int32 view of each polyline.
        closed: (P,) bool.
    """

    views: tuple[View, ...]
    kernel: Any
    points: FloatArray
    ideal: FloatArray
    colors: ByteArray
    next_points: IntArray
    polyline_offsets: IntArray
    polyline_views: Int32Array
    closed: BoolArray

    @property
    def num_polylines(self) -> int:
        """Number of polylines over all views."""
        return len(self.closed)

    def polylines_at(self, positions: ChainPositions) -> IntArray:
        """(N,) polyline of each place."""
        found: IntArray = np.searchsorted(self.polyline_offsets, positions.segments, "right") - 1
        return found

    def views_at(self, positions: ChainPositions) -> Int32Array:
        """(N,) view of each place."""
        found: Int32Array = self.polyline_views[self.polylines_at(positions)]
        return found

    def on_chains_of_views(self, positions: ChainPositions) -> tuple[Int32Array, FloatArray]:
        """(N,) polylines of places and (N,) positions, both counted in their views' graphs."""
        polylines, segments = self.polylines_at(positions), positions.segments
        first = np.searchsorted(self.polyline_views, self.polyline_views[polylines])
        begin = self.polyline_offsets[first]
        found = segments - begin + positions.fractions
        # At the very end of a segment: the next point, which a closed polyline has at its start.
        ends = found >= segments - begin + 1
        found[ends] = (self.next_points[segments] - begin)[ends]
        return (polylines - first).astype(np.int32), found

    def image_points(self, positions: ChainPositions) -> FloatArray:
        """(N, 2) image pixels of places."""
        return self._interpolate(self.points, positions)

    def ideal_points(self, positions: ChainPositions) -> FloatArray:
        """(N, 2) ideal pixels of places."""
        return self._interpolate(self.ideal, positions)

    def colors_at(self, positions: ChainPositions) -> FloatArray:
        """(N, 3) colours at places."""
        return self._interpolate(self.colors, positions)

    def tangents(self, positions: ChainPositions) -> FloatArray:
        """(N, 2) unit tangents of the chains at places, in ideal pixels."""
        tangents: FloatArray = self.kernel.tangents(positions.segments, positions.fractions)[1]
        return tangents

    def find_near(
        self,
        view_indices: Int32Array,
        pixels: FloatArray,
        radii_px: FloatArray,
        num_threads: int,
    ) -> NearPolylines:
        """Polylines within a radius of (Q, 2) ideal pixels; none near a NaN pixel."""
        offsets, polylines, segments, fractions, distances = self.kernel.find_near(
            np.ascontiguousarray(view_indices, np.int32),
            np.ascontiguousarray(pixels, np.float64),
            np.ascontiguousarray(radii_px, np.float64),
            num_threads,
        )
        return NearPolylines(
            offsets=offsets,
            polylines=polylines,
            positions=ChainPositions(segments=segments, fractions=fractions),
            distances=distances,
        )

    def _interpolate(self, values: FloatArray | ByteArray, positions: ChainPositions) -> FloatArray:
        segments, fractions = positions.segments, positions.fractions[:, None]
        start, end = values[segments], values[self.next_points[segments]]
        result: FloatArray = (1 - fractions) * start + fractions * end
        return result


def build_edge_field(views: Sequence[View], graphs: Sequence[EdgeGraph]) -> EdgeField:
    """Concatenate one edge graph a view.

    Raises:
        ValueError: when the numbers of views and graphs differ, or a point is not finite.
    """
    if len(views) != len(graphs):
        raise ValueError(f"{len(graphs)} edge graphs for {len(views)} views; give one a view")
    lengths = np.concatenate(
        [np.zeros(0, np.int64), *(np.diff(g.polyline_offsets) for g in graphs)]
    )
    offsets = offsets_of(lengths)
    closed = np.concatenate([np.zeros(0, bool), *(g.closed for g in graphs)])
    polyline_views = np.repeat(
        np.arange(len(views), dtype=np.int32), [g.num_polylines for g in graphs]
    )
    ideal = np.concatenate([np.zeros((0, 2)), *(g.ideal for g in graphs)])
    kernel = _kernels.EdgeField(
        *pose_arrays(views), ideal, offsets, polyline_views, closed, GRID_CELL_PX
    )
    return EdgeField(
        views=tuple(views),
        kernel=kernel,
        points=np.concatenate([np.zeros((0, 2)), *(g.points for g in graphs)]),
        ideal=ideal,
        colors=np.concatenate([np.zeros((0, 3), np.uint8), *(g.colors for g in graphs)]),
        next_points=next_points(offsets, closed),
        polyline_offsets=offsets,
        polyline_views=polyline_views,
        closed=closed,
    )


def pose_arrays(views: Sequence[View]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotations (V, 3, 3), translations (V, 3) and focal lengths in pixels (V,) for kernels."""
    return (
        np.array([view.rotation for view in views], np.float64).reshape(-1, 3, 3),
        np.array([view.translation for view in views], np.float64).reshape(-1, 3),
        np.array([view.focal_px for view in views], np.float64),
    )


def next_points(offsets: IntArray, closed: BoolArray) -> IntArray:
    """(N,) index of the next point on each polyline, -1 at the end of an open one."""
    following = np.arange(1, offsets[-1] + 1, dtype=np.int64)
    lengths = np.diff(offsets)
    last = offsets[1:][lengths > 0] - 1
    loops = closed[lengths > 0] & (lengths[lengths > 0] > 1)
    following[last] = np.where(loops, offsets[:-1][lengths > 0], -1)
    return following
