"""Hypotheses of axes: of circles among the edges, and of mirrored outlines in two views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, blocks, evenly_chosen
from colmap_edges.core.curves3d import ARC, CIRCLE, Curves3D
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.surfaces.revolution.meridians import MIN_RISE, MIN_SINE, Axis, touched
from colmap_edges.surfaces.revolution.mirrored import (
    MIN_PAIRS,
    NUM_KEPT,
    Planes,
    planes_of,
    upright_planes,
)
from colmap_edges.surfaces.revolution.samples import Samples
from colmap_edges.surfaces.round_evidence import MIN_ANGLE

MAX_CIRCLES = 60  # maximum number of circles, the longest ones
CIRCLE_REACH = 4.0  # radius of the ball around a circle, relative to the circle's
MAX_BASES = 12  # number of views in which mirrored outlines are sought, evenly chosen
NUM_PARTNERS = 3  # number of other views with which each is combined
# Maximum distances of profiles of two views: pixels along and across the axis, and angle.
AGREE = (8.0, 4.0, 0.2)
MAX_USES = 2  # maximum number of axes of the same samples
BLOCK = 64  # pairs of profiles that are compared at once, in the cache
MAX_AXES = 40  # maximum number of axes of mirrored outlines


def axes_of_circles(curves: Curves3D, views: Sequence[View]) -> list[Axis]:
    """The axes of the longest circles and arcs."""
    rows = np.flatnonzero((curves.kinds == ARC) | (curves.kinds == CIRCLE))
    rows = rows[np.argsort(-curves.lengths()[rows], kind="stable")[:MAX_CIRCLES]]
    points, reach = curves.frames[rows, 0], CIRCLE_REACH * curves.radii[rows, 0]
    centers, focals = centers_of(views)
    pixels = np.median(np.linalg.norm(points[:, None] - centers, axis=2) / focals, axis=1)
    balls = zip(points, curves.normals[rows], reach, pixels, strict=True)
    return [Axis(a, b, float(c), float(d)) for a, b, c, d in balls]


def centers_of(views: Sequence[View]) -> tuple[FloatArray, FloatArray]:
    """(V, 3) centres and (V,) focal lengths of views."""
    return np.array([view.center for view in views]), np.array([view.focal_px for view in views])


def axes_of_mirrored(
    samples: Samples, views: Sequence[View], upward: FloatArray, random_seed: int
) -> list[Axis]:
    """The axes in which planes of symmetry of two views meet, with profiles that agree.

    Args:
        samples: samples of the views' chains.
        views: all views.
        upward: (3,) unit direction in which most bodies stand.
        random_seed: of the pairs of samples that are tried in any direction.
    """
    rng = np.random.default_rng(random_seed)
    rows_of = rows_by_view(samples.views, len(views))
    bases = evenly_chosen(len(views), MAX_BASES)
    chosen = [views[base] for base in bases]
    upright = [upright_planes(samples, rows_of[base], upward) for base in bases]
    found = axes_of_planes(samples, upright, chosen)
    leaning = [planes_of(samples, rows_of[base], rng) for base in bases]
    return found + axes_of_planes(samples, leaning, chosen)


def axes_of_planes(samples: Samples, planes: Sequence[Planes], views: Sequence[View]) -> list[Axis]:
    """The axes in which the planes of each view meet those of some other views."""
    centers, focals = centers_of(views)
    normals, rows = [np.zeros((0, 2, 3))], [np.zeros((0, 2, 2 * NUM_KEPT), np.int64)]
    for i, own in enumerate(planes[:-1]):
        order = np.argsort(np.linalg.norm(centers[i + 1 :] - centers[i], axis=1))
        partners = evenly_chosen(len(order), NUM_PARTNERS)
        for other in (planes[j] for j in (i + 1 + order[partners]).tolist()):
            a, b = (part.ravel() for part in np.indices((len(own.normals), len(other.normals))))
            normals.append(np.stack([own.normals[a], other.normals[b]], axis=1))
            rows.append(np.stack([own.rows[a], other.rows[b]], axis=1))
    pairs = np.concatenate(normals), np.concatenate(rows)
    return axes_of_pairs(samples, *pairs, centers, focals)


def axes_of_pairs(
    samples: Samples,
    normals: FloatArray,
    rows: IntArray,
    centers: FloatArray,
    focals: FloatArray,
) -> list[Axis]:
    """The axes in which pairs of planes meet, those first on which most samples agree.

    Args:
        samples: all samples.
        normals: (K, 2, 3) unit normals of planes of two views.
        rows: (K, 2, n) their samples.
        centers: (V, 3) centres of the views.
        focals: (V,) their focal lengths.
    """
    directions = np.cross(normals[:, 0], normals[:, 1])
    sines = np.linalg.norm(directions, axis=1)
    steep = np.flatnonzero(sines > MIN_ANGLE)
    normals, rows = normals[steep], rows[steep]
    directions = directions[steep] / sines[steep, None]
    starts = samples.centers[rows]
    own = np.concatenate([normals, directions[:, None]], axis=1)
    through = np.concatenate([starts[:, :, 0], starts[:, :1, 0]], axis=1)
    heights = np.einsum("kij,kij->ki", own, through)
    points = np.linalg.solve(own, heights[..., None])[..., 0]
    apart = np.linalg.norm(points[:, None] - centers, axis=2) / focals
    pixels = np.median(apart, axis=1)
    there = touched(
        samples.rays[rows],
        samples.normals[rows],
        starts - points[:, None, None],
        directions[:, None, None],
    )
    with np.errstate(invalid="ignore"):
        good = (there.depths > 0) & (there.sines > MIN_SINE) & (there.rises > MIN_RISE)
    profiles = np.stack([there.places, there.radii], axis=3) / pixels[:, None, None, None]
    profiles[~good] = np.nan
    angles = np.where(good, np.arctan2(there.slopes, there.rises), np.nan)
    counts = common(profiles, angles)
    best = different(np.concatenate([rows[:, 0], rows[:, 1]], axis=1), counts, len(samples.views))
    middles = np.nanmedian(profiles[best, :, :, 0], axis=(1, 2))
    places = profiles[best] - middles[:, None, None, None] * [1, 0]
    reach = 2 * np.nanquantile(np.hypot(places[..., 0], places[..., 1]), 0.9, axis=(1, 2))
    points = points[best] + (middles * pixels[best])[:, None] * directions[best]
    balls = zip(points, directions[best], reach * pixels[best], pixels[best], strict=True)
    return [Axis(a, b, float(c), float(d)) for a, b, c, d in balls]


def different(rows: IntArray, counts: IntArray, num_samples: int) -> IntArray:
    """The best of K axes, of which (K, n) samples agree in number (K,), few with the same samples.

    A ball has an axis in each direction, and would leave no place for other bodies.
    """
    uses = np.zeros(num_samples, np.int64)
    best: list[int] = []
    for k in np.argsort(-counts, kind="stable").tolist():
        if counts[k] < MIN_PAIRS or len(best) == MAX_AXES:
            break
        if np.median(uses[rows[k]]) < MAX_USES:
            uses[np.unique(rows[k])] += 1
            best.append(k)
    return np.array(best, np.int64)


def common(profiles: FloatArray, angles: FloatArray) -> IntArray:
    """(K,) how many points of two profiles agree; (K, 2, n, 2) points, (K, 2, n) their angles."""
    found = np.zeros(len(profiles), np.int64)
    parts = np.concatenate([profiles, angles[..., None]], axis=3)
    overlapping = np.flatnonzero(may_agree(parts))
    for block in blocks(len(overlapping), BLOCK):
        rows = overlapping[block]
        near = np.ones((1, 1, 1), bool)
        for part, limit in zip(np.moveaxis(parts[rows], 3, 0), AGREE, strict=True):
            with np.errstate(invalid="ignore"):
                near = near & (np.abs(part[:, 0, :, None] - part[:, 1, None, :]) < limit)
        found[rows] = np.minimum(*(near.any(axis=k).sum(axis=1) for k in (1, 2)))
    return found


def may_agree(parts: FloatArray) -> BoolArray:
    """(K,) whether enough of the (K, 2, n, 3) points of two profiles lie in each other's range."""
    lowest = np.fmin.reduce(parts, axis=2)[:, ::-1, None] - AGREE
    highest = np.fmax.reduce(parts, axis=2)[:, ::-1, None] + AGREE
    with np.errstate(invalid="ignore"):
        inside = ((parts > lowest) & (parts < highest)).all(axis=3)
    return np.asarray((inside.sum(axis=2) >= MIN_PAIRS).all(axis=1))
