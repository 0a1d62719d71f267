import itertools

import numpy as np
import pytest
from chains import build, make_chains, no_chains, straight, topology

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges2d.topology import (
    Topology,
    component_labels,
    regular_lengths,
)
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


def test_t_junction_names_the_polyline_that_passes_through():
    bar = straight((50, 100), (150, 100))
    stem = straight((100, 101), (100, 160))
    other = straight((300, 300), (360, 300))
    graph = build(make_chains((other, 1), (stem, 1), (bar, 1)))
    start_of_stem = np.flatnonzero(graph.points[:, 1] == 101)[0]
    polyline = graph.polyline_ids[start_of_stem]
    end = int(start_of_stem != graph.polyline_offsets[polyline])
    found = topology(graph)
    through = found.node_polylines[found.end_nodes[polyline, end]]
    assert through == graph.polyline_ids[np.flatnonzero((graph.points == (100, 100)).all(1))[0]]
    assert np.sum(found.node_polylines >= 0) == 1
    labels = component_labels(found)
    assert labels[polyline] == labels[through]
    assert len(set(labels.tolist())) == 2


def touched_by_labels(points, offsets, width, height):
    """Chains that ends touch, by an image in which every inner point writes its chain."""
    labels = np.full((height + 2, width + 2), -1)
    for chain, (first, last) in enumerate(itertools.pairwise(offsets)):
        for x, y in np.floor(points[first + 1 : last - 1]).astype(int) + 1:
            labels[y, x] = chain
    touched = []
    for chain, (first, last) in enumerate(itertools.pairwise(offsets)):
        for x, y in np.floor(points[[first, last - 1]]).astype(int) + 1:
            around = labels[y - 1 : y + 2, x - 1 : x + 2]
            touched.append(around[around != chain].max(initial=-1))
    return touched


@pytest.mark.parametrize("seed", range(10))
def test_kernel_finds_the_chains_that_ends_touch(seed):
    random = np.random.default_rng(seed)
    lengths = random.integers(1, 12, 40)
    points = random.uniform(0, (30, 20), (lengths.sum(), 2))
    offsets = offsets_of(lengths)
    touched = _kernels.touched_chains(points, offsets, 30, 20)
    assert touched.tolist() == touched_by_labels(points, offsets, 30, 20)
    assert 0 < np.mean(touched >= 0) < 1


def test_ends_outside_the_image_join_nearby_chains():
    points = np.array([[5, -0.4], [5, 4], [9, 9], [2, 7], [5, 0.2], [8, 7], [99.0, -50]])
    touched = _kernels.touched_chains(points, np.array([0, 3, 6, 7]), 30, 20)
    assert touched.tolist() == [1, -1, -1, -1, -1, -1]
    assert _kernels.touched_chains(points[:0], np.array([0, 0]), 30, 20).tolist() == [-1, -1]
    with pytest.raises(ValueError, match="empty"):
        _kernels.touched_chains(points, np.array([0, 7]), 30, 0)


def test_meeting_ends_share_a_node():
    corner = np.array([200.0, 200.0])
    arms = [straight(corner + d, corner + 40 * np.array(d)) for d in ((1, 0), (-0.5, 0.8), (0, -1))]
    chains = make_chains((arms[0], 1), (arms[1], 1), (arms[2], 1))
    graph = build(chains)
    near = np.linalg.norm(
        graph.points[np.r_[graph.polyline_offsets[:-1], graph.polyline_offsets[1:] - 1]] - corner,
        axis=1,
    )
    ends = topology(graph).end_nodes
    nodes = np.concatenate([ends[:, 0], ends[:, 1]])
    assert len(set(nodes[near < 2].tolist())) == 1
    assert len(set(nodes[near > 2].tolist())) == np.sum(near > 2)


def bare_topology(*polylines):
    """Points of polylines, all of which smoothing keeps, and their topology."""
    points = np.concatenate([np.array(p, float) for p in polylines])
    nodes = np.arange(2 * len(polylines), dtype=np.int32)
    return points, Topology(
        end_nodes=nodes.reshape(-1, 2),
        node_polylines=np.full(len(nodes), -1, np.int32),
        smoothed=np.arange(len(points)),
        smoothed_offsets=offsets_of(np.array([len(p) for p in polylines], np.int64)),
    )


def turning(lengths, turns_deg):
    """Vertices of a polyline by its segments' lengths and the turns between them."""
    headings = np.radians(np.concatenate([[0], np.cumsum(turns_deg)]))
    steps = np.array(lengths)[:, None] * np.column_stack([np.cos(headings), np.sin(headings)])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def test_regular_lengths_of_zigzags():
    points, found = bare_topology(
        turning([10, 5, 7, 3], [10, 90, -19]),  # 10 + 5 | 7 + 3
        turning([4, 4, 4], [21, -21]),  # every turn breaks
        turning([4, 4, 4, 9], [15, 15, -160]),  # 4 + 4 + 4 | 9, each turn by itself
        [[1, 1]],  # no segment
        turning([6], []),
    )
    np.testing.assert_allclose(regular_lengths(points, found, 20), [15, 4, 12, 0, 6])
    np.testing.assert_allclose(regular_lengths(points, found, 180), [25, 12, 21, 0, 6])


def test_regular_length_of_no_polylines_is_none():
    graph = build(no_chains(), filter_regular_length=True)
    assert graph.num_polylines == 0
    assert graph.points.shape == graph.undistorted.shape == (0, 2)
    found = topology(graph)
    assert regular_lengths(graph.points, found, 20).shape == (0,)
