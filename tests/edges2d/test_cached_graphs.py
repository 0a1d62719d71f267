"""Graphs that a worker takes from the cache: those that were kept there, each once."""

from dataclasses import fields, replace

import curves as known
import numpy as np
import pytest

from colmap_edges.edges2d.cached_graphs import (
    CachedEdgeViews,
    CachedGraphs,
    KeptView,
    Some,
    kept_edge_view,
)
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.image_graphs import KIND, DetectedEdges, arrays_of
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.kernels import _kernels
from colmap_edges.runtime.cache import Cache

VIEWS = known.ring(3)
KEYS = ("aa0", "bb1", "cc2")


@pytest.fixture
def graphs():
    curves = [known.circle((0, 0, 0), 0.8), known.line((-1, -0.5, 0), (1, 0.4, 0.3))]
    return [known.graph_of(view, curves) for view in VIEWS]


@pytest.fixture
def cache(graphs, tmp_path):
    made = Cache(tmp_path / "cache")
    for key, graph in zip(KEYS, graphs, strict=True):
        found = DetectedEdges(
            graph=graph, dropped=np.zeros((0, 2)), num_chains=2, num_chain_pixels=5
        )
        assert made.save(KIND, key, arrays_of(found))
    kept_edge_view.cache_clear()
    return made


def positions_of(edge_view):
    return _kernels.chain_points(edge_view, np.array([0.0, 10.5]))


def test_graphs_come_back_as_they_were(cache, graphs):
    found = CachedGraphs(cache, KEYS)
    assert len(found) == 3
    for one, other in zip(graphs, found, strict=True):
        for entry in fields(EdgeGraph):
            np.testing.assert_array_equal(getattr(one, entry.name), getattr(other, entry.name))


def test_a_graph_that_is_gone_is_told(cache):
    path = cache.path(KIND, KEYS[1])
    path.unlink()
    with pytest.raises(ColmapEdgesError, match="gone or damaged") as caught:
        CachedGraphs(cache, KEYS)[1]
    assert str(path) in str(caught.value)
    with pytest.raises(ColmapEdgesError, match="gone or damaged"):
        CachedEdgeViews(cache, KEYS, VIEWS)[1]


def test_edge_views_are_made_once(cache, graphs):
    found = CachedEdgeViews(cache, KEYS, VIEWS)
    assert len(found) == 3
    first = found[0]
    for place, row in zip(positions_of(first)[0], (0, 10.5), strict=True):
        low = graphs[0].ideal[int(row)]
        expected = low + (row % 1) * (graphs[0].ideal[int(row) + 1] - low)
        np.testing.assert_allclose(place, expected)
    again = CachedEdgeViews(cache, KEYS, tuple(replace(view) for view in VIEWS))
    assert again[0] is first  # another view of the same pose
    assert found[1] is not first
    assert kept_edge_view.cache_info().misses == 2
    cache.path(KIND, KEYS[0]).unlink()
    assert found[0] is first


def test_another_pose_is_another_edge_view(cache):
    moved = replace(VIEWS[0], translation=VIEWS[0].translation + np.array([0, 0, 1e-9]))
    one, other = (KeptView(cache.folder, KEYS[0], view) for view in (VIEWS[0], moved))
    same = KeptView(cache.folder, KEYS[0], replace(VIEWS[0]))
    assert one == same and hash(one) == hash(same)
    assert one != other
    assert one != KeptView(cache.folder, KEYS[1], VIEWS[0])
    assert one != KeptView(cache.folder.parent, KEYS[0], VIEWS[0])
    assert one != "one"
    assert kept_edge_view(one) is not kept_edge_view(other)


def test_some_items_stay_at_their_places():
    made = []

    class Items(list):
        def __getitem__(self, place):
            made.append(place)
            return super().__getitem__(place)

    found = Some(Items("abcd"), np.array([3, 1], np.int32))
    assert made == [3, 1]
    assert len(found) == 4
    assert (found[np.int64(1)], found[3]) == ("b", "d")
    with pytest.raises(KeyError):
        found[0]
    assert len(Some([], [])) == 0
