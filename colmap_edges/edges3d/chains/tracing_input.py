"""The input of tracing: views, their edge graphs with search indices, and view selection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, Float32Array, IntArray
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph, keep_points
from colmap_edges.edges2d.edge_index import make_edge_index
from colmap_edges.edges2d.graphs import CacheBackend, Graphs, LRUCache
from colmap_edges.edges2d.image_graphs import save_graph
from colmap_edges.edges3d.chains.side_similarity import nothing_learned
from colmap_edges.edges3d.chains.view_selection import Neighborhood
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.cache import key_of
from colmap_edges.runtime.executors import Workers

T = TypeVar("T")
ByView = Sequence[T] | Mapping[int, T]  # an item per view, of all or of those used by a task

NUM_KEPT = 64  # least number of search indices that a worker keeps, more than a task needs
# On a worker of a cluster, by graph and pose, since tasks on nearby views share indices.
KEPT_BY_WORKER: LRUCache[Any] = LRUCache(NUM_KEPT)


@dataclass(frozen=True, kw_only=True)
class TracingInput:
    """The views with their edge graphs, whole or remaining parts, and the selected views.

    Attributes:
        views: the posed views.
        graphs: their whole edge graphs.
        neighbors: per view the views that it is matched with.
        observing_views: per view the views in which its edges are searched.
        polyline_offsets: per view those of the traced graph, always in memory.
        sides: (256, 256) likelihood ratios of matches by the differences of their sides.
        free: per view the traced points of the whole graph; None for all.
        parts: graphs of those points.
        indexes: search indices of the graphs.
        part_keys: by view the key of that part in the cache, if it was written for a cluster.
        is_sent: whether this was sent to a worker of a cluster.
    """

    views: ByView[View]
    graphs: Graphs
    neighbors: ByView[IntArray]
    observing_views: ByView[IntArray]
    polyline_offsets: ByView[IntArray]
    sides: Float32Array = field(default_factory=nothing_learned)
    free: ByView[BoolArray] | None = None
    parts: LRUCache[EdgeGraph]
    indexes: LRUCache[Any]
    part_keys: dict[int, str] = field(default_factory=dict)
    is_sent: bool = False

    @property
    def num_views(self) -> int:
        """Number of views, or of those sent to a task."""
        return len(self.views)

    def graph(self, view: int) -> EdgeGraph:
        """The traced edge graph of a view: whole, or its remaining part."""
        if self.free is None:
            return self.graphs.load(view)
        free = self.free[view]
        return self.parts.get(view, lambda: keep_points(self.graphs.load(view), free))

    def index(self, view: int) -> _kernels.EdgeIndex:
        """The search index of the traced edge graph of a view."""
        if not self.is_sent:
            return self.indexes.get(view, lambda: self.make_index(view))
        pose = np.column_stack([self.views[view].rotation, self.views[view].translation])
        backend = self.graphs.backend
        assert isinstance(backend, CacheBackend)
        KEPT_BY_WORKER.num_kept = self.indexes.num_kept
        identity = (backend.cache.folder, backend.keys[view], pose.tobytes())
        return KEPT_BY_WORKER.get(identity, lambda: self.make_index(view))

    def make_index(self, view: int) -> _kernels.EdgeIndex:
        """Make the search index of a view's edge graph."""
        return make_edge_index(self.graph(view), self.views[view])

    def part(self, view: int, others: IntArray, workers: Workers) -> TracingInput:
        """The part that a task on a view and others needs: all unless it is sent elsewhere."""
        backend = self.graphs.backend
        if not (workers.remote and isinstance(backend, CacheBackend)):
            return self
        places = [view, *others.tolist()]
        return replace(
            self,
            views=chosen(self.views, places),
            graphs=Graphs(0, CacheBackend(backend.cache, {v: self.key_of(v) for v in places})),
            neighbors=chosen(self.neighbors, [view]),
            observing_views=chosen(self.observing_views, [view]),
            polyline_offsets={},
            free=None,
            parts=LRUCache(1),
            part_keys={},
            indexes=LRUCache(self.num_kept(workers)),
            is_sent=True,
        )

    def num_kept(self, workers: Workers) -> int:
        """Number of search indices that a process which runs tasks keeps."""
        if workers.remote:
            # Machines have several workers.
            return max(self.graphs.num_fitting(0.25), NUM_KEPT)
        return self.indexes.num_kept

    def key_of(self, view: int) -> str:
        """The key in the cache of the traced graph of a view; its part is written there once."""
        backend = self.graphs.backend
        assert isinstance(backend, CacheBackend)
        if self.free is None:
            return backend.keys[view]
        if view not in self.part_keys:
            self.part_keys[view] = key_of("part", backend.keys[view], self.free[view])
            save_graph(backend.cache, self.part_keys[view], self.graph(view))
        return self.part_keys[view]


def chosen(items: ByView[T], views: Sequence[int]) -> dict[int, T]:
    """The items of some views."""
    return {view: items[view] for view in views}


def make_input(model: Model, graphs: Graphs, near: Neighborhood) -> TracingInput:
    """The input of the first round; as many search indices are kept in memory as graphs."""
    graphs.take_back()
    offsets = [graphs.load(view).polyline_offsets for view in range(len(model.views))]
    num_kept = max(graphs.num_kept, 1)
    return TracingInput(
        views=model.views,
        graphs=graphs,
        neighbors=near.neighbors,
        observing_views=near.observing_views,
        polyline_offsets=offsets,
        parts=LRUCache(num_kept),
        indexes=LRUCache(num_kept),
    )


def remaining(whole: TracingInput, free: Sequence[BoolArray]) -> TracingInput:
    """The input restricted to some points of the whole graphs.

    Args:
        whole: the input with whole graphs.
        free: per view (P,) bool, the points that remain.
    """
    num_kept = whole.indexes.num_kept
    rest = replace(
        whole, free=free, parts=LRUCache(num_kept), part_keys={}, indexes=LRUCache(num_kept)
    )
    offsets = [rest.graph(view).polyline_offsets for view in range(len(free))]
    return replace(rest, polyline_offsets=offsets)
