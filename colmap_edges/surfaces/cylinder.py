"""A cylinder that views show, as it is written and read."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.core.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Cylinder:
    """The visible part of a cylinder.

    Attributes:
        start: (3,) point on the axis at its first end.
        end: (3,) point on the axis at its last end.
        radius: radius, world units.
        views: indices of the views that show both its outlines.
    """

    start: FloatArray
    end: FloatArray
    radius: float
    views: IntArray
