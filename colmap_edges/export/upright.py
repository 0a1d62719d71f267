"""The upward direction of a scene, by its images and straight edges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.curves3d import LINE, Curves3D
from colmap_edges.core.upright import up_direction
from colmap_edges.core.view import View
from colmap_edges.declared_options import shown
from colmap_edges.errors import OptionError
from colmap_edges.export.units import AXES

NEAR_DEG = 30.0  # the images' estimate is that precise
LINE_DEG = 1.5  # lines this close to vertical or horizontal count as such
AXIS_DEG = 5.0  # an axis of the model this close is taken itself: the model has been aligned
MAX_LINES = 200  # the longest ones


def direction(up: Any) -> FloatArray:
    """(3,) a direction given by an axis such as "-y", or by three numbers.

    Raises:
        OptionError: if it is neither.
    """
    if isinstance(up, str) and up in AXES:
        return np.array(AXES[up], float)
    try:
        given = np.array(up, float)
    except (TypeError, ValueError):
        given = np.zeros(0)
    length = float(np.linalg.norm(given)) if given.shape == (3,) else 0.0
    if not 0 < length < np.inf:
        raise OptionError(f"up is {shown(up)}; give three numbers or one of: {', '.join(AXES)}")
    return np.asarray(given / length)


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
    axis = np.array(AXES[nearest_axis(found)], float)
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


def nearest_axis(up: FloatArray) -> str:
    """Name of the axis nearest to a (3,) direction: x, y, z, -x, -y or -z."""
    axis = int(np.abs(up).argmax())
    return ("" if up[axis] > 0 else "-") + "xyz"[axis]
