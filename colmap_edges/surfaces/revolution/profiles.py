"""Profiles of bodies about a fitted axis: radii and normals along it, and who shows them where."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import binary_dilation, convolve, label

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, row_numbers
from colmap_edges.core.polylines import unit
from colmap_edges.surfaces.revolution.meridians import CELL_PX, Axis, Meridian
from colmap_edges.surfaces.revolution.samples import Samples
from colmap_edges.surfaces.round_evidence import (
    COVERED_SHARE,
    MAX_GAP,
    MIN_ASPECT,
    closed_along,
    longest_run,
)

# Minimum number of views that show each side of the axis in a cell and those beside it, and its
# minimum relative to all views with samples there.
MIN_AROUND, MIN_AROUND_SHARE = 3, 1 / 6
MAX_CELLS = 4_000_000  # maximum number of cells; more come of an axis far from all outlines
JOINED_CELLS = np.ones((5, 1), bool)  # parts with smaller gaps along the axis are one
BIN_PX = 3.0  # along the axis
MAX_OFF = 2.0  # maximum distance from a curve that is to be the profile, in its deviations
MIN_BINS, MIN_IN_BIN = 4, 6
OUTLIER_PX = 4.0  # maximum distance of samples from the median of their bin
SURE_PX = 0.1  # minimum deviation
CLOSE_PX = 2.5  # maximum distance of outlines from the profile
# Minimum cosine between a sample's normal and the profile's: those of edges around it have any.
SAME_TURN = np.cos(np.radians(8.0))


@dataclass(frozen=True, kw_only=True)
class Profile:
    """A profile that is a function of the place along the axis, in B bins; pixels of the axis.

    Attributes:
        axis: the axis.
        places: (B,) the bins' places along the axis, ascending by `BIN_PX` or so.
        radii: (B,) radii.
        normals: (B, 2) unit normals along and away from the axis.
        shown: (V, 2, B) whether a view shows the outline of a side at a bin.
        rows: (n,) samples on it.
        deviation: median distance of the samples from it, pixels of the views.
    """

    axis: Axis
    places: FloatArray
    radii: FloatArray
    normals: FloatArray
    shown: BoolArray
    rows: IntArray
    deviation: float

    @property
    def gain(self) -> float:
        """The log likelihood of its samples, against any distances within `CLOSE_PX`."""
        return float(len(self.rows) * np.log(CLOSE_PX / max(self.deviation, SURE_PX)))

    @property
    def gap(self) -> int:
        """The number of bins that are a gap to be closed."""
        return max(int(MAX_GAP * np.median(self.radii) / BIN_PX), 2)

    def part(self, first: int, last: int) -> Profile:
        """Some consecutive bins."""
        return replace(
            self,
            places=self.places[first:last],
            radii=self.radii[first:last],
            normals=self.normals[first:last],
            shown=self.shown[:, :, first:last],
        )


def profiles_of(samples: Samples, meridian: Meridian, axis: Axis, num_views: int) -> list[Profile]:
    """The profiles on which many views agree on both sides of the axis."""
    parts = parts_of_meridian(samples, meridian)
    found = [profile_of(samples, meridian.select(rows), axis, num_views) for rows in parts]
    return [profile for profile in found if profile]


def parts_of_meridian(samples: Samples, meridian: Meridian) -> list[IntArray]:
    """Rows of the meridian in connected cells that many views show on both sides."""
    if not len(meridian.rows):
        return []
    cells = np.floor(meridian.points / CELL_PX).astype(np.int64)
    cells -= cells.min(axis=0)
    shape = tuple((cells.max(axis=0) + 1).tolist())
    if shape[0] * shape[1] > MAX_CELLS:
        return []
    views = samples.views[meridian.rows].astype(np.int64)
    rows = np.column_stack([cells, meridian.sides, views])
    unique = rows[np.unique(row_numbers(rows), return_index=True)[1]]
    counts = np.zeros((2, *shape))
    np.add.at(counts, (unique[:, 2], unique[:, 0], unique[:, 1]), 1)
    # Outlines of one view cross to the next cell across the axis.
    around = convolve(counts, np.ones((1, 1, 3)), mode="constant")
    least = max(MIN_AROUND, MIN_AROUND_SHARE * len(np.unique(views)))
    good = (around.min(axis=0) >= least) & (counts.sum(axis=0) >= least)
    labels, count = label(binary_dilation(good, JOINED_CELLS), np.ones((3, 3)))
    own = np.where(good, labels, 0)[cells[:, 0], cells[:, 1]]
    return [np.flatnonzero(own == i + 1) for i in range(count)]


def profile_of(samples: Samples, meridian: Meridian, axis: Axis, num_views: int) -> Profile | None:
    """The profile through the points of a meridian, where many views show it; or None."""
    views = samples.views[meridian.rows]
    low, high = np.quantile(meridian.points[:, 0], [0.005, 0.995])
    count = int((high - low) / BIN_PX)
    if count < MIN_BINS:
        return None
    places = low + (np.arange(count) + 0.5) * (high - low) / count
    along = meridian.select(np.argsort(meridian.points[:, 0], kind="stable"))
    binned = np.array([at_place(along, place) for place in places.tolist()])
    known = np.isfinite(binned[:, 0])
    if known.sum() < MIN_BINS:
        return None
    filled = [np.interp(places, places[known], column) for column in binned[known].T]
    radii, normals = filled[0], unit(np.column_stack(filled[1:]))
    off = (meridian.points[:, 1] - np.interp(meridian.points[:, 0], places, radii)) * (
        meridian.normals[:, 1] / meridian.sizes
    )
    turned = [np.interp(meridian.points[:, 0], places, column) for column in normals.T]
    alike = np.einsum("mj,mj->m", unit(np.column_stack(turned)), meridian.normals)
    close = np.flatnonzero((np.abs(off) < CLOSE_PX) & (alike > SAME_TURN))
    bins = np.clip(
        np.rint((meridian.points[close, 0] - places[0]) / (places[1] - places[0])), 0, count - 1
    )
    if not len(close):
        return None
    shown = np.zeros((num_views, 2, count), bool)
    for beside in (-1, 0, 1):  # samples are so far apart
        at = np.clip(bins.astype(np.int64) + beside, 0, count - 1)
        shown[views[close], meridian.sides[close], at] = True
    whole = Profile(
        axis=axis,
        places=places,
        radii=radii,
        normals=normals,
        shown=shown,
        rows=meridian.rows[close],
        deviation=float(np.median(np.abs(off[close]))),
    )
    return often_shown(whole)


def at_place(meridian: Meridian, place: float) -> list[float]:
    """The radius and the normal at a place along the axis; nan if few samples show it.

    The samples ascend along the axis.
    """
    bounds = place - 1.5 * BIN_PX, place + 1.5 * BIN_PX
    near = slice(*np.searchsorted(meridian.points[:, 0], bounds).tolist())
    normals, points, sides = meridian.normals[near], meridian.points[near], meridian.sides[near]
    if len(points) < MIN_IN_BIN:
        return [np.nan] * 3
    slopes = normals[:, 0] / normals[:, 1]
    radii = points[:, 1] - slopes * (place - points[:, 0])
    good = np.abs(radii - middle_of(radii)) * normals[:, 1] < OUTLIER_PX
    if good.sum() < MIN_IN_BIN:
        return [np.nan] * 3
    sides = sides[good]
    both = [middle_of(radii[good][sides == side]) for side in np.unique(sides)]
    return [float(np.mean(both)), *middle_of(normals[good]).tolist()]


def middle_of(values: FloatArray) -> FloatArray:
    """The median along the first axis; numpy's takes several times as long for few values."""
    ordered, half = np.sort(values, axis=0), len(values) // 2
    return np.asarray((ordered[(len(values) - 1) // 2] + ordered[half]) / 2)


def often_shown(whole: Profile) -> Profile | None:
    """The stretch of a profile that many views show; None if it is short."""
    covered = whole.shown.sum(axis=(0, 1))
    often = covered >= min(COVERED_SHARE * np.quantile(covered, 0.9), 2 * MIN_AROUND)
    return stretch_of(whole, closed_along(often, whole.gap))


def stretch_of(whole: Profile, kept: BoolArray) -> Profile | None:
    """The stretch of a profile of (B,) bins that most views show; None if it is short."""
    if not kept.any():
        return None
    first, last = longest_run(kept, whole.shown.sum(axis=(0, 1)))
    part = whole.part(first, last)
    long = np.ptp(part.places) > MIN_ASPECT * np.median(part.radii)
    return part if last - first >= MIN_BINS and long else None
