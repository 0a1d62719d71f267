"""Views around round bodies, and the edge graphs of what they show."""

import numpy as np
import pycolmap
from plain_rooms import upright_view

from colmap_edges.edges2d.edge_graph import EdgeGraph

NOISE_PX = 0.2


def views_around(target, lift, num_views=12):
    """Views from a circle above the ground towards a target; two of three are lifted more."""
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[600, 600, 320, 240])
    views = []
    for i, angle in enumerate(np.linspace(0, 2 * np.pi, num_views, endpoint=False)):
        center = np.array([4 * np.cos(angle), 4 * np.sin(angle), 1.8 + lift * (i % 3)])
        views.append(upright_view(i, camera, center, target - center))
    return tuple(views)


def noisy_graph(parts, rng):
    """The edge graph of polylines of (n, 2) undistorted pixels, with noise."""
    pixels = np.concatenate(parts)
    pixels = (pixels + rng.normal(0, NOISE_PX, pixels.shape)).astype(np.float32)
    count = len(pixels)
    return EdgeGraph(
        points=pixels,
        undistorted=pixels,
        normals=np.zeros((count, 2), np.float32),
        sides=np.zeros((count, 2), np.uint8),
        colors=np.zeros((count, 3), np.uint8),
        polyline_offsets=np.concatenate([[0], np.cumsum([len(part) for part in parts])]),
        closed=np.zeros(len(parts), bool),
    )
