"""What a task of tracing is given: graphs that a worker takes from the cache, each index once."""

import pickle
from dataclasses import fields, replace
from types import SimpleNamespace

import curves as known
import numpy as np
import pytest

from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.graphs import CacheBackend, Graphs
from colmap_edges.edges2d.image_graphs import KIND, DetectedEdges, arrays_of
from colmap_edges.edges3d.chains import tracing_input
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.cache import Cache

VIEWS = known.ring(4)
KEYS = ("aa0", "bb1", "cc2", "dd3")
CURVES = [known.circle((0, 0, 0), 0.8), known.line((-1, -0.5, 0), (1, 0.4, 0.3))]
CLUSTER = SimpleNamespace(remote=True)
THREADS = SimpleNamespace(remote=False)


@pytest.fixture
def whole():
    graphs = [known.graph_of(view, CURVES) for view in VIEWS]
    single = ("points", "undistorted", "normals")  # as detected ones are, and in the cache
    return [
        replace(graph, **{name: getattr(graph, name).astype(np.float32) for name in single})
        for graph in graphs
    ]


@pytest.fixture
def backend(whole, tmp_path):
    cache = Cache(tmp_path / "cache")
    for key, graph in zip(KEYS, whole, strict=True):
        found = DetectedEdges(
            graph=graph, dropped=np.zeros((0, 2)), num_chains=2, num_chain_pixels=5
        )
        assert cache.save(KIND, key, arrays_of(found))
    tracing_input.KEPT_BY_WORKER.things.clear()
    return CacheBackend(cache, dict(enumerate(KEYS)))


@pytest.fixture
def given(whole, backend):
    return replace(known.tracing_input(VIEWS, whole), graphs=Graphs(backend=backend))


def same(one: EdgeGraph, other: EdgeGraph) -> bool:
    return all(
        np.array_equal(getattr(one, entry.name), getattr(other, entry.name))
        for entry in fields(EdgeGraph)
    )


def sent(part):
    return pickle.loads(pickle.dumps(part))


def test_threads_are_given_all(given):
    assert given.part(0, np.array([1, 2]), THREADS) is given


def test_a_worker_is_sent_what_its_task_needs(given, whole):
    part = sent(given.part(2, np.array([0, 3]), CLUSTER))
    assert sorted(part.views) == [0, 2, 3]
    assert all(same(part.graph(view), whole[view]) for view in (0, 2, 3))
    assert list(part.neighbors) == list(part.observing_views) == [2]
    with pytest.raises(KeyError):
        part.graph(1)


def test_what_remains_is_the_same_on_a_worker(given, whole):
    free = [np.arange(len(graph.points)) >= 30 for graph in whole]
    rest = tracing_input.remaining(given, free)
    part = sent(rest.part(1, np.array([2]), CLUSTER))
    for view in (1, 2):
        assert len(rest.graph(view).points) == len(whole[view].points) - 30
        assert same(part.graph(view), rest.graph(view))
    assert rest.polyline_offsets[1][-1] == len(rest.graph(1).points)


def test_a_graph_that_is_gone_is_told(given, backend):
    path = backend.cache.path(KIND, KEYS[1])
    path.unlink()
    with pytest.raises(ColmapEdgesError, match="missing or damaged") as caught:
        given.graph(1)
    assert str(path) in str(caught.value)


def test_a_worker_keeps_indexes_for_its_next_tasks(given, backend):
    first = sent(given.part(0, np.array([1]), CLUSTER))
    index = first.index(0)
    again = sent(given.part(1, np.array([0]), CLUSTER))
    backend.cache.path(KIND, KEYS[0]).unlink()
    assert again.index(0) is index


def test_another_pose_is_another_index(given):
    part = sent(given.part(0, np.array([1]), CLUSTER))
    moved = replace(VIEWS[0], translation=VIEWS[0].translation + np.array([0, 0, 1e-9]))
    other = replace(part, views={**part.views, 0: moved})
    assert other.index(0) is not part.index(0)
