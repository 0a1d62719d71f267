"""Straight edges between places of other edges are found from the lines that views show there."""

from __future__ import annotations

import curves as known
import numpy as np
import pytest

from colmap_edges.edges3d.linking.bridges import each_once, with_bridges
from colmap_edges.edges3d.linking.nodes import meet_at_nodes
from colmap_edges.options import PipelineOptions

VIEWS = known.ring(6)
STEP = 0.02  # between edge points, about three pixels
WAY = np.arange(-0.5, 0.5 + STEP / 2, STEP)
OPTIONS = PipelineOptions()


def upright(x, first=-0.5, last=0.5):
    """Points on an upright edge."""
    return np.column_stack([np.full(len(WAY), x), np.interp(WAY, [-0.5, 0.5], [first, last])])


def in_space(points):
    """Points of the plane z = 0."""
    return np.column_stack([points, np.zeros(len(points))])


UPRIGHTS = [in_space(upright(-0.4)), in_space(upright(0.4))]
LINES = [known.line(*points[[0, -1]]) for points in UPRIGHTS]


def rung(height, z=0.0, left=-0.4, right=0.4):
    """A level line between the uprights, or behind them."""
    return known.line((left, height, z), (right, height, z))


def bridged(rungs_by_view, pieces=UPRIGHTS, num_threads=1):
    """The edges with bridges, in views that show the uprights and such rungs each."""
    graphs = [
        known.graph_of(view, [*LINES, *rungs])
        for view, rungs in zip(VIEWS, rungs_by_view, strict=True)
    ]
    given = known.tracing_input(VIEWS, graphs)
    edges = known.observed_edges(pieces, range(6), 0.001)
    return with_bridges(edges, VIEWS, given, OPTIONS, num_threads), given


@pytest.mark.parametrize("num_threads", [1, 2])
def test_lines_between_edges_and_between_their_ends_become_edges(num_threads):
    rungs = [rung(0.1), rung(-0.25), rung(0.5)]
    (edges, count), given = bridged([rungs] * 6, num_threads=num_threads)
    assert (count, edges.num_edges) == (3, 5)
    found = [edges.points[edges.edge_offsets[e] : edges.edge_offsets[e + 1]] for e in (2, 3, 4)]
    heights = sorted(np.round(points[:, 1].mean(), 3) for points in found)
    assert heights == [-0.25, 0.1, 0.5]
    for points in found:
        assert np.abs(points[:, 1] - points[0, 1]).max() < 1e-3
        assert np.abs(points[:, 2]).max() < 1e-3
        assert sorted(points[[0, -1], 0]) == pytest.approx([-0.4, 0.4], abs=1e-3)
    assert edges.observations.counts[edges.edge_offsets[2] :].min() == 6
    assert np.isfinite(
        edges.observations.positions[edges.observations.offsets[edges.edge_offsets[2]] :]
    ).all()
    met = meet_at_nodes(edges, given, OPTIONS, num_threads)
    assert (met.end_nodes[2:] >= 0).all()  # at the uprights, or at their ends


def test_ends_are_extended_to_lines():
    short = [in_space(upright(-0.4, last=0.44)), in_space(upright(0.4, last=0.46))]
    (edges, count), _ = bridged([[rung(0.5)]] * 6, pieces=short)
    assert count == 1
    np.testing.assert_allclose(edges.points[edges.edge_offsets[2] :, 1], 0.5, atol=1e-3)


def test_three_views_are_too_few():
    (_, count), _ = bridged([[rung(0.1)]] * 3 + [[]] * 3)
    assert count == 0


def test_lines_behind_edges_are_not_between_them():
    (_, count), _ = bridged([[rung(0.1, z=-0.4)]] * 6)
    assert count == 0


def test_lines_that_end_before_an_edge_are_no_bridges():
    (_, count), _ = bridged([[rung(0.1, right=0.3)]] * 6)
    assert count == 0


def test_nothing_without_lines_or_edges():
    (edges, count), given = bridged([[]] * 6)
    assert (edges.num_edges, count) == (2, 0)
    none, count = with_bridges(edges[:0], VIEWS, given, OPTIONS, 1)
    assert (none.num_edges, count) == (0, 0)


def test_a_bridge_in_either_direction_is_kept_once():
    ends = np.array([[[0, 0, 0], [1, 0, 0]], [[1, 0.01, 0], [0, 0, 0]], [[0, 0, 0], [1, 0.1, 0]]])
    assert each_once(ends, np.arange(3), np.full(3, 0.05)).tolist() == [0, 2]
