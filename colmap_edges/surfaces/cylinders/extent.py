"""The profile of a cylinder: a line along the axis, as far as views show its outlines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.view import View
from colmap_edges.surfaces.cylinders.hypotheses import Cylinders
from colmap_edges.surfaces.cylinders.lines import Lines
from colmap_edges.surfaces.cylinders.support import Support
from colmap_edges.surfaces.revolution.meridians import axis_about
from colmap_edges.surfaces.revolution.profiles import BIN_PX, Profile, often_shown


def profile_of(
    lines: Lines, one: Cylinders, support: Support, views: Sequence[View]
) -> Profile | None:
    """The stretch of a cylinder at which many views show its outlines; None if it is short."""
    low, high = support.places[:, 0].min(), support.places[:, 1].max()
    middle = one.points[0] + (low + high) / 2 * one.axes[0]
    axis = axis_about(middle, one.axes[0], high - low + 2 * one.radii[0], views)
    count = max(int((high - low) / axis.pixel / BIN_PX), 1)
    step = (high - low) / count
    shown = np.zeros((len(views), 2, count), bool)
    bins = np.clip(np.floor((support.places - low) / step), 0, count - 1).astype(np.int64)
    for row, side, (first, last) in zip(support.rows, support.sides, bins, strict=True):
        shown[lines.views[row], side, first : last + 1] = True
    whole = Profile(
        axis=axis,
        places=((np.arange(count) + 0.5) / count - 0.5) * (high - low) / axis.pixel,
        radii=np.full(count, one.radii[0] / axis.pixel),
        normals=np.tile([0.0, 1.0], (count, 1)),
        shown=shown,
        rows=support.rows,
        deviation=0.0,
    )
    return often_shown(whole)
