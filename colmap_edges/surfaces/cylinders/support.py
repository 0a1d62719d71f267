"""Support of cylinders by the outlines that all views show, and their fit to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, blocks
from colmap_edges.core.polylines import cross, plane_basis, unit
from colmap_edges.surfaces.cylinders.hypotheses import NEAR_PX, Cylinders, tangencies
from colmap_edges.surfaces.cylinders.lines import Lines
from colmap_edges.surfaces.round_evidence import MAX_GAP

ENOUGH_PX = 40.0  # length of an outline from which on more does not count
BLOCK = 32  # cylinders that are compared with all lines at once
NUM_FITS = 4  # rounds of fitting and choosing
SAME_PX = 1.0  # maximum distance of outlines from a fixed line that explains them
EXPLAINED_SHARE = 0.9  # share of outlines that fixed lines are to explain


@dataclass(frozen=True, kw_only=True)
class Support:
    """Lines on the outlines of a cylinder.

    Attributes:
        rows: (n,) lines.
        sides: (n,) int64 side of the axis on which a line is: 0 or 1.
        places: (n, 2) least and largest place along the axis.
        score: length of the outlines in pixels, no more than `ENOUGH_PX` for each side and view.
    """

    rows: IntArray
    sides: IntArray
    places: FloatArray
    score: float


def errors_of(lines: Lines, found: Cylinders) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(H, L, 2) distances of lines from outlines in pixels, inf behind; sides (+-1), and places."""
    every = np.broadcast_to(np.arange(len(lines.views)), (len(found.radii), len(lines.views)))
    distances, places, depths = tangencies(lines, every, found.points, found.axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = (np.abs(distances) - found.radii[:, None, None]) * lines.focals[:, None] / depths
    return np.where(depths > 0, off, np.inf), np.sign(distances), places


def support_of(lines: Lines, one: Cylinders) -> Support:
    """The lines on a cylinder's outlines, on the stretch with the most."""
    return supports_of(lines, one)[0]


def supports_of(lines: Lines, found: Cylinders) -> list[Support]:
    """`support_of` of H cylinders."""
    supports = []
    for block in blocks(len(found.radii), BLOCK):
        part = Cylinders(*(of[block] for of in found))
        for h, passing in enumerate(passing_by(lines, part)):
            one = Cylinders(*(of[h : h + 1] for of in part))
            errors, sides, places = (of[0] for of in errors_of(lines.select(passing), one))
            near = (np.abs(errors) < NEAR_PX).all(axis=1) & (sides[:, 0] == sides[:, 1])
            rows, places = passing[near], np.sort(places[near], axis=1)
            supports.append(on_one_stretch(lines, rows, sides[near, 0] > 0, places, one))
    return supports


def passing_by(lines: Lines, found: Cylinders) -> list[IntArray]:
    """Of H cylinders the lines with first ends near outlines, or little beyond."""
    points, axes, radii = found
    rays, middle = np.ascontiguousarray(lines.rays[:, 0]), points.mean(axis=0)
    centers, points = lines.centers - middle, points - middle
    slopes = rays @ axes.T
    squares = np.maximum(1 - slopes**2, 1e-12)  # of the sines of the angles to the axis
    # With `away` from centre to point: (axis x ray) . away = ray . (away x axis).
    heights = rays @ cross(points, axes).T - cross(rays, centers) @ axes.T
    ahead = rays @ points.T - np.einsum("ij,ij->i", rays, centers)[:, None]
    aside = np.einsum("ij,ij->i", points, axes) - centers @ axes.T
    depths = (ahead - slopes * aside) / squares
    limits = 1.01 * NEAR_PX * depths / lines.focals[:, None]
    near = np.abs(np.abs(heights) / np.sqrt(squares) - radii) < limits
    return [np.flatnonzero(own) for own in near.T]


def on_one_stretch(
    lines: Lines, rows: IntArray, sides: BoolArray, places: FloatArray, one: Cylinders
) -> Support:
    """The stretch along the axis, without large gaps, with the most support."""
    order = np.argsort(places[:, 0], kind="stable")
    rows, on_side, places = rows[order], sides[order].astype(np.int64), places[order]
    if not len(rows):
        return Support(rows=rows, sides=on_side, places=places, score=0.0)
    ends = np.maximum.accumulate(places[:, 1])
    starts = np.concatenate([[0], places[1:, 0] - ends[:-1] > MAX_GAP * one.radii[0]])
    stretch = np.cumsum(starts).astype(np.int64)
    keys = (stretch * (lines.views.max() + 1) + lines.views[rows]) * 2 + on_side
    unique, inverse = np.unique(keys, return_inverse=True)
    seen = np.minimum(np.bincount(inverse, lines.lengths[rows]), ENOUGH_PX)
    scores = np.bincount(unique // (2 * (lines.views.max() + 1)), seen)
    kept = np.flatnonzero(stretch == np.argmax(scores))
    return Support(
        rows=rows[kept], sides=on_side[kept], places=places[kept], score=float(scores.max())
    )


def fitted(lines: Lines, start: Cylinders) -> tuple[Cylinders, Support]:
    """A cylinder fitted to its support, which is chosen again and again."""
    one, support = start, support_of(lines, start)
    for _ in range(NUM_FITS):
        if len(support.rows) < 5:
            break
        one = fit(lines.select(support.rows), one)
        support = support_of(lines, one)
    return one, support


def fit(lines: Lines, start: Cylinders) -> Cylinders:
    """The cylinder nearest to whose outlines the ends of lines are, robustly."""
    axis, radius = start.axes[0], start.radii[0]
    basis = plane_basis(axis)
    middle = start.points[0]
    scale = np.array([radius, radius, 1.0, 1.0, radius])

    def cylinder(x: FloatArray) -> Cylinders:
        x = x * scale
        return Cylinders(
            (middle + x[:2] @ basis)[None],
            unit(axis + x[2:4] @ basis)[None],
            np.array([radius + x[4]]),
        )

    def residuals(x: FloatArray) -> FloatArray:
        errors = np.clip(np.nan_to_num(errors_of(lines, cylinder(x))[0][0], posinf=1e3), -1e3, 1e3)
        flat: FloatArray = (errors * np.sqrt(lines.lengths / ENOUGH_PX)[:, None]).ravel()
        return flat

    found = least_squares(residuals, np.zeros(5), loss="soft_l1", f_scale=0.7, max_nfev=12)
    return cylinder(found.x)


def num_fixed_lines(lines: Lines, one: Cylinders, support: Support) -> int:
    """The number of fixed lines on a cylinder that explain the outlines as well as it does.

    Outlines move over a cylinder as views move around its axis. Where views move along it, or see
    it from two directions only, a few lines that do not move look the same. Seen along the axis,
    an outline is a ray that touches a circle; a line is a point on the circle, and explains the
    rays that pass it. Of the points where rays touch, the one is chosen that explains most, then
    the one that explains most of the rest, and so on.
    """
    own = lines.select(support.rows)
    basis = plane_basis(one.axes[0])
    starts = (own.centers - one.points[0]) @ basis.T
    rays = own.rays.mean(axis=1) @ basis.T
    sizes = np.linalg.norm(rays, axis=1)  # of a ray of length 1, seen along the axis
    rays /= sizes[:, None]
    reach = -np.einsum("ij,ij->i", starts, rays)
    away = (starts + reach[:, None] * rays)[:, None] - starts
    off = np.abs(away[..., 0] * rays[:, 1] - away[..., 1] * rays[:, 0])
    explains = off * own.focals * sizes < SAME_PX * reach
    left = np.ones(len(reach), bool)
    count = 0
    while left.sum() > (1 - EXPLAINED_SHARE) * len(left):
        left &= ~explains[np.argmax((explains & left).sum(axis=1))]
        count += 1
    return count
