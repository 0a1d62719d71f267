"""3D edges as a networkx graph, whose nodes are corners and free ends."""

from __future__ import annotations

from typing import Any

from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import extra


@checked
def to_networkx(edges: Edges3D) -> Any:
    """The graph of the 3D edges, for the algorithms of networkx.

    Args:
        edges: 3D edges with nodes, as returned by `reconstruct` and `read_edges`.

    Returns:
        A networkx.MultiGraph. Its nodes are the numbers of the edges' nodes, and (edge, 0) or
        (edge, 1) for a first or last point that is no node; a closed edge without a node begins
        and ends at (edge, 0). Each has its `position`, (3,) in world units; nodes of `edges.nodes`
        also `sigma`, and `through`, the number of the edge that passes there (T junction) or None.
        The key of an edge is its number; it has a `length` in world units, `closed` and `points`,
        its range in `edges.points`.

    Raises:
        ColmapEdgesError: if networkx is not installed.
    """
    with extra("to_networkx", "graph"):
        import networkx as nx
    graph = nx.MultiGraph()
    nodes, owners = edges.nodes, edges.edge_ids
    for node, position in enumerate(nodes.points):
        through = int(nodes.through_points[node])
        passing = int(owners[through]) if through >= 0 else None
        graph.add_node(node, position=position, sigma=float(nodes.sigmas[node]), through=passing)
    lengths = edges.lengths()
    for edge, (first, end) in enumerate(
        zip(edges.edge_offsets[:-1].tolist(), edges.edge_offsets[1:].tolist(), strict=True)
    ):
        closed = bool(edges.closed[edge])
        keys = []
        for side, point in enumerate((first, first if closed else end - 1)):
            node = int(edges.end_nodes[edge, side])
            keys.append(node if node >= 0 else (edge, 0 if closed else side))
            if keys[-1] not in graph:
                graph.add_node(keys[-1], position=edges.points[point])
        length = float(lengths[edge])
        graph.add_edge(*keys, key=edge, length=length, closed=closed, points=(first, end))
    return graph
