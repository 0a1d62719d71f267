"""Meridians: where viewing rays touch a surface of revolution about a given axis, in closed form.

All normals of a surface of revolution meet its axis. On a viewing ray that touches it there, with
the normal that the image shows, this determines the point; all views must agree on one profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, Table
from colmap_edges.core.polylines import cross, unit
from colmap_edges.surfaces.revolution.samples import Samples

MIN_SINE = 0.1  # minimum sine between the plane of ray and axis and the normal
MIN_RISE = 0.25  # minimum cosine between the normal and the direction away from the axis
MIN_RADIUS_PX = 4.0  # minimum radius
CELL_PX = (4.0, 3.0)  # of votes, along and across the axis
NUM_SLOPES = 6  # of votes, over 180 degrees
MIN_SIDE, MIN_SIDES = 2, 6  # minimum number of views in a cell, of each side and of both together
MIN_SHARE = 0.1  # minimum of the latter, relative to all views of the neighbourhood


class Axis(NamedTuple):
    """An axis of revolution, and the ball around the body.

    Attributes:
        point: (3,) the centre of the ball.
        direction: (3,) unit direction.
        reach: radius of the ball, world units.
        pixel: length of a pixel there, world units.
    """

    point: FloatArray
    direction: FloatArray
    reach: float
    pixel: float


@dataclass(frozen=True, kw_only=True)
class Meridian(Table):
    """Points of a body's surface in the half plane of place along and distance from the axis.

    Attributes:
        rows: (m,) samples.
        points: (m, 2) places and radii, pixels of the axis.
        normals: (m, 2) unit normals there, away from the axis.
        sides: (m,) int64 side of the axis on which the ray passes it: 0 or 1.
        sizes: (m,) the lengths of a pixel of the view there, pixels of the axis.
    """

    rows: IntArray
    points: FloatArray
    normals: FloatArray
    sides: IntArray
    sizes: FloatArray


def samples_near(samples: Samples, axis: Axis) -> IntArray:
    """The samples whose rays meet the ball around the axis."""
    away = axis.point - samples.centers
    along = np.einsum("ij,ij->i", away, samples.rays)
    off = np.einsum("ij,ij->i", away, away) - along**2
    return np.flatnonzero((along > 0) & (off < axis.reach**2))


class Touched(NamedTuple):
    """Where viewing rays touch bodies of revolution; nan or infinite where they do not.

    Attributes:
        depths: (...,) lengths of the rays.
        places: (...,) places along the axis, from its point.
        radii: (...,) distances from the axis.
        slopes: (...,) cosines between the normals, away from the axis, and the axis.
        rises: (...,) cosines between the normals and the direction away from the axis.
        sines: (...,) sines between the normals and the planes of ray and axis.
        passing: (...,) on which side a ray passes the axis, by its sign.
    """

    depths: FloatArray
    places: FloatArray
    radii: FloatArray
    slopes: FloatArray
    rises: FloatArray
    sines: FloatArray
    passing: FloatArray


def touched(
    rays: FloatArray, normals: FloatArray, away: FloatArray, directions: FloatArray
) -> Touched:
    """Where rays with normals touch bodies.

    Args:
        rays: (..., 3) unit directions.
        normals: (..., 3) unit normals of the surface there.
        away: (..., 3) vectors from points of the axes to the rays' starts.
        directions: (..., 3) unit directions of the axes.
    """
    across = cross(directions, rays)
    sines = np.einsum("...j,...j->...", normals, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        depths = np.einsum("...j,...j->...", normals, cross(away, directions)) / sines
        points = away + depths[..., None] * rays
        places = np.einsum("...j,...j->...", points, directions)
        outwards = points - places[..., None] * directions
        radii = np.sqrt(np.einsum("...j,...j->...", outwards, outwards))
        rises = np.einsum("...j,...j->...", normals, outwards) / radii
        slopes = np.einsum("...j,...j->...", normals, directions) * np.sign(rises)
    passing = np.einsum("...j,...j->...", across, away)
    return Touched(depths, places, radii, slopes, np.abs(rises), np.abs(sines), passing)


def touched_by(samples: Samples, rows: IntArray, axis: Axis) -> tuple[Touched, BoolArray]:
    """Where the rays of (n,) samples touch bodies about an axis, and which do in its ball."""
    away, directions = samples.centers[rows] - axis.point, axis.direction[None]
    there = touched(samples.rays[rows], samples.normals[rows], away, directions)
    with np.errstate(invalid="ignore"):
        inside = (there.depths > 0) & (there.sines > MIN_SINE) & (there.rises > MIN_RISE)
        inside &= there.radii > MIN_RADIUS_PX * axis.pixel
        inside &= there.places**2 + there.radii**2 < axis.reach**2
    return there, inside


def meridian_of(samples: Samples, rows: IntArray, axis: Axis) -> Meridian:
    """The points at which the rays of (n,) samples touch the body, if it is one of revolution."""
    there, inside = touched_by(samples, rows, axis)
    kept = np.flatnonzero(inside)
    there = Touched(*(part[kept] for part in there))
    return Meridian(
        rows=rows[kept],
        points=np.column_stack([there.places, there.radii]) / axis.pixel,
        normals=unit(np.column_stack([there.slopes, there.rises])),
        sides=(there.passing < 0).astype(np.int64),
        sizes=there.depths / samples.focals[rows[kept]] / axis.pixel,
    )


def voted(samples: Samples, meridian: Meridian) -> tuple[float, IntArray]:
    """How many views agree on a profile on both sides of the axis, and on which rows."""
    if not len(meridian.rows):
        return 0.0, np.zeros(0, np.int64)
    views = samples.views[meridian.rows].astype(np.int64)
    cells = np.floor(meridian.points / CELL_PX).astype(np.int64)
    cells -= cells.min(axis=0)
    slopes, rises = np.ascontiguousarray(meridian.normals.T)
    angles = np.arctan2(slopes, rises) / np.pi + 0.5
    slopes = np.minimum((NUM_SLOPES * angles).astype(np.int64), NUM_SLOPES - 1)
    width = cells[:, 1].max() + 1
    keys = (cells[:, 0] * width + cells[:, 1]) * NUM_SLOPES + slopes
    unique, inverse = np.unique(
        (keys * (views.max() + 1) + views) * 2 + meridian.sides, return_inverse=True
    )
    cell = unique // (2 * (views.max() + 1))
    ranks = np.concatenate([[0], np.cumsum(np.diff(cell) > 0)])
    both = np.bincount(ranks)
    right = np.bincount(ranks, unique % 2)
    least = max(MIN_SIDES, 2 * MIN_SHARE * len(np.unique(views)))
    good = (np.minimum(right, both - right) >= MIN_SIDE) & (both >= least)
    return float((both[good] - least + 1).sum()), np.flatnonzero(good[ranks[inverse]])
