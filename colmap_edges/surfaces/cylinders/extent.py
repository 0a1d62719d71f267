"""The part of a cylinder that views show: its extent along the axis, and who sees it where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_closing

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.seen_points import NO_POINTS, SeenPoints
from colmap_edges.core.view import View
from colmap_edges.surfaces.cylinders.hypotheses import Cylinders
from colmap_edges.surfaces.cylinders.lines import Lines
from colmap_edges.surfaces.cylinders.sight import rays_that_meet
from colmap_edges.surfaces.cylinders.support import Support
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.round_evidence import (
    COVERED_SHARE,
    MAX_GAP,
    MAX_THROUGH,
    MIN_STEPS,
    SPACING_PX,
    Rays,
    Sight,
    frontal_views,
    seen_away_from_edges,
    show_all_around,
)

BINS_PER_RADIUS = 12  # bins along the axis
END_PX = 4.0  # distance of points from the ends, where outlines bend into rims


@dataclass(frozen=True, kw_only=True)
class Extent:
    """Who sees a cylinder where along its axis.

    Attributes:
        starts: (B + 1,) borders of the bins along the axis.
        shown: (V, 2, B) whether a view shows the outline of a side at a bin.
    """

    starts: FloatArray
    shown: BoolArray

    @property
    def both(self) -> BoolArray:
        """(V,) whether a view shows both outlines."""
        sides: BoolArray = np.asarray(self.shown.any(axis=2))
        return np.asarray(sides[:, 0] & sides[:, 1])


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
    padded = np.pad(often, gap)
    often = binary_closing(padded, np.ones(gap + 1, bool))[gap:-gap]
    first, last = longest_run(often, covered)
    return Extent(starts=low + step * np.arange(first, last + 1), shown=shown[:, :, first:last])


def longest_run(mask: BoolArray, weights: IntArray) -> tuple[int, int]:
    """The run of true values with the largest sum of weights: its start and end."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    sums = [weights[a:b].sum() for a, b in borders.reshape(-1, 2)]
    first, last = borders.reshape(-1, 2)[int(np.argmax(sums))]
    return int(first), int(last)


def are_in_image(one: Cylinders, extent: Extent, views: Sequence[View]) -> BoolArray:
    """(V,) whether most of the axis projects into a view's image."""
    places = np.linspace(extent.starts[0], extent.starts[-1], 9)
    axis = one.points[0] + places[:, None] * one.axes[0]
    return np.array([view.holds(*view.project(axis)).mean() > 0.5 for view in views])


def is_believed(one: Cylinders, extent: Extent, sight: Sight, views: Sequence[View]) -> bool:
    """Whether views all around show both outlines, and few rays pass through the cylinder."""
    inside = are_in_image(one, extent, views)
    met = int((~sight.before).sum())
    is_solid = bool(sight.through.sum() <= MAX_THROUGH * met)
    return is_solid and show_all_around(extent.both, inside, one.points[0], one.axes[0], views)


def points_on(
    one: Cylinders, extent: Extent, sight: Sight, views: Sequence[View], evidence: Evidence
) -> SeenPoints:
    """Points on a cylinder, away from its edges, with the views that see them.

    A view sees it where it shows both outlines: a body before it would hide one of them.
    """
    axis, radius = one.axes[0], one.radii[0]
    showing = np.flatnonzero(extent.both)
    seen = seen_bins(extent, sight)[showing]
    centers = np.array([view.center for view in views])[showing]
    middle = one.points[0] + extent.starts.mean() * axis
    sizes = [np.linalg.norm(middle - view.center) / view.focal_px for view in views]
    step = min(SPACING_PX * float(np.quantile(sizes, 0.25)), 2 * np.pi * radius / MIN_STEPS)
    basis = np.linalg.svd(axis[None])[2][1:]
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
    return seen_away_from_edges(points, frontal, showing, evidence, step)


def seen_bins(extent: Extent, sight: Sight) -> BoolArray:
    """(V, B) whether a view sees a bin: between both outlines, with nothing before it."""
    gap = int(MAX_GAP * BINS_PER_RADIUS)
    padded = np.pad(extent.shown, ((0, 0), (0, 0), (gap, gap)))
    seen = binary_closing(padded, np.ones((1, 1, gap + 1), bool))[:, :, gap:-gap]
    num_bins = len(extent.starts) - 1
    bins = np.clip(np.searchsorted(extent.starts, sight.places) - 1, 0, num_bins - 1)
    hidden = np.zeros((seen.shape[0], num_bins), bool)
    hidden[sight.views[sight.before], bins[sight.before]] = True
    return np.asarray(seen[:, 0] & seen[:, 1] & ~hidden)


def sight_of_extent(one: Cylinders, extent: Extent, rays: Rays, views: Sequence[View]) -> Sight:
    """The rays to observed points that meet the shown part."""
    margin = (extent.starts[-1] - extent.starts[0]) / len(extent.starts)
    low, high = extent.starts[0] + margin, extent.starts[-1] - margin
    return rays_that_meet(one, low, high, rays, views)
