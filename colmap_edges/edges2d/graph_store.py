"""Edge graphs of many images in bounded memory: those not used lately wait on disk."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from threading import Lock
from typing import Any, Generic, TypeVar

import numpy as np

from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.background import Backdrop
from colmap_edges.runtime.memory import return_freed_memory

T = TypeVar("T")
TRIM_EVERY = 64  # graphs dropped from memory


class Recent(Sequence[T], Generic[T]):
    """A sequence whose items are made when asked for; the last used are kept."""

    def __init__(self, make: Callable[[int], T], count: int, num_kept: int) -> None:
        """Make nothing yet.

        Args:
            make: makes item 0 .. count - 1, the same each time.
            count: number of items.
            num_kept: number of items to keep.
        """
        self.make, self.length, self.num_kept = make, count, num_kept
        self.kept: OrderedDict[int, T] = OrderedDict()

    def __len__(self) -> int:
        """Number of items."""
        return self.length

    def __getitem__(self, index: Any) -> Any:
        """The item at an index from 0 on."""
        if not 0 <= index < self.length:
            raise IndexError(index)
        if index not in self.kept:
            self.kept[index] = self.make(index)
            if len(self.kept) > self.num_kept:
                self.kept.popitem(last=False)
        self.kept.move_to_end(index)
        return self.kept[index]


class GraphStore(Sequence[EdgeGraph]):
    """The edge graphs of all views; at most so many bytes of them are held in memory.

    The others are in a temporary folder (of TMPDIR), which goes with the store. Any thread may
    add graphs and take them.
    """

    def __init__(
        self,
        count: int,
        max_bytes: float,
        elsewhere: Callable[[int], EdgeGraph] | None = None,
    ) -> None:
        """Make a store.

        Args:
            count: number of graphs.
            max_bytes: of graphs that stay in memory.
            elsewhere: reads a graph from where all are kept, if they are; none is written then.
        """
        self.length, self.max_bytes, self.elsewhere = count, max_bytes, elsewhere
        self.keys: list[str] = []  # of the graphs in the cache, once they are there
        self.backdrops: list[Backdrop] = []  # of the images, once all are done
        self.num_bytes = 0
        self.kept: OrderedDict[int, EdgeGraph] = OrderedDict()
        self.written: set[int] = set()
        self.num_dropped = 0
        self.folder: Path | None = None
        self.lock = Lock()

    def __len__(self) -> int:
        """Number of graphs."""
        return self.length

    @property
    def num_kept(self) -> int:
        """Number of graphs in memory; all when they fit."""
        return len(self.kept)

    def add(self, index: int, graph: EdgeGraph) -> None:
        """Put the graph of a view into the store."""
        with self.lock:
            self.keep(index, graph)

    def __getitem__(self, index: Any) -> Any:
        """The graph of a view, from memory or disk."""
        if not 0 <= index < self.length:
            raise IndexError(index)
        with self.lock:
            if index not in self.kept:
                read = self.elsewhere or (lambda place: read_graph(self.path(place)))
                self.keep(index, read(index))
            self.kept.move_to_end(index)
            return self.kept[index]

    def keep(self, index: int, graph: EdgeGraph) -> None:
        """Hold a graph in memory; those longest not used make room, one stays whatever its size."""
        self.kept[index] = graph
        self.num_bytes += graph_bytes(graph)
        while self.num_bytes > self.max_bytes and len(self.kept) > 1:
            old, dropped = self.kept.popitem(last=False)
            self.num_bytes -= graph_bytes(dropped)
            self.num_dropped += 1
            if old not in self.written and self.elsewhere is None:
                write_graph(dropped, self.path(old))
                self.written.add(old)
            del dropped
            if self.num_dropped % TRIM_EVERY == 0:
                return_freed_memory()

    def path(self, index: int) -> Path:
        """Where the graph of a view waits."""
        if self.folder is None:
            self.folder = Path(tempfile.mkdtemp(prefix="colmap-edges-"))
            weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        return self.folder / f"{index}.npy"


def graph_bytes(graph: EdgeGraph) -> int:
    """Bytes of a graph's arrays, with the polyline of each point, which is made when asked for."""
    return sum(int(getattr(graph, f.name).nbytes) for f in fields(graph)) + 8 * len(graph.points)


def write_graph(graph: EdgeGraph, path: Path) -> None:
    """Write the arrays of a graph one after the other.

    Raises:
        ColmapEdgesError: when the disk is full.
    """
    try:
        with path.open("wb") as file:
            for entry in fields(graph):
                np.save(file, getattr(graph, entry.name))
    except OSError as error:
        raise ColmapEdgesError(
            f"cannot keep edge graphs in {path.parent} ({error.strerror}); free space there, set "
            "TMPDIR to another folder, or raise max_graph_memory_gb"
        ) from error


def read_graph(path: Path) -> EdgeGraph:
    """Read what `write_graph` wrote."""
    with path.open("rb") as file:
        return EdgeGraph(**{entry.name: np.load(file) for entry in fields(EdgeGraph)})
