"""Positions on the chains of all views, and their search indices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, Table, offsets_of, owners_of
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.edge_index import at_positions, look_up, make_edge_index
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


@dataclass(frozen=True, kw_only=True)
class Places(Table):
    """Positions on chains of views.

    Attributes:
        views: (N,) int32.
        positions: (N,) float64 fractional indices into the points of the view's graph.
    """

    views: Int32Array
    positions: FloatArray

    def __len__(self) -> int:
        """Number of positions."""
        return len(self.views)


def join_places(parts: Sequence[Places]) -> Places:
    """Concatenate positions."""
    return Places(
        views=np.concatenate([np.zeros(0, np.int32), *(part.views for part in parts)]),
        positions=np.concatenate([np.zeros(0), *(part.positions for part in parts)]),
    )


@dataclass(frozen=True, kw_only=True)
class NearPolylines:
    """Polylines near queried pixels, CSR by query; ascending within a query.

    Attributes:
        offsets: (Q + 1,) int64.
        polylines: (M,) int64 over all views.
        places: (M) nearest position on each polyline.
        distances: (M,) float64 distances to it in pixels.
    """

    offsets: IntArray
    polylines: IntArray
    places: Places
    distances: FloatArray

    @property
    def queries(self) -> IntArray:
        """(M,) query of each row."""
        return owners_of(self.offsets)


@dataclass(frozen=True, kw_only=True)
class IndexedViews:
    """Views with their edge graphs and search indices; polylines are numbered over all views.

    Attributes:
        views: (V) the views.
        graphs: (V) their edge graphs.
        indexes: (V) search indices of the graphs.
    """

    views: tuple[View, ...]
    graphs: Sequence[EdgeGraph]
    indexes: list[_kernels.EdgeIndex]

    @cached_property
    def polyline_offsets(self) -> IntArray:
        """(V + 1,) index of the first polyline of each view; the last entry is their number."""
        return offsets_of(np.array([index.num_polylines for index in self.indexes], np.int64))

    @property
    def num_views(self) -> int:
        """Number of views."""
        return len(self.views)

    def graph(self, view: int) -> EdgeGraph:
        """The edge graph of a view."""
        return self.graphs[view]

    def index(self, view: int) -> _kernels.EdgeIndex:
        """The search index of a view's edge graph."""
        return self.indexes[view]

    def look_up(self, places: Places) -> tuple[Observations, FloatArray]:
        """Observations at (N) positions, one per point, and (N, 3) colours."""
        each = np.arange(len(places) + 1)
        observed = ChainObservations(offsets=each, views=places.views, positions=places.positions)
        return look_up(self, observed, num_threads=1)[0]

    def undistorted_points(self, places: Places) -> FloatArray:
        """(N, 2) undistorted pixels of positions."""
        undistorted = np.empty((len(places), 2))
        for view, rows in enumerate(rows_by_view(places.views, len(self.views))):
            if len(rows):
                graph = self.graphs[view]
                undistorted[rows] = at_positions(graph, places.positions[rows], graph.undistorted)[
                    0
                ]
        return undistorted

    def find_near(
        self, views: Int32Array, pixels: FloatArray, radii_px: FloatArray, num_threads: int
    ) -> NearPolylines:
        """Polylines within a radius of (Q, 2) undistorted pixels in (Q,) views; none for NaN."""
        offsets, polylines, positions, distances = _kernels.near_polylines(
            self.indexes, views, np.ascontiguousarray(pixels), radii_px, num_threads
        )
        of_rows = np.repeat(views, np.diff(offsets))
        return NearPolylines(
            offsets=offsets,
            polylines=self.polyline_offsets[of_rows] + polylines,
            places=Places(views=of_rows, positions=positions),
            distances=distances,
        )


def index_views(views: Sequence[View], graphs: Sequence[EdgeGraph]) -> IndexedViews:
    """Build the search index of every view's edge graph.

    Raises:
        ValueError: if the numbers of views and graphs differ, or a point is not finite.
    """
    if len(views) != len(graphs):
        raise ValueError(f"{len(graphs)} edge graphs for {len(views)} views; give one a view")
    indexes = [make_edge_index(graph, view) for graph, view in zip(graphs, views, strict=True)]
    return IndexedViews(views=tuple(views), graphs=graphs, indexes=indexes)
