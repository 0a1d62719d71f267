"""Upward directions as users give them: an axis of the model, or three numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.declared_options import shown
from colmap_edges.errors import OptionError
from colmap_edges.export.units import AXES


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


def nearest_axis(up: FloatArray) -> str:
    """Name of the axis nearest to a (3,) direction: x, y, z, -x, -y or -z."""
    axis = int(np.abs(up).argmax())
    return ("" if up[axis] > 0 else "-") + "xyz"[axis]
