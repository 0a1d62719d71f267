"""The upward direction of a scene, by the images alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View

LEVEL = 0.1  # weight of the images' upward axes against that of the axes beside them
ROLLED = 0.5  # images whose upward directions agree less than this share of where they look


def up_direction(views: Sequence[View]) -> FloatArray:
    """(3,) unit upward direction in world coordinates, most images being upright.

    Images that look one way, but are turned in every direction, look down, as those of a drone do.
    """
    forward, down = (np.mean([view.rotation[row] for view in views], axis=0) for row in (2, 1))
    if np.linalg.norm(down) < ROLLED * np.linalg.norm(forward):
        return np.asarray(-forward / np.linalg.norm(forward))
    return along_axes(views, 0)[0]


def up_directions(views: Sequence[View]) -> list[FloatArray]:
    """The (3,) unit upward direction; two opposite ones if all photographs are turned by 90°.

    Photographs are held upright or turned, a few or all of them. The image axes that point up do
    so in all images, while others turn with the camera.
    """
    (upright, agreement), (sideways, turned) = (along_axes(views, first) for first in (0, 1))
    return [sideways, -sideways] if turned > agreement else [upright]


def along_axes(views: Sequence[View], first: int) -> tuple[FloatArray, float]:
    """(3,) unit direction to which one axis of each image points, and how far these axes agree.

    The axes beside them are taken as level.

    Args:
        views: posed images.
        first: the axis of most images: 0 upwards, 1 to the right.
    """
    right, down = (np.array([view.rotation[row] for view in views]) for row in (0, 1))
    axes, rows = np.stack([-down, right, down, -right]), np.arange(len(views))
    mean = axes[first].mean(axis=0)
    for _ in range(4):
        chosen = (axes @ mean).argmax(axis=0)
        mean = axes[chosen, rows].mean(axis=0)
    beside = axes[(chosen + 1) % 4, rows]
    # The least squares of beside . v and of LEVEL * |v - axis|.
    found = np.linalg.solve(beside.T @ beside / len(views) + LEVEL * np.eye(3), mean)
    return unit(found), float(np.linalg.norm(mean))
