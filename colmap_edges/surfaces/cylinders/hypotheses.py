"""Hypotheses of cylinders: pairs of outlines in two views, in whose middle planes the axis lies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, evenly_chosen
from colmap_edges.core.polylines import cross, unit
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.cylinders.lines import Lines
from colmap_edges.surfaces.round_evidence import MIN_ANGLE, MIN_ASPECT, MIN_WIDTH_PX

MIN_OVERLAP = 0.3  # minimum part of the shorter outline that is beside the longer one
MAX_LINES = 300  # maximum number of lines in a view, the longest ones
MAX_BASES = 200  # maximum number of views that are combined with others, evenly chosen
MAX_PAIRS = 100  # maximum number of pairs in a view, the longest ones
NUM_PARTNERS = 4  # number of other views with which a view is combined
NEAR_PX = 1.5  # maximum distance of outlines from those of a cylinder


class Cylinders(NamedTuple):
    """Cylinders of infinite length.

    Attributes:
        points: (H, 3) points on the axes.
        axes: (H, 3) unit directions.
        radii: (H,) radii, world units.
    """

    points: FloatArray
    axes: FloatArray
    radii: FloatArray


class Pairs(NamedTuple):
    """Pairs of lines of a view that may be both outlines of a cylinder.

    Attributes:
        rows: (P, 2) lines.
        normals: (P, 2, 3) unit normals of their planes, outwards.
        middles: (P, 3) unit normals of the planes in the middle, in which the axis lies.
        turns: (P, 2) maximum sines of the angles between planes and axis.
    """

    rows: IntArray
    normals: FloatArray
    middles: FloatArray
    turns: FloatArray


def pairs_of(lines: Lines, rows: IntArray) -> Pairs:
    """The pairs among the (n,) lines of one view."""
    rays, focal = lines.rays[rows], lines.focals[rows]
    planes = unit(np.cross(rays[:, 0], rays[:, 1]))
    middle = unit(rays.sum(axis=1))
    along = unit(rays[:, 1] - rays[:, 0])
    first, second = np.triu_indices(len(rows), 1)
    gap = np.abs(np.einsum("ij,ij->i", planes[first], middle[second])) * focal[first]
    short = np.minimum(lines.lengths[rows[first]], lines.lengths[rows[second]])
    ends = np.einsum("ikj,ij->ik", rays[second], along[first]) * focal[first][:, None]
    own = np.einsum("ikj,ij->ik", rays[first], along[first]) * focal[first][:, None]
    beside = np.minimum(ends.max(axis=1), own.max(axis=1)) - np.maximum(
        ends.min(axis=1), own.min(axis=1)
    )
    kept = np.flatnonzero(
        (gap > MIN_WIDTH_PX) & (short > MIN_ASPECT * gap) & (beside > MIN_OVERLAP * short)
    )
    kept = np.sort(kept[np.argsort(-short[kept], kind="stable")[:MAX_PAIRS]])
    one, other = first[kept], second[kept]
    outwards = np.stack(
        [
            planes[a] * -np.sign(np.einsum("ij,ij->i", planes[a], middle[b]))[:, None]
            for a, b in ((one, other), (other, one))
        ],
        axis=1,
    )
    both = np.column_stack([rows[one], rows[other]])
    middles = unit(outwards[:, 0] - outwards[:, 1])
    return Pairs(both, outwards, middles, 2 * NEAR_PX / lines.lengths[both])


def combined(lines: Lines, one: Pairs, other: Pairs) -> Cylinders:
    """The cylinders of which a pair in one view and a pair in another are the outlines."""
    # A little beyond the limit, too, since the kernel rounds otherwise.
    near = _kernels.pairs_of_one_radius(
        *as_arrays(lines, one), *as_arrays(lines, other), MIN_ANGLE, 1.01 * NEAR_PX
    )
    a, b = np.ascontiguousarray(near.T)
    meeting = cross(one.middles[a], other.middles[b])
    sines = np.linalg.norm(meeting, axis=1)
    axes = meeting / sines[:, None]
    centers = lines.centers[one.rows[a, 0]], lines.centers[other.rows[b, 0]]
    heights = [
        np.einsum("ij,ij->i", middles, center)
        for middles, center in zip((one.middles[a], other.middles[b]), centers, strict=True)
    ]
    # The point of the axis nearest to the first view's centre: three planes meet there.
    third = np.einsum("ij,ij->i", axes, centers[0])
    points = (
        heights[0][:, None] * cross(other.middles[b], axes)
        + heights[1][:, None] * cross(axes, one.middles[a])
        + third[:, None] * meeting
    ) / sines[:, None]
    rows = np.column_stack([one.rows[a], other.rows[b]])
    distances, places, depths = tangencies(lines, rows, points, axes)
    low, high = places.min(axis=2), places.max(axis=2)
    shared = (high.min(axis=1) - low.max(axis=1)) > MIN_OVERLAP * (high - low).min(axis=1)
    radii = np.abs(distances).mean(axis=(1, 2))
    off = (np.abs(distances) - radii[:, None, None]) * lines.focals[rows][:, :, None] / depths
    good = shared & (np.abs(off) < NEAR_PX).all(axis=(1, 2)) & (depths > 0).all(axis=(1, 2))
    return Cylinders(points[good], axes[good], radii[good])


def as_arrays(lines: Lines, pairs: Pairs) -> tuple[Any, ...]:
    """The pairs of a view, of which there is one at least, as arguments of the kernel."""
    first = pairs.rows[0, 0]
    view = lines.centers[first], lines.focals[first]
    return *view, pairs.normals, pairs.middles, pairs.turns, lines.rays[pairs.rows]


def tangencies(
    lines: Lines, rows: IntArray, points: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How the rays to both ends of lines pass axes.

    Args:
        lines: all lines.
        rows: (H, n) lines.
        points: (H, 3) points on the axes.
        axes: (H, 3) unit directions.

    Returns:
        (H, n, 2) signed distances of the rays from the axes, places along the axes, and depths
        along the rays.
    """
    rays = lines.rays[rows]
    aside = cross(axes[:, None, None], rays)
    squares = (aside**2).sum(axis=3) + 1e-300
    away = points[:, None] - lines.centers[rows]
    across = away - np.einsum("hnj,hj->hn", away, axes)[..., None] * axes[:, None]
    distances = np.einsum("hnej,hnj->hne", aside, away) / np.sqrt(squares)
    depths = np.einsum("hnej,hnj->hne", rays, across) / squares
    slopes = np.einsum("hnej,hj->hne", rays, axes)
    places = depths * slopes - np.einsum("hnj,hj->hn", away, axes)[..., None]
    return distances, places, depths


