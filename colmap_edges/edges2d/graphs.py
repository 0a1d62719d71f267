"""Storage of the 2D edge graphs of all views: recently used ones in memory, others in a backend."""

from __future__ import annotations

import pickle
import shutil
import tempfile
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from threading import Lock
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.image_graphs import load_graph
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.cache import Cache
from colmap_edges.runtime.memory import return_freed_memory

T = TypeVar("T")

# Size of all graphs from which on freed memory is returned between steps: the system clears what is
# requested again, which takes smaller scenes 2 % of a run.
TRIM_BYTES = 1e8


class Backend(Protocol):
    """Storage for graphs that are not in memory."""

    def write(self, view: int, graph: EdgeGraph) -> None:
        """Store the graph of a view unless it is already stored."""

    def read(self, view: int) -> EdgeGraph:
        """Read the graph of a view."""


class DiskBackend:
    """A temporary folder (in TMPDIR), created at the first write and removed with this object."""

    def __init__(self) -> None:
        """Start without a folder."""
        self.folder: Path | None = None
        self.stored: set[int] = set()

    def path(self, view: int) -> Path:
        """The file of the graph of a view."""
        if self.folder is None:
            self.folder = Path(tempfile.mkdtemp(prefix="colmap-edges-"))
            weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        return self.folder / f"{view}.bin"

    def write(self, view: int, graph: EdgeGraph) -> None:
        """Write the arrays of a graph to one file.

        Raises:
            ColmapEdgesError: if the disk is full.
        """
        if view in self.stored:
            return
        path = self.path(view)
        try:
            with path.open("wb") as file:
                pickle.dump(
                    {entry.name: getattr(graph, entry.name) for entry in fields(graph)}, file
                )
        except OSError as error:
            raise ColmapEdgesError(
                f"cannot keep edge graphs in {path.parent} ({error.strerror or error}); free space "
                "there, set TMPDIR to another folder, or raise max_graph_memory_gb"
            ) from error
        self.stored.add(view)

    def read(self, view: int) -> EdgeGraph:
        """Read the graph of a view."""
        with self.path(view).open("rb") as file:
            return EdgeGraph(**pickle.load(file))


@dataclass(frozen=True)
class CacheBackend:
    """The cache, which already holds all graphs; workers of a cluster read it, too.

    Attributes:
        cache: the cache.
        keys: key of each view's graph.
    """

    cache: Cache
    keys: Mapping[int, str]

    def write(self, view: int, graph: EdgeGraph) -> None:
        """Do nothing: the cache has the graph."""

    def read(self, view: int) -> EdgeGraph:
        """Read a graph written by the task of its image."""
        return load_graph(self.cache, self.keys[view])


class Graphs:
    """The edge graphs of all views, with limited memory; thread-safe."""

    def __init__(self, max_bytes: float = np.inf, backend: Backend | None = None) -> None:
        """Start empty.

        Args:
            max_bytes: maximum size of the graphs in memory.
            backend: storage of the others; a temporary folder by default.
        """
        self.max_bytes, self.backend = max_bytes, backend or DiskBackend()
        self.num_bytes = 0
        self.num_released = 0
        self.are_large = self.are_aside = False
        self.kept: OrderedDict[int, EdgeGraph] = OrderedDict()
        self.lock = Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the backend only."""
        return Graphs, (self.max_bytes, self.backend)

    @classmethod
    def of(cls, graphs: Sequence[EdgeGraph], max_bytes: float = np.inf) -> Graphs:
        """The given graphs, one per view."""
        made = cls(max_bytes)
        for view, graph in enumerate(graphs):
            made.put(view, graph)
        return made

    @property
    def num_kept(self) -> int:
        """Number of graphs that fit in memory."""
        return len(self.kept)

    def num_fitting(self, share: float) -> int:
        """Number of graphs, as large as those in memory, that fit in a share of `max_bytes`."""
        size = self.num_bytes / max(len(self.kept), 1)
        return int(min(share * self.max_bytes / max(size, 1), 1e6))

    def put(self, view: int, graph: EdgeGraph) -> None:
        """Store the graph of a view."""
        with self.lock:
            self._keep(view, graph)

    def load(self, view: int) -> EdgeGraph:
        """The graph of a view, from memory or the backend."""
        with self.lock:
            if view not in self.kept:
                graph = self.backend.read(view)
                if self.are_aside:
                    return graph
                self._keep(view, graph)
            self.kept.move_to_end(view)
            return self.kept[view]

    def put_aside(self) -> None:
        """Drop all graphs from memory, if they are large; until `take_back` `load` keeps none."""
        with self.lock, suppress(ColmapEdgesError):  # a full disk costs memory only
            self.are_aside |= self.are_large and self.num_released == 0
            for view in list(self.kept) if self.are_aside else ():
                self._release(view)
        self.trim()

    def take_back(self) -> None:
        """Keep graphs in memory again from the next `load` on."""
        self.are_aside, self.num_released = False, 0

    def release(self) -> None:
        """Drop all graphs in memory and on disk; none can be loaded afterwards."""
        with self.lock:
            self.kept.clear()
            self.backend = DiskBackend()
        self.trim()
        self.num_bytes, self.are_large = 0, False

    def trim(self) -> None:
        """Return freed memory to the system, if graphs are large enough to be worth the time."""
        if self.are_large:
            return_freed_memory()

    def _keep(self, view: int, graph: EdgeGraph) -> None:
        # The least recently used are dropped; the last stays, whatever its size.
        self.kept[view] = graph
        self.num_bytes += graph_bytes(graph)
        self.are_large |= self.num_bytes > TRIM_BYTES
        while self.num_bytes > self.max_bytes and len(self.kept) > 1:
            self._release(next(iter(self.kept)))

    def _release(self, view: int) -> None:
        graph = self.kept[view]
        self.backend.write(view, graph)
        del self.kept[view]
        self.num_bytes -= graph_bytes(graph)
        self.num_released += 1
        if self.num_released % 64 == 0:
            del graph
            return_freed_memory()


def graph_bytes(graph: EdgeGraph) -> int:
    """Size of a graph's arrays in bytes."""
    return sum(int(getattr(graph, f.name).nbytes) for f in fields(graph))


class LRUCache(Generic[T]):
    """The most recently used values by key, for several threads; pickled without its content."""

    def __init__(self, num_kept: int) -> None:
        """Start empty; keep at most `num_kept` values."""
        self.num_kept = num_kept
        self.things: OrderedDict[Hashable, T] = OrderedDict()
        self.lock = Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the size only."""
        return LRUCache, (self.num_kept,)

    def clear(self) -> None:
        """Drop all values."""
        self.things.clear()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of `key`, made by `make` if it is not kept."""
        with self.lock:
            if key in self.things:
                self.things.move_to_end(key)
                return self.things[key]
        made = make()
        with self.lock:
            made = self.things.setdefault(key, made)
            while len(self.things) > self.num_kept:
                self.things.popitem(last=False)
        return made
