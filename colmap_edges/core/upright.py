"""The upward direction of a scene, by its images and straight edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.curves3d import LINE, Curves3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View

LEVEL = 0.1  # weight of the images' upward axes against that of the axes beside them
NEAR_DEG = 30.0  # the images' estimate is that precise
LINE_DEG = 1.5  # lines this close to vertical or horizontal count as such
AXIS_DEG = 5.0  # an axis of the model this close is taken itself: the model has been aligned
MAX_LINES = 200  # the longest ones
ROLLED = 0.5  # images whose upward directions agree less than this share of where they look


def upward(views: Sequence[View], curves: Curves3D | None = None) -> FloatArray:
    """(3,) unit upward direction by the images, made precise by straight edges.

    Most straight edges of what people build are vertical or horizontal: of all directions near
    the images' estimate, the one is chosen to which the largest length of lines is parallel or
    perpendicular. An axis of the model within `AXIS_DEG` is taken itself.

    Args:
        views: posed images.
        curves: curves of the 3D edges, whose lines are used.
    """
    found = up_direction(views)
    if curves is not None:
        lines = curves.frames[curves.kinds == LINE, 1]
        lengths = np.linalg.norm(lines, axis=1)
        longest = np.argsort(-lengths, kind="stable")[:MAX_LINES]
        longest = longest[lengths[longest] > 0]
        if len(longest):
            found = along_lines(found, lines[longest])
    nearest = int(np.abs(found).argmax())
    axis = np.sign(found[nearest]) * np.eye(3)[nearest]
    return axis if axis @ found > np.cos(np.radians(AXIS_DEG)) else found


def along_lines(prior: FloatArray, lines: FloatArray) -> FloatArray:
    """(3,) unit direction near `prior` that fits (L, 3) lines best."""
    lengths = np.linalg.norm(lines, axis=1)
    ways = lines / lengths[:, None]
    top = ways[:50]
    first, second = np.triu_indices(len(top), 1)
    normals = np.cross(top[first], top[second])
    sizes = np.linalg.norm(normals, axis=1)
    crossing = normals[sizes > 0.5] / sizes[sizes > 0.5, None]
    tried = np.concatenate([prior[None], ways, crossing])
    tried *= np.where(tried @ prior < 0, -1.0, 1.0)[:, None]
    tried = tried[tried @ prior > np.cos(np.radians(NEAR_DEG))]
    dots = np.abs(tried @ ways.T)
    tolerance = np.radians(LINE_DEG)
    fit = (dots < np.sin(tolerance)) | (dots > np.cos(tolerance))
    # Of directions that fit equally well, the images' choice.
    best = int((fit @ lengths + 0.01 * lengths.sum() * (tried @ prior)).argmax())
    return adjusted(tried[best], ways[fit[best]], lengths[fit[best]])


def adjusted(start: FloatArray, ways: FloatArray, weights: FloatArray) -> FloatArray:
    """(3,) unit direction near `start` with least squares to (L, 3) parallel or level ways."""
    along = np.abs(ways @ start) > 0.5
    squares = np.einsum("l,li,lj->ij", np.where(along, -weights, weights), ways, ways)
    squares += weights[along].sum() * np.eye(3)
    weak = 1e-3 * weights.sum() + 1e-300
    found = np.linalg.solve(squares + weak * np.eye(3), weak * start)
    return np.asarray(found / np.linalg.norm(found))


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
