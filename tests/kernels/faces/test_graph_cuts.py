"""Minimum cuts are those of scipy, and alpha expansion ends where no label takes more."""

from itertools import product

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow

from colmap_edges.kernels import _kernels


def random_network(rng, num_nodes, num_edges, largest=20):
    """Terminals, edges without loops, and capacities both ways; some are 0."""
    terminals = rng.integers(-largest, largest + 1, num_nodes)
    edges = rng.integers(0, num_nodes, (num_edges, 2))
    edges = edges[edges[:, 0] != edges[:, 1]].astype(np.int32)
    along, against = rng.integers(0, largest, (2, len(edges)))
    return terminals, edges, along, against


def scipy_flow(terminals, edges, along, against):
    count = len(terminals)
    rows = np.concatenate([edges[:, 0], edges[:, 1], np.full(count, count), np.arange(count)])
    columns = np.concatenate(
        [edges[:, 1], edges[:, 0], np.arange(count), np.full(count, count + 1)]
    )
    values = np.concatenate([along, against, np.maximum(terminals, 0), np.maximum(-terminals, 0)])
    network = csr_matrix((values.astype(np.int32), (rows, columns)), (count + 2, count + 2))
    return maximum_flow(network, count, count + 1).flow_value


@pytest.mark.parametrize("seed", range(30))
def test_cut_is_as_small_as_scipys_flow(seed):
    rng = np.random.default_rng(seed)
    network = random_network(rng, rng.integers(2, 60), rng.integers(1, 250))
    terminals, edges, along, against = network
    flow, is_source = _kernels.minimum_cut(*network)
    assert flow == scipy_flow(*network)
    first, second = is_source[edges[:, 0]] > 0, is_source[edges[:, 1]] > 0
    cut = along[first & ~second].sum() + against[second & ~first].sum()
    cut += np.maximum(terminals, 0)[is_source == 0].sum()
    cut += np.maximum(-terminals, 0)[is_source == 1].sum()
    assert cut == flow


def test_nodes_that_do_not_exist_are_told():
    zeros = np.zeros(1, np.int64)
    with pytest.raises(ValueError, match="does not exist"):
        _kernels.minimum_cut(np.zeros(2, np.int64), np.array([[0, 2]], np.int32), zeros, zeros)
    with pytest.raises(ValueError, match="negative"):
        _kernels.minimum_cut(np.zeros(2, np.int64), np.array([[0, 1]], np.int32), zeros - 1, zeros)


def random_labelling(rng, num_labels, rows=2, columns=4):
    """A small grid with random costs, depths and weights; the last label has no depth."""
    index = np.arange(rows * columns).reshape(rows, columns)
    sides = [np.stack([index[:, :-1], index[:, 1:]], -1), np.stack([index[:-1], index[1:]], -1)]
    edges = np.concatenate([side.reshape(-1, 2) for side in sides]).astype(np.int32)
    costs = rng.random((rows * columns, num_labels))
    costs[rng.random(costs.shape) < 0.1] = np.inf
    costs[:, -1] = rng.random(rows * columns)
    depths = 1 + rng.random(costs.shape)
    depths[:, -1] = np.nan
    return costs, depths, edges, 0.6 * rng.random(len(edges))


def energy(labels, costs, depths, edges, weights, factor):
    total = sum(costs[i, label] for i, label in enumerate(labels))
    for (a, b), weight in zip(edges, weights, strict=True):
        p, q = labels[a], labels[b]
        if p != q:
            crosses = (depths[a, p] - depths[a, q]) * (depths[b, p] - depths[b, q]) <= 0
            total += weight * (factor if crosses else 1)
    return total


@pytest.mark.parametrize("seed", range(10))
def test_two_labels_are_the_best_of_all(seed):
    problem = random_labelling(np.random.default_rng(seed), 2)
    labels, found = _kernels.expand_labels(*problem, 0.35, 10)
    assert found == pytest.approx(energy(labels, *problem, 0.35))
    best = min(energy(each, *problem, 0.35) for each in product(range(2), repeat=len(labels)))
    assert found == pytest.approx(best)


@pytest.mark.parametrize("seed", range(10))
def test_no_label_takes_more_at_the_end(seed):
    costs, depths, edges, weights = random_labelling(np.random.default_rng(seed), 4)
    problem = costs, depths, edges, weights  # factor 1: a metric, for which expansions are exact
    labels, found = _kernels.expand_labels(*problem, 1.0, 20)
    for label in range(4):
        for changed in product((False, True), repeat=len(labels)):
            tried = np.where(changed, label, labels)
            assert energy(tried, *problem, 1.0) >= found - 1e-6


def test_labels_without_surfaces_never_cross():
    costs, weights = np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([1.5])
    edges, none = np.array([[0, 1]], np.int32), np.full((2, 2), np.nan)
    _, apart = _kernels.expand_labels(costs, none, edges, weights, 0.1, 5)
    assert apart == 1
    _, crossing = _kernels.expand_labels(
        costs, np.array([[1.0, 2.0], [2.0, 1.0]]), edges, weights, 0.1, 5
    )
    assert crossing == pytest.approx(0.15)


@pytest.mark.parametrize("seed", range(5))
def test_blocks_cost_what_their_nodes_do(seed):
    rng = np.random.default_rng(seed)
    costs, depths, edges, weights = random_labelling(rng, 3)
    blocks = np.unique(rng.integers(0, 4, len(costs)), return_inverse=True)[1].astype(np.int32)
    num_blocks = int(blocks.max()) + 1
    made = _kernels.contracted(costs, depths, edges, weights, blocks, num_blocks)
    for labels in product(range(3), repeat=num_blocks):
        spread = np.array(labels)[blocks]
        one = energy(labels, *made, 1.0)
        assert one == pytest.approx(energy(spread, costs, depths, edges, weights, 1.0), rel=1e-5)
    pairs = [tuple(pair) for pair in made[2].tolist()]
    assert pairs == sorted(set(pairs))
    for block in range(num_blocks):
        means = depths[blocks == block].mean(axis=0)
        np.testing.assert_allclose(made[1][block], means, rtol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_some_nodes_cost_what_all_do_but_for_a_constant(seed):
    rng = np.random.default_rng(seed)
    costs, depths, edges, weights = random_labelling(rng, 3)
    costs[np.isinf(costs)] = 9
    nodes = np.flatnonzero(rng.random(len(costs)) < 0.5).astype(np.int32)
    labels = rng.integers(0, 3, len(costs)).astype(np.int32)
    made = _kernels.restricted(costs, depths, edges, weights, nodes, labels)
    differences = []
    for free in product(range(3), repeat=len(nodes)):
        labels[nodes] = free
        whole = energy(labels, costs, depths, edges, weights, 1.0)
        differences.append(whole - energy(free, *made, 1.0))
    np.testing.assert_allclose(differences, differences[0], atol=1e-4)
