"""Nodes and smoothing of 2D edge graphs, regular-length filter (paper: 2D Edge-Graphs).

Only that filter and the command `detect` need them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
    owners_of,
)
from colmap_edges.core.groups import linked_groups
from colmap_edges.core.view import View
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import EdgeGraphOptions

if TYPE_CHECKING:
    from colmap_edges.edges2d.edge_graph import EdgeGraph

NODE_RADIUS_PX = 2.0  # distance at which an end touches another edge (8-neighbours, sub-pixel)


@dataclass(frozen=True, kw_only=True)
class Topology:
    """Nodes at which the P polylines of an edge graph meet, and their smoothed shape.

    Attributes:
        end_nodes: (P, 2) int32 node of the first and last point; polylines that share a node
            meet there; a closed polyline has its one node twice.
        node_polylines: (K,) int32 polyline that passes through a node (T junction), -1 if none.
        smoothed: (S,) int64 indices of the graph's points that Douglas-Peucker keeps.
        smoothed_offsets: (P + 1,) int64 CSR of `smoothed` by polyline.
    """

    end_nodes: Int32Array
    node_polylines: Int32Array
    smoothed: IntArray
    smoothed_offsets: IntArray


def topology_of(graph: EdgeGraph, view: View, options: EdgeGraphOptions) -> Topology:
    """Find the nodes of a view's edge graph and smooth its polylines."""
    points, offsets = graph.points.astype(np.float64) * view.scale, graph.polyline_offsets
    size = np.ceil(np.array([view.width, view.height]) * view.scale).astype(int)
    end_nodes, node_polylines = find_nodes(points, offsets, graph.closed, *size.tolist())
    smoothed, smoothed_offsets = _kernels.douglas_peucker(
        points, offsets, options.max_smoothing_distance_px
    )
    return Topology(
        end_nodes=end_nodes,
        node_polylines=node_polylines,
        smoothed=smoothed,
        smoothed_offsets=smoothed_offsets,
    )


def find_nodes(
    points: FloatArray, offsets: IntArray, closed: BoolArray, width: int, height: int
) -> tuple[Int32Array, Int32Array]:
    """Nodes of the ends of (P,) polylines of (N, 2) `points`; ends that touch share a node.

    An end that touches the inside of another polyline makes a T junction.

    Returns:
        (P, 2) int32 nodes of the ends, (K,) int32 polyline through each node or -1.
    """
    count = len(closed)
    if count == 0:
        return np.zeros((0, 2), np.int32), np.zeros(0, np.int32)
    tips = np.column_stack([offsets[:-1], offsets[1:] - 1]).ravel()
    pairs = cKDTree(points[tips]).query_pairs(NODE_RADIUS_PX, output_type="ndarray")
    own = 2 * np.flatnonzero(closed)[:, None] + np.arange(2)
    nodes = linked_groups(np.concatenate([pairs, own]), 2 * count)
    through = np.full(nodes.max() + 1, -1, np.int32)
    touched = _kernels.touched_chains(points, offsets, width, height)
    np.maximum.at(through, nodes, touched)
    return nodes.reshape(-1, 2).astype(np.int32), through


def regular_lengths(points: Float32Array, topology: Topology, max_angle_deg: float) -> FloatArray:
    """(P,) regular length of each smoothed polyline in pixels.

    The length of the longest run of connected segments whose consecutive angles are not greater
    than `max_angle_deg` (paper: definition of regular length).
    """
    vertices = points[topology.smoothed]
    ids = owners_of(topology.smoothed_offsets)
    within = ids[1:] == ids[:-1]
    segments = np.diff(vertices, axis=0)[within]
    polyline = ids[1:][within]
    result = np.zeros(len(topology.end_nodes))
    if len(segments) == 0:
        return result
    lengths = np.linalg.norm(segments, axis=1)
    directions = segments / (lengths[:, None] + 1e-12)
    cosines = np.einsum("ij,ij->i", directions[1:], directions[:-1])
    breaks = (cosines < np.cos(np.radians(max_angle_deg))) | (polyline[1:] != polyline[:-1])
    run = np.concatenate([[0], np.cumsum(breaks)])
    run_lengths = np.bincount(run, weights=lengths)
    run_polylines = polyline[np.concatenate([[0], np.flatnonzero(breaks) + 1])]
    np.maximum.at(result, run_polylines, run_lengths)
    return result


def regular_polylines(
    points: Float32Array, topology: Topology, options: EdgeGraphOptions
) -> BoolArray:
    """(P,) whether a polyline's component has one of at least the threshold's regular length.

    The threshold is the shortest regular length among the top share of polylines (paper: l_R*).
    """
    if len(topology.end_nodes) == 0:
        return np.zeros(0, bool)
    lengths = regular_lengths(points, topology, options.max_regular_angle_deg)
    top = max(1, int(np.ceil(options.top_regular_length_ratio * len(lengths))))
    threshold = np.sort(lengths)[-top]
    component = component_labels(topology)
    longest = np.zeros(component.max() + 1)
    np.maximum.at(longest, component, lengths)
    kept: BoolArray = longest[component] >= threshold
    return kept


def component_labels(topology: Topology) -> IntArray:
    """(P,) connected component of each polyline, through shared nodes and T junctions."""
    count, num_nodes = len(topology.end_nodes), len(topology.node_polylines)
    through = np.flatnonzero(topology.node_polylines >= 0)
    polylines = np.concatenate([np.repeat(np.arange(count), 2), topology.node_polylines[through]])
    nodes = np.concatenate([topology.end_nodes.ravel(), through]) + count
    return linked_groups(np.column_stack([polylines, nodes]), count + num_nodes)[:count]
