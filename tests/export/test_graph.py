"""3D edges as a networkx graph."""

from __future__ import annotations

import networkx as nx
import numpy as np

from colmap_edges import Edges3D, to_networkx
from colmap_edges.core.edges3d import Nodes
from colmap_edges.core.observations import Observations


def without_tracks(count):
    return Observations.of_pixels(
        offsets=np.zeros(count + 1, np.int64),
        views=np.zeros(0, np.int32),
        pixels=np.zeros((0, 2)),
    )


def test_corners_ends_loops_and_junctions():
    # Two edges from a corner at the origin, the second ends on the side of the third, and a loop.
    pieces = [
        [[0, 0, 0], [1, 0, 0], [3, 0, 0]],
        [[0, 0, 0], [0, 2, 0]],
        [[-1, 2, 0], [0, 2, 0], [1, 2, 0]],
        [[5, 0, 0], [6, 0, 0], [6, 1, 0], [5, 1, 0]],
    ]
    points = np.concatenate(pieces).astype(float)
    edges = Edges3D(
        points=points,
        edge_offsets=np.array([0, 3, 5, 8, 12]),
        closed=np.array([False, False, False, True]),
        observations=without_tracks(12),
        sigmas=np.full(12, 0.1),
        end_nodes=np.array([[0, -1], [0, 1], [-1, -1], [-1, -1]], np.int32),
        colors=np.zeros((12, 3), np.uint8),
        nodes=Nodes(
            points=np.array([[0.0, 0, 0], [0, 2, 0]]),
            sigmas=np.array([0.01, 0.02]),
            observations=without_tracks(2),
            colors=np.zeros((2, 3), np.uint8),
            through_points=np.array([-1, 6]),
        ),
    )
    graph = to_networkx(edges)
    assert set(graph.edges(keys=True)) == {
        (0, (0, 1), 0),
        (0, 1, 1),
        ((2, 0), (2, 1), 2),
        ((3, 0), (3, 0), 3),
    }
    assert [graph.edges[e]["length"] for e in sorted(graph.edges, key=lambda e: e[2])] == [
        3,
        2,
        2,
        4,
    ]
    assert graph.nodes[1]["through"] == 2 and graph.nodes[0]["through"] is None
    assert graph.nodes[0]["sigma"] == 0.01
    np.testing.assert_array_equal(graph.nodes[(0, 1)]["position"], [3, 0, 0])
    assert graph.edges[(3, 0), (3, 0), 3]["closed"]
    assert nx.number_connected_components(graph) == 3


def test_nothing_is_an_empty_graph():
    assert len(to_networkx(Edges3D.none())) == 0
