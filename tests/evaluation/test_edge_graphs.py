"""Duplicates, parallel twins and corners of 3D edges, on hand-made curves."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.evaluation.metrics import edge_graphs
from colmap_edges.evaluation.readers.curves import Curves


def polyline(*points, step=0.1):
    """Points at most `step` apart from each of the given points to the next."""
    parts = [np.array(points[:1], float)]
    for start, end in pairwise(points):
        count = int(np.ceil(np.linalg.norm(np.subtract(end, start)) / step))
        parts.append(start + np.arange(1, count + 1)[:, None] / count * np.subtract(end, start))
    return np.concatenate(parts)


def curves_of(*polylines):
    counts = [len(points) for points in polylines]
    first = np.cumsum([0, *counts[:-1]])
    segments = [
        f + np.column_stack([np.arange(n - 1), np.arange(1, n)])
        for f, n in zip(first, counts, strict=True)
    ]
    return Curves(points=np.concatenate(polylines), segments=np.concatenate(segments))


def edges_of(*polylines, nodes):
    lengths = np.array([len(points) for points in polylines])
    made = Edges3D.of_polylines(np.concatenate(polylines), lengths)
    return replace(made, end_nodes=np.array(nodes, np.int32))


LINE = polyline((0, 0, 0), (1, 0, 0))
SQUARE = polyline((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 0))


def moved(points, up):
    return points + np.array([0, up, 0])


def test_a_duplicate_edge_is_found_twice():
    twice = curves_of(LINE, moved(LINE, 0.001), moved(LINE, 5))
    true = curves_of(LINE, moved(LINE, 3))
    (row,) = edge_graphs.times_found(twice, true, [0.01])
    assert row["found_length"] == pytest.approx(1)
    assert row["result_length"] == pytest.approx(2)
    assert row["times"] == pytest.approx(2)


def test_samples_without_segments_have_a_length_even_where_they_coincide():
    samples = polyline((0, 0, 0), (1, 0, 0), step=0.002)
    true = Curves(points=np.concatenate([samples, samples]), segments=np.zeros((0, 2), np.int64))
    (row,) = edge_graphs.times_found(curves_of(LINE), true, [0.01])
    assert row["times"] == pytest.approx(1, rel=0.01)


def test_twins_are_parallel_and_near_but_not_consecutive():
    beside = polyline((0.5, 0.02, 0), (1.5, 0.02, 0))
    across = polyline((0.2, -0.5, 0), (0.2, 0.5, 0))
    onward = polyline((-1, 0, 0), (0, 0, 0))
    found = curves_of(LINE, beside, across, onward)
    sizes = np.full(len(found.points), 0.01)
    shares = edge_graphs.twin_shares(found, sizes)
    assert [share["limit_px"] for share in shares] == [0.5, 3.0, 6.0]
    assert shares[0]["share"] == 0
    assert shares[1]["share"] == pytest.approx(1 / 4, abs=0.02)
    assert shares[2]["share"] == shares[1]["share"]


def test_an_edge_parallel_to_itself_is_its_own_twin():
    there_and_back = polyline((0, 0, 0), (1, 0, 0), (1, 0.02, 0), (0, 0.02, 0))
    found = curves_of(there_and_back)
    (share,) = edge_graphs.twin_shares(found, np.full(len(found.points), 0.01), [3.0])
    assert share["share"] == pytest.approx(1, abs=0.15)
    (share,) = edge_graphs.twin_shares(found, np.full(len(found.points), 0.01), [1.0])
    assert share["share"] == 0


def test_true_corners_are_sharp_bends_and_junctions():
    angles = np.radians(np.arange(0, 361, 4))
    circle = np.column_stack([5 + np.cos(angles), np.sin(angles), 0 * angles])
    branch = polyline((0.5, 1, 0), (0.5, 2, 0))
    corners = edge_graphs.true_corners(curves_of(SQUARE, circle, branch))
    expected = [(0, 0, 0), (0, 1, 0), (0.5, 1, 0), (1, 0, 0), (1, 1, 0)]
    np.testing.assert_allclose(corners[np.lexsort(corners.T[::-1])], expected, atol=1e-9)


def test_found_corners_are_nodes_at_which_edges_turn():
    up, on = polyline((1, 0, 0), (1, 1, 0)), polyline((1, 1, 0), (1, 2, 0))
    found = edges_of(LINE, up, on, nodes=[(-1, 0), (0, 1), (1, -1)])
    np.testing.assert_allclose(edge_graphs.found_corners(found), [(1, 0, 0)], atol=1e-12)


def test_of_two_corners_found_for_one_only_one_counts():
    true = np.array([(0.0, 0, 0), (1, 0, 0)])
    found = np.array([(0.001, 0, 0), (0.002, 0, 0), (5, 0, 0)])
    (row,) = edge_graphs.compare_corners(found, true, [0.01])
    assert row["precision"] == pytest.approx(1 / 3)
    assert row["recall"] == 0.5


def test_scores_without_corners_are_zero():
    none, one = np.zeros((0, 3)), np.zeros((1, 3))
    for found, true in ((none, one), (one, none), (none, none)):
        (row,) = edge_graphs.compare_corners(found, true, [0.01])
        assert (row["precision"], row["recall"], row["f_score"]) == (0, 0, 0)
