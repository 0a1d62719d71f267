"""Overlays of edge graphs and 3D edges on images."""

from __future__ import annotations

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Float32Array, FloatArray, Int32Array, Picture
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.topology import Topology
from colmap_edges.images.files import gray_of

SHIFT = 4  # OpenCV draws at fractions of 1/16 px
# Colours that are distinct on a dark background; BGR.
COLORS = ((80, 220, 255), (255, 200, 60), (120, 255, 120), (200, 130, 255), (100, 140, 255))


def draw_edge_graph(image: Picture, graph: EdgeGraph, topology: Topology) -> Picture:
    """Draw the polylines of an edge graph, in changing colours, over the darkened image.

    Args:
        image: (H, W, 3) uint8 BGR.
        graph: its edge graph.
        topology: the nodes of that graph.

    Returns:
        (H, W, 3) uint8 BGR; nodes where polylines meet are small white dots.
    """
    canvas = darkened(image)
    fixed = fixed_point(graph.points)
    offsets = graph.polyline_offsets
    for color_index, color in enumerate(COLORS):
        for closed in (False, True):
            chosen = np.flatnonzero(graph.closed == closed)
            chosen = chosen[chosen % len(COLORS) == color_index]
            lines = [fixed[offsets[p] : offsets[p + 1], None] for p in chosen]
            cv2.polylines(canvas, lines, closed, color, 1, cv2.LINE_AA, SHIFT)
    for point in shared_nodes(graph, topology):
        center = (int(point[0]), int(point[1]))
        cv2.circle(canvas, center, 2, (255, 255, 255), -1, cv2.LINE_AA)
    return canvas


def draw_edges(image: Picture, view_index: int, model: Model, edges: Edges3D) -> Picture:
    """Draw the projections of the 3D edges where a view observes them, over the darkened image.

    Args:
        image: (H, W, 3) uint8 BGR of the view.
        view_index: index of the view in the model.
        model: the model.
        edges: the 3D edges; colours change from edge to edge.

    Returns:
        (H, W, 3) uint8 BGR.
    """
    canvas = darkened(image)
    segments = observed_segments(edges, view_index)
    pixels, _ = model.views[view_index].project(edges.points[segments.ravel()])
    lines = fixed_point(pixels).reshape(-1, 2, 1, 2)
    edge_of_segment = edges.edge_ids[segments[:, 0]]
    for index, color in enumerate(COLORS):
        chosen = lines[edge_of_segment % len(COLORS) == index]
        cv2.polylines(canvas, list(chosen), False, color, 2, cv2.LINE_AA, SHIFT)
    return canvas


def observed_segments(edges: Edges3D, view_index: int) -> Int32Array:
    """(S, 2) points of the segments both of whose points a view observes."""
    observed = np.zeros(edges.num_points, bool)
    observed[edges.observations.points[edges.observations.views == view_index]] = True
    return edges.segments[observed[edges.segments].all(axis=1)]


def darkened(image: Picture) -> Picture:
    """The image at half its brightness and without colour: (H, W, 3) uint8 BGR."""
    return np.asarray(cv2.cvtColor(gray_of(image) // 2, cv2.COLOR_GRAY2BGR), np.uint8)


def fixed_point(points: FloatArray | Float32Array) -> Int32Array:
    """Image pixels in OpenCV's fixed-point drawing coordinates, in units of 1/16 px."""
    return np.rint((points - 0.5) * (1 << SHIFT)).astype(np.int32)


def shared_nodes(graph: EdgeGraph, topology: Topology) -> FloatArray:
    """(K, 2) pixels of the nodes where two or more ends of open polylines meet."""
    is_open = np.flatnonzero(~graph.closed)
    ends = topology.end_nodes[is_open].T.ravel()
    rows = np.concatenate(
        [graph.polyline_offsets[is_open], graph.polyline_offsets[is_open + 1] - 1]
    )
    _, first, counts = np.unique(ends, return_index=True, return_counts=True)
    return np.asarray(graph.points[rows[first[counts > 1]]])
