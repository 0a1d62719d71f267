"""Chains of hand-made points."""

import curves as known
import numpy as np

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges2d.detection import Chains
from colmap_edges.edges2d.edge_graph import build_edge_graph
from colmap_edges.edges2d.topology import topology_of
from colmap_edges.options import EdgeGraphOptions

VIEW = known.make_view(np.eye(3), np.zeros(3))


def make_chains(*parts):
    """Chains of (points, side): the normal lies on that side of the direction."""
    normals = []
    for points, side in parts:
        tangents = np.gradient(points, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        normals.append(side * np.column_stack([-tangents[:, 1], tangents[:, 0]]))
    return Chains(
        points=np.concatenate([points for points, _ in parts]),
        normals=np.concatenate(normals),
        sides=np.zeros((sum(len(points) for points, _ in parts), 2), np.uint8),
        offsets=offsets_of(np.array([len(points) for points, _ in parts])),
    )


def straight(start, end, spacing=1.0):
    """Points from start to end, `spacing` apart."""
    start, end = np.array(start, float), np.array(end, float)
    count = round(np.linalg.norm(end - start) / spacing)
    return start + np.linspace(0, 1, count + 1)[:, None] * (end - start)


def build(chains, view=VIEW, **options):
    return build_edge_graph(chains, view, EdgeGraphOptions(**options))[0]


def topology(graph):
    return topology_of(graph, VIEW, EdgeGraphOptions())


def no_chains():
    nothing = np.zeros((0, 2))
    return Chains(
        points=nothing,
        normals=nothing,
        sides=nothing.astype(np.uint8),
        offsets=np.zeros(1, np.int64),
    )
