import numpy as np
import pytest
from curve_scenes import graph_of, line, ring_of_views
from curves import model_of
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse import csr_array

from colmap_edges.edges3d.paper.matching import (
    close_points,
    find_pecs,
    match_polylines,
    similarity_graph,
)
from colmap_edges.edges3d.paper.places import index_views
from colmap_edges.options import MatchingOptions

VIEWS = ring_of_views(3)
POLYLINE_VIEWS = np.array([0, 0, 1, 1, 2, 2], np.int32)


@given(arrays(bool, (6, 8)), arrays(float, 8, elements=st.floats(0.1, 2)))
def test_similarity_is_shared_over_all_close_points(close, weights):
    graph = similarity_graph(csr_array(close.astype(float)), weights, POLYLINE_VIEWS, 0.0)
    found = {tuple(link): s for link, s in zip(graph.links, graph.similarities, strict=True)}
    for a in range(6):
        for b in range(a + 1, 6):
            shared = weights[close[a] & close[b]].sum()
            if POLYLINE_VIEWS[a] == POLYLINE_VIEWS[b] or shared == 0:
                assert (a, b) not in found
            else:
                expected = shared / weights[close[a] | close[b]].sum()
                assert found[a, b] == pytest.approx(expected)
                assert 0 < found[a, b] <= 1


@given(arrays(bool, (6, 8)), st.permutations(range(6)))
def test_similarity_does_not_depend_on_the_order_of_polylines(close, order):
    order = np.array(order)
    weights = np.ones(8)
    views = np.arange(6, dtype=np.int32)
    one = similarity_graph(csr_array(close.astype(float)), weights, views, 0.2)
    two = similarity_graph(csr_array(close[order].astype(float)), weights, views[order], 0.2)
    links = {
        frozenset(link): s for link, s in zip(one.links.tolist(), one.similarities, strict=True)
    }
    same = {
        frozenset(order[link].tolist()): s
        for link, s in zip(two.links, two.similarities, strict=True)
    }
    assert links == pytest.approx(same)


def two_lines():
    """Two lines far apart, SfM points on and beside them, and one far from both."""
    curves = [line((-1, -1, 0), (-1, 1, 0)), line((1, -1, 0), (1, 1, 0))]
    along = np.linspace(-0.8, 0.8, 5)
    points = [(x, y, 0) for x in (-1, 1.01) for y in along] + [(0, 0, 0)]
    model = model_of(VIEWS, points)
    return model, index_views(VIEWS, [graph_of(view, curves) for view in VIEWS])


def test_close_points_and_weights():
    model, chains = two_lines()
    incidence, weights = close_points(model, chains, 5.0, 1)
    expected = np.zeros((6, 11))
    expected[::2, :5] = 1
    expected[1::2, 5:10] = 1
    np.testing.assert_array_equal(incidence.toarray(), expected)
    np.testing.assert_allclose(weights, [1] * 10 + [0])  # one polyline in each of three views


def test_weight_is_the_inverse_mean_number_of_close_polylines():
    curves = [line((-1, -1, 0), (-1, 1, 0)), line((-1.005, -1, 0), (-1.005, 1, 0))]
    model = model_of(VIEWS, [(-1, 0, 0)])
    graphs = [graph_of(VIEWS[0], curves)] + [graph_of(v, curves[:1]) for v in VIEWS[1:]]
    _, weights = close_points(model, index_views(VIEWS, graphs), 5.0, 1)
    np.testing.assert_allclose(weights, [3 / 4])


def test_pecs_are_the_two_lines():
    model, chains = two_lines()
    labels = match_polylines(model, chains, MatchingOptions(), random_seed=0, num_threads=1)
    np.testing.assert_array_equal(labels, [0, 1, 0, 1, 0, 1])


def test_polylines_without_points_are_in_no_pec():
    _, chains = two_lines()
    model = model_of(VIEWS, [(0, 0, 0)])
    labels = match_polylines(model, chains, MatchingOptions(), random_seed=0, num_threads=1)
    assert (labels == -1).all()


def test_communities_keep_dense_groups_apart():
    close = np.zeros((6, 12))
    close[0:3, 0:5] = 1
    close[3:6, 5:10] = 1
    close[2, 10] = close[3, 10] = 1  # a weak link between the groups
    views = np.arange(6, dtype=np.int32)
    graph = similarity_graph(csr_array(close), np.ones(12), views, 0.0)
    assert [2, 3] in graph.links.tolist()
    np.testing.assert_array_equal(find_pecs(graph, 1.0, 0), [0, 0, 0, 1, 1, 1])
    assert find_pecs(graph, 1.0, 0).tolist() == find_pecs(graph, 1.0, 0).tolist()


def test_graphs_and_views_of_different_number_are_refused():
    with pytest.raises(ValueError, match="1 edge graphs for 3 views"):
        index_views(VIEWS, [graph_of(VIEWS[0], [])])
