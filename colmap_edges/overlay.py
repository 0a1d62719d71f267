"""Pictures of what was detected, drawn over the image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_edges.edge_graph import EdgeGraph

SHIFT = 4  # OpenCV draws at fractions of 1/16 px
# Distinct on dark ground; BGR.
COLORS = ((80, 220, 255), (255, 200, 60), (120, 255, 120), (200, 130, 255), (100, 140, 255))


def draw_edge_graph(image: NDArray[np.uint8], graph: EdgeGraph) -> NDArray[np.uint8]:
    """Draw the polylines of an edge graph, colours changing, over the darkened image.

    Args:
        image: (H, W, 3) uint8 BGR.
        graph: its edge graph.

    Returns:
        (H, W, 3) uint8 BGR; nodes where polylines meet are small white dots.
    """
    canvas: NDArray[Any] = cv2.cvtColor(
        cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) // 2, cv2.COLOR_GRAY2BGR
    )
    fixed = np.rint((graph.points - 0.5) * (1 << SHIFT)).astype(np.int32)
    offsets = graph.polyline_offsets
    for color_index, color in enumerate(COLORS):
        for closed in (False, True):
            chosen = np.flatnonzero(graph.closed == closed)
            chosen = chosen[chosen % len(COLORS) == color_index]
            lines = [fixed[offsets[p] : offsets[p + 1], None] for p in chosen]
            cv2.polylines(canvas, lines, closed, color, 1, cv2.LINE_AA, SHIFT)
    for point in shared_nodes(graph):
        center = (int(point[0]), int(point[1]))
        cv2.circle(canvas, center, 2, (255, 255, 255), -1, cv2.LINE_AA)
    return canvas


def shared_nodes(graph: EdgeGraph) -> NDArray[np.float64]:
    """(K, 2) pixels of the nodes where two or more ends of open polylines meet."""
    is_open = np.flatnonzero(~graph.closed)
    ends = graph.end_nodes[is_open].T.ravel()
    rows = np.concatenate(
        [graph.polyline_offsets[is_open], graph.polyline_offsets[is_open + 1] - 1]
    )
    _, first, counts = np.unique(ends, return_index=True, return_counts=True)
    points: NDArray[np.float64] = graph.points[rows[first[counts > 1]]]
    return points
