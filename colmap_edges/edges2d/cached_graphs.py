"""The edge graphs that a task on a cluster's worker needs: it reads them from the cache itself.

So no graph passes the scheduler. A worker keeps those that it used last, since tasks on views that
are near each other need the same ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.edge_index import make_edge_view
from colmap_edges.edges2d.image_graphs import load_graph
from colmap_edges.runtime.cache import Cache

T = TypeVar("T")
NUM_KEPT = 64  # graphs in the kernels' form that a worker keeps: more than a view is compared with


class Some(Sequence[T], Generic[T]):
    """Some items of a sequence, at their places."""

    def __init__(self, items: Sequence[T], places: Iterable[int]) -> None:
        """Take the items at `places`."""
        self.length = len(items)
        self.items = {int(place): items[int(place)] for place in places}

    def __len__(self) -> int:
        """Number of places, also of those whose items were not taken."""
        return self.length

    def __getitem__(self, place: Any) -> Any:
        """The item at a place."""
        return self.items[int(place)]


@dataclass(frozen=True)
class CachedGraphs(Sequence[EdgeGraph]):
    """Edge graphs in the cache, by the place of the view."""

    cache: Cache
    keys: Sequence[str]

    def __len__(self) -> int:
        """Number of views."""
        return len(self.keys)

    def __getitem__(self, view: Any) -> Any:
        """The edge graph of a view."""
        return load_graph(self.cache, self.keys[view])


@dataclass(frozen=True)
class CachedEdgeViews(Sequence[Any]):
    """The same in the kernels' form."""

    cache: Cache
    keys: Sequence[str]
    views: Sequence[View]

    def __len__(self) -> int:
        """Number of views."""
        return len(self.keys)

    def __getitem__(self, view: Any) -> Any:
        """The kernels' form of a view's edge graph."""
        return kept_edge_view(KeptView(self.cache.folder, self.keys[view], self.views[view]))


@dataclass(frozen=True)
class KeptView:
    """What tells edge views apart: where the graph is, and the pose."""

    folder: Path
    key: str
    view: View

    def identity(self) -> tuple[Any, ...]:
        """All that the edge view depends on, the camera by the graph's key."""
        pose = np.column_stack([self.view.rotation, self.view.translation])
        return self.folder, self.key, pose.tobytes()

    def __hash__(self) -> int:
        """Hash of the identity."""
        return hash(self.identity())

    def __eq__(self, other: object) -> bool:
        """Whether both stand for the same edge view."""
        return isinstance(other, KeptView) and self.identity() == other.identity()


@lru_cache(NUM_KEPT)
def kept_edge_view(wanted: KeptView) -> Any:
    """The kernels' form of an edge graph in the cache."""
    return make_edge_view(load_graph(Cache(wanted.folder), wanted.key), wanted.view)
