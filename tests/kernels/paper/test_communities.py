"""Louvain's communities against those of networkx."""

import networkx
import numpy as np
import pytest

from colmap_edges.kernels import _kernels


def communities(num_nodes, links, weights, resolution=1.0, seed=0):
    links = np.asarray(links, np.int32).reshape(-1, 2)
    columns = (np.ascontiguousarray(links[:, k]) for k in range(2))
    weights = np.asarray(weights, float)
    return _kernels.louvain_communities(num_nodes, *columns, weights, resolution, seed)


def random_graph(seed, num_groups=8, size=25, within=0.4, between=0.02):
    """Links and weights of a graph of planted groups, and the group of each node."""
    rng = np.random.default_rng(seed)
    groups = rng.permutation(np.repeat(np.arange(num_groups), size))
    first, second = np.triu_indices(len(groups), 1)
    same = groups[first] == groups[second]
    linked = rng.random(len(first)) < np.where(same, within, between)
    links = np.column_stack([first, second])[linked]
    return links, rng.uniform(0.1, 1, len(links)), groups


def network_of(num_nodes, links, weights):
    network = networkx.Graph()
    network.add_nodes_from(range(num_nodes))
    network.add_weighted_edges_from(zip(*links.T.tolist(), weights.tolist(), strict=True))
    return network


def sets_of(labels):
    return [set(np.flatnonzero(labels == k).tolist()) for k in range(labels.max() + 1)]


@pytest.mark.parametrize("seed", range(4))
def test_planted_groups_come_out(seed):
    links, weights, groups = random_graph(seed, within=0.8, between=0.01)
    labels = communities(len(groups), links, weights, seed=seed)
    pairs = set(zip(labels.tolist(), groups.tolist(), strict=True))
    assert len(pairs) == groups.max() + 1 == labels.max() + 1
    _, first = np.unique(labels, return_index=True)
    assert (np.diff(first) > 0).all()  # numbered by their first nodes


@pytest.mark.parametrize("resolution", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_modularity_is_that_of_networkx(seed, resolution):
    links, weights, groups = random_graph(seed, within=0.15, between=0.05)
    network = network_of(len(groups), links, weights)
    reference = networkx.community.louvain_communities(network, resolution=resolution, seed=seed)
    found = sets_of(communities(len(groups), links, weights, resolution, seed))
    score = [
        networkx.community.modularity(network, parts, resolution=resolution)
        for parts in (found, reference)
    ]
    assert score[0] > score[1] - 0.02
    assert score[0] > networkx.community.modularity(network, sets_of(groups)) * 0.5


def test_same_seed_same_communities():
    links, weights, groups = random_graph(5, within=0.1, between=0.08)
    one, two = (communities(len(groups), links, weights, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one, two)


def test_nodes_without_links_stay_alone():
    np.testing.assert_array_equal(communities(4, [[1, 3]], [1.0]), [0, 1, 2, 1])
    np.testing.assert_array_equal(communities(3, [], []), [0, 1, 2])
    assert len(communities(0, [], [])) == 0


@pytest.mark.parametrize(
    ("links", "weights", "match"),
    [
        ([[0, 1]], [1.0, 1.0], "differ in number"),
        ([[0, 2]], [1.0], "node index"),
        ([[0, 1]], [0.0], "positive"),
        ([[0, 1]], [np.nan], "positive"),
    ],
)
def test_bad_graphs_are_refused(links, weights, match):
    with pytest.raises(ValueError, match=match):
        communities(2, links, weights)
