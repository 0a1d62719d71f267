"""Edge graphs in bounded memory: graphs read back from disk are unchanged."""

from __future__ import annotations

import pickle
from pathlib import Path

import curves as known
import numpy as np
import pytest

from colmap_edges.core.arrays import flattened
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.graphs import DiskBackend, Graphs, LRUCache, graph_bytes
from colmap_edges.edges3d.chains.tracing import trace_edges
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.executors import in_threads

VIEWS = known.ring(7)
CURVES = [known.circle((0, 0, 0), 0.8), known.line((-1, -0.5, 0), (1, 0.4, 0.3))]


def graphs_of_views() -> list[EdgeGraph]:
    return [known.graph_of(view, CURVES) for view in VIEWS]


def same(a: EdgeGraph, b: EdgeGraph) -> bool:
    return all(
        np.array_equal(value, vars(b)[name]) and value.dtype == vars(b)[name].dtype
        for name, value in vars(a).items()
        if name != "polyline_ids"
    )


def test_graphs_come_back_and_few_stay():
    graphs = graphs_of_views()
    size = max(graph_bytes(graph) for graph in graphs)
    store = Graphs.of(graphs, 2.5 * size)
    for index in (0, 6, 3, 3, 1, 0):
        assert same(graphs[index], store.load(index))
        assert store.num_kept <= 3
        assert sum(graph_bytes(g) for g in store.kept.values()) == store.num_bytes <= 2.5 * size
    assert all(same(graph, store.load(index)) for index, graph in enumerate(graphs))
    folder = store.backend.folder
    assert len(list(folder.iterdir())) == len(graphs)
    del store
    assert not folder.exists()


def test_graphs_that_fit_are_not_written():
    store = Graphs.of(graphs_of_views(), 1e9)
    assert store.num_kept == len(VIEWS)
    assert store.backend.folder is None
    assert store.load(2) is store.load(2)


def test_large_graphs_put_aside_come_back_and_none_stays(monkeypatch):
    monkeypatch.setattr("colmap_edges.edges2d.graphs.TRIM_BYTES", 1.0)
    graphs = graphs_of_views()
    store = Graphs.of(graphs)
    store.put_aside()
    assert all(same(graph, store.load(index)) for index, graph in enumerate(graphs))
    assert store.num_kept == 0
    store.take_back()
    assert store.load(2) is store.load(2)
    store.put_aside()
    assert store.num_kept == 0


def test_graphs_that_cannot_be_written_stay_in_memory(monkeypatch, tmp_path):
    monkeypatch.setattr("colmap_edges.edges2d.graphs.TRIM_BYTES", 1.0)
    monkeypatch.setattr(DiskBackend, "path", lambda *_: tmp_path / "missing" / "0.bin")
    store = Graphs.of(graphs_of_views())
    store.put_aside()
    assert store.num_kept == len(VIEWS)
    assert store.load(2) is store.load(2)


def test_small_graphs_are_not_put_aside():
    store = Graphs.of(graphs_of_views())
    store.put_aside()
    assert store.num_kept == len(VIEWS)
    assert store.backend.folder is None


def test_one_graph_larger_than_the_memory_is_held():
    store = Graphs.of(graphs_of_views(), 1.0)
    assert store.num_kept == 1
    assert same(store.load(4), graphs_of_views()[4])


def test_edges_do_not_depend_on_the_memory_limit():
    graphs = graphs_of_views()
    model, options = known.model_of(VIEWS), PipelineOptions(refine_poses=False, num_threads=1)
    expected, _ = trace_edges(model, Graphs.of(graphs), options)
    found, _ = trace_edges(model, Graphs.of(graphs, 1.0), options)
    assert expected.edges.num_edges > 0
    arrays = flattened(found)
    for name, value in flattened(expected).items():
        np.testing.assert_array_equal(value, arrays[name])


def test_released_graphs_are_removed_from_memory_and_disk():
    store = Graphs.of(graphs_of_views(), 1.0)
    folder = store.backend.folder
    assert len(list(folder.iterdir())) == len(VIEWS) - 1
    store.release()
    assert (store.num_kept, store.num_bytes) == (0, 0)
    assert not folder.exists()


def test_kept_graphs_are_not_recomputed():
    made = []

    def make(key: int) -> int:
        made.append(key)
        return 10 * key

    kept = LRUCache(2)
    found = [kept.get(key, lambda key=key: make(key)) for key in (0, 1, 0, 2, 0, 1)]
    assert found == [0, 10, 0, 20, 0, 10]
    assert made == [0, 1, 2, 1]
    sent = pickle.loads(pickle.dumps(kept))
    assert (sent.num_kept, len(sent.things)) == (2, 0)


def test_threads_share_the_values_that_are_kept():
    kept = LRUCache(3)
    keys = np.random.default_rng(0).integers(0, 8, 4000).tolist()
    found = in_threads(lambda key: kept.get(key, lambda: [key]), keys, 8)
    assert found == [[key] for key in keys]
    assert len(kept.things) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_no_space_is_said(monkeypatch):
    monkeypatch.setattr(DiskBackend, "path", lambda *_: Path("/dev/full"))
    with pytest.raises(ColmapEdgesError, match=r"No space left.*TMPDIR"):
        Graphs.of(graphs_of_views(), 1.0)
