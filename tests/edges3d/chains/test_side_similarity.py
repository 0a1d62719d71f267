from dataclasses import replace

import curves as known
import numpy as np
import pytest

from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.chains.depths import learn_side_likelihoods
from colmap_edges.edges3d.chains.side_similarity import (
    BINS,
    bins_of,
    estimate,
    histogram,
    nothing_learned,
)
from colmap_edges.edges3d.chains.tracing_input import make_input
from colmap_edges.edges3d.chains.view_selection import select_views
from colmap_edges.options import ChainDepthOptions, ViewSelectionOptions

rng = np.random.default_rng(3)


def same_edge(count, noise=3.0):
    """Differences of an edge on one body before others: one side alike, half of the others, too."""
    alike = np.abs(rng.normal(0, noise, (count, 2)))
    other = rng.uniform(0, 200, count)
    hidden = rng.random(count) < 0.5
    alike[hidden, rng.integers(0, 2, count)[hidden]] = other[hidden]
    return alike.astype(int)


def by_chance(count):
    return rng.integers(0, 200, (count, 2))


def test_nothing_learned_lets_every_match_be():
    np.testing.assert_array_equal(nothing_learned(), np.ones((256, 256), np.float32))


def test_every_difference_has_its_bin():
    assert BINS[0] == 0
    assert BINS[-1] == 256
    levels = np.arange(256)
    bins = bins_of(levels)
    assert (BINS[bins] <= levels).all()
    assert (levels < BINS[bins + 1]).all()


def test_histogram_by_counting():
    differences = np.array([[0, 0], [0, 0], [100, 4], [4, 100], [255, 255]])
    counts = histogram(differences)
    assert counts.sum() == 5
    assert counts[0, 0] == 2
    assert counts[bins_of(4), bins_of(100)] == 2
    assert counts[-1, -1] == 1
    assert np.triu(counts).sum() == 5  # the smaller difference first


def test_alike_sides_are_likelier_and_unlike_ones_are_not():
    table = estimate(same_edge(5000), by_chance(20000))
    np.testing.assert_array_equal(table, table.T)
    assert table[1, 1] > 20 > table[1, 150] > table[6, 150]
    assert table[30, 30] < 0.3
    assert (table >= 0.1 - 1e-6).all()  # no single view rules an edge out


def test_ratios_weigh_to_one_over_chance():
    """A likelihood ratio by its definition: over what chance makes it is one in the mean."""
    table = estimate(same_edge(5000), by_chance(1000000))
    assert table[tuple(by_chance(1000000).T)].mean() == pytest.approx(1, abs=0.05)


def test_gloss_and_exposure_widen_what_is_alike():
    dull, glossy = (estimate(same_edge(5000, noise), by_chance(20000)) for noise in (2.0, 15.0))
    assert glossy[20, 20] > 3 * dull[20, 20]


def test_few_examples_say_little():
    many, few = (estimate(np.zeros((n, 2), int), by_chance(20000)) for n in (5000, 5))
    assert many[0, 0] > 4 * few[0, 0] > 1


def test_without_examples_half_of_the_differences_of_chance_are_expected():
    table = estimate(np.zeros((0, 2), int), by_chance(20000))
    assert table[5, 5] > 2 > 1 > table[150, 150]
    assert table[50, 50] == pytest.approx(0.1 + 0.9 * 4, rel=0.1)  # four times as dense below 100


def learned_from(noise, num_lines):
    """What is learned from lines of sides of their own, which views see within some noise."""
    views = known.ring(6, arc_deg=60)
    ends = rng.uniform(-0.8, 0.8, (num_lines, 2, 3))
    own = rng.integers(0, 250, (num_lines, 2))
    graphs = []
    for view in views:
        graph = known.graph_of(view, [known.line(*each) for each in ends])
        sides = own[graph.polyline_ids] + rng.normal(0, noise, (len(graph.points), 2))
        graphs.append(replace(graph, sides=np.clip(sides, 0, 255).astype(np.uint8)))
    model = known.model_of(views, rng.uniform(-0.8, 0.8, (300, 3)))
    near = select_views(model, ViewSelectionOptions())
    given = make_input(model, Graphs.of(graphs), near)
    return learn_side_likelihoods(given, near.ranges, ChainDepthOptions(), 0, 1)


def test_what_sides_say_is_learned_from_the_views():
    table = learned_from(noise=2.0, num_lines=100)
    assert table[2, 2] > 5
    assert table[1, 120] < 1
    assert table[100, 100] < 0.5


def test_few_edges_leave_what_is_expected():
    table = learned_from(noise=2.0, num_lines=2)
    assert 1 < table[1, 1] < 20
