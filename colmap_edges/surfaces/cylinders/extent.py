"""The part of a cylinder that views show: its extent along the axis, and who sees it where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.core.polylines import plane_basis
from colmap_edges.core.seen_points import NO_POINTS, SeenPoints
from colmap_edges.core.view import View
from colmap_edges.surfaces.cylinders.hypotheses import Cylinders
from colmap_edges.surfaces.cylinders.lines import Lines
from colmap_edges.surfaces.cylinders.sight import rays_that_meet
from colmap_edges.surfaces.cylinders.support import Support
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.round_evidence import (
    COVERED_SHARE,
    END_PX,
    MAX_GAP,
    MIN_STEPS,
    SPACING_PX,
    Rays,
    Sight,
    closed_along,
    frontal_views,
    longest_run,
    on_both_sides,
    seen_on_body,
)

BINS_PER_RADIUS = 12  # bins along the axis


@dataclass(frozen=True, kw_only=True)
class Extent:
    """Who sees a cylinder where along its axis.

    Attributes:
        starts: (B + 1,) borders of the bins along the axis.
        shown: (V, 2, B) whether a view shows the outline of a side at a bin.
    """

    starts: FloatArray
    shown: BoolArray


def extent_of(lines: Lines, one: Cylinders, support: Support, num_views: int) -> Extent:
    """The stretch of the axis at which many of the outlines are seen."""
    low, high = support.places[:, 0].min(), support.places[:, 1].max()
    count = max(int(np.ceil((high - low) / one.radii[0] * BINS_PER_RADIUS)), 1)
    step = (high - low) / count
    shown = np.zeros((num_views, 2, count), bool)
    bins = np.clip(np.floor((support.places - low) / step), 0, count - 1).astype(np.int64)
    for row, side, (first, last) in zip(support.rows, support.sides, bins, strict=True):
        shown[lines.views[row], side, first : last + 1] = True
    covered = shown.sum(axis=(0, 1))
    often = covered >= COVERED_SHARE * np.quantile(covered, 0.9)
    gap = int(MAX_GAP * BINS_PER_RADIUS)
    first, last = longest_run(closed_along(often, gap), covered)
    return Extent(starts=low + step * np.arange(first, last + 1), shown=shown[:, :, first:last])


def points_on(
    one: Cylinders, extent: Extent, views: Sequence[View], evidence: Evidence, sight: Sight
) -> SeenPoints | None:
    """Points on a cylinder, away from its edges, with the views that see them.

    A view sees it where it shows both outlines: a body before it would hide one of them. None if
    rays pass through much of it.
    """
    axis, radius = one.axes[0], one.radii[0]
    showing = np.flatnonzero(on_both_sides(extent.shown))
    shown = closed_along(extent.shown, int(MAX_GAP * BINS_PER_RADIUS))
    seen = np.asarray(shown.all(axis=1))[showing]
    centers = np.array([view.center for view in views])[showing]
    middle = one.points[0] + extent.starts.mean() * axis
    sizes = [np.linalg.norm(middle - view.center) / view.focal_px for view in views]
    step = min(SPACING_PX * float(np.quantile(sizes, 0.25)), 2 * np.pi * radius / MIN_STEPS)
    basis = plane_basis(axis)
    margin = END_PX * float(np.median(sizes))
    low, high = extent.starts[0] + margin, extent.starts[-1] - margin
    if high <= low:
        return NO_POINTS
    places = np.linspace(low, high, max(int((high - low) / step) + 1, 2))
    angles = 2 * np.pi * np.arange(int(np.ceil(2 * np.pi * radius / step)))
    angles /= len(angles)
    circle = np.column_stack([np.cos(angles), np.sin(angles)]) @ basis
    normals = np.tile(circle, (len(places), 1))
    points = one.points[0] + np.repeat(places, len(circle))[:, None] * axis + radius * normals
    bins = np.searchsorted(extent.starts, np.repeat(places, len(circle)), side="right") - 1
    bins = np.clip(bins, 0, len(extent.starts) - 2)
    frontal = frontal_views(points, normals, seen[:, bins].T, centers)
    return seen_on_body(points, normals, frontal, showing, evidence, sight, step)


def sight_of_extent(one: Cylinders, extent: Extent, rays: Rays, views: Sequence[View]) -> Sight:
    """The rays to observed points that meet the shown part."""
    margin = (extent.starts[-1] - extent.starts[0]) / len(extent.starts)
    low, high = extent.starts[0] + margin, extent.starts[-1] - margin
    return rays_that_meet(one, low, high, rays, views)