def find_hypotheses(lines: Lines, free: Sequence[IntArray]) -> tuple[Cylinders, IntArray]:
    """All cylinders whose four outlines two views show, and the first of these views.

    Args:
        lines: all lines.
        free: (V,) the lines of each view that are no fixed edges.
    """
    rows = [longest(lines, own) for own in free]
    pairs = [pairs_of(lines, own) for own in rows]
    seen = np.flatnonzero([len(of.rows) for of in pairs])
    found, views = [Cylinders(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))], [0]
    for i in evenly_chosen(len(seen), MAX_BASES).tolist():
        for other in partners(lines, rows, seen[i], seen[i + 1 :]).tolist():
            found.append(combined(lines, pairs[seen[i]], pairs[other]))
            views.append(seen[i])
    counts = [len(of.radii) for of in found]
    together = Cylinders(*(np.concatenate(part) for part in zip(*found, strict=True)))
    return together, np.repeat(np.array(views, np.int64), counts)


def longest(lines: Lines, rows: IntArray) -> IntArray:
    """The `MAX_LINES` longest of the (n,) lines of a view, in order."""
    return np.sort(rows[np.argsort(-lines.lengths[rows], kind="stable")[:MAX_LINES]])


def partners(lines: Lines, rows: list[IntArray], view: int, others: IntArray) -> IntArray:
    """At most `NUM_PARTNERS` of other views, evenly chosen by their distance."""
    centers = np.array([lines.centers[rows[other][0]] for other in others]).reshape(-1, 3)
    order = np.argsort(np.linalg.norm(centers - lines.centers[rows[view][0]], axis=1))
    found: IntArray = others[order[evenly_chosen(len(order), NUM_PARTNERS)]]
    return found
