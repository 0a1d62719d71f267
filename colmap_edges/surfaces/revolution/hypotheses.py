"""Hypotheses of axes: of circles among the edges, and of mirrored outlines in two views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, blocks
from colmap_edges.core.curves3d import ARC, CIRCLE, Curves3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.surfaces.revolution.meridians import MIN_RISE, MIN_SINE, Axis, touched
from colmap_edges.surfaces.revolution.samples import Samples
from colmap_edges.surfaces.round_evidence import MIN_ANGLE, MIN_WIDTH_PX

MAX_CIRCLES = 60  # maximum number of circles, the longest ones
CIRCLE_REACH = 4.0  # radius of the ball around a circle, relative to the circle's
MAX_BASES = 12  # number of views in which mirrored outlines are sought, evenly chosen
NUM_PARTNERS = 3  # number of other views with which each is combined
MAX_SAMPLES = 250  # maximum number of samples of a view, on the longest chains
MAX_PAIRS = 2000  # maximum number of mirrored pairs of a view
NUM_TRIED = 200  # number of pairs whose planes are tried
NUM_PLANES = 8  # maximum number of planes of a view
NUM_KEPT = 20  # number of pairs of a plane whose profiles are compared
MIN_PAIRS = 6  # minimum number of pairs of a plane
MAX_TURN = np.cos(np.radians(4.0))  # between normals of a pair, one of them mirrored
MIN_FACING = 0.2  # minimum cosine between normals and the direction from one to the other
MIDDLE_PX = 2.0  # maximum distance of the middle of a pair from its plane
MAX_TILT = np.cos(np.radians(5.0))  # between the direction of a pair and the plane's normal
# Maximum distances of profiles of two views: pixels along and across the axis, and angle.
AGREE = (8.0, 4.0, 0.2)
MAX_USES = 2  # maximum number of axes of the same samples
BLOCK = 64  # pairs of profiles that are compared at once, in the cache
MAX_AXES = 40  # maximum number of axes of mirrored outlines


class Planes(NamedTuple):
    """Planes through a view's centre in which outlines are mirrored.

    Attributes:
        normals: (p, 3) unit normals.
        rows: (p, 2 * NUM_KEPT) samples of pairs, some of them repeated.
    """

    normals: FloatArray
    rows: IntArray


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


def axes_of_mirrored(samples: Samples, views: Sequence[View], random_seed: int) -> list[Axis]:
    """The axes in which planes of symmetry of two views meet, with profiles that agree.

    Args:
        samples: samples of the views' chains.
        views: all views.
        random_seed: of the pairs that are tried.
    """
    rng = np.random.default_rng(random_seed)
    rows_of = rows_by_view(samples.views, len(views))
    bases = np.unique(np.linspace(0, len(views) - 1, min(len(views), MAX_BASES)).astype(int))
    planes = [planes_of(samples, rows_of[base], rng) for base in bases]
    centers, focals = centers_of([views[base] for base in bases])
    normals, rows = [np.zeros((0, 2, 3))], [np.zeros((0, 2, 2 * NUM_KEPT), np.int64)]
    for i, own in enumerate(planes[:-1]):
        order = np.argsort(np.linalg.norm(centers[i + 1 :] - centers[i], axis=1))
        chosen = np.unique(np.linspace(0, len(order) - 1, NUM_PARTNERS).astype(int))
        for other in (planes[j] for j in (i + 1 + order[chosen]).tolist()):
            a, b = (part.ravel() for part in np.indices((len(own.normals), len(other.normals))))
            normals.append(np.stack([own.normals[a], other.normals[b]], axis=1))
            rows.append(np.stack([own.rows[a], other.rows[b]], axis=1))
    pairs = np.concatenate(normals), np.concatenate(rows)
    return axes_of_planes(samples, *pairs, centers, focals)


def planes_of(samples: Samples, rows: IntArray, rng: np.random.Generator) -> Planes:
    """The planes through a view's centre in which many of its (n,) samples are mirrored."""
    rows = np.sort(rows[np.argsort(-samples.lengths[rows], kind="stable")[:MAX_SAMPLES]])
    rays, normals = samples.rays[rows], samples.normals[rows]
    focal = samples.focals[rows[0]] if len(rows) else 1.0
    first, second = np.triu_indices(len(rows), 1)
    gaps = rays[first] - rays[second]
    widths = np.sqrt(np.einsum("ij,ij->i", gaps, gaps))
    wide = np.flatnonzero(widths * focal > MIN_WIDTH_PX)
    first, second = first[wide], second[wide]
    across = gaps[wide] / widths[wide, None]
    facing = np.einsum("ij,ij->i", normals[first], across)
    mirrored = normals[first] - 2 * facing[:, None] * across
    alike = np.abs(np.einsum("ij,ij->i", mirrored, normals[second]))
    good = np.flatnonzero((alike > MAX_TURN) & (np.abs(facing) > MIN_FACING))
    good = rng.permutation(good)[:MAX_PAIRS]
    first, second, across = first[good], second[good], across[good]
    middles = unit(rays[first] + rays[second])
    tried = across[:NUM_TRIED]
    products = tried @ middles.T  # in place: new arrays of this size take as long as the products
    fits = np.abs(products, out=products) < MIDDLE_PX / focal
    np.matmul(tried, across.T, out=products)
    fits &= np.abs(products, out=products) > MAX_TILT
    left = np.ones(len(good), bool)
    found: list[FloatArray] = []
    kept: list[IntArray] = []
    while len(good) and len(found) < NUM_PLANES:
        counts = np.count_nonzero(fits & left, axis=1)
        best = int(np.argmax(counts))
        if counts[best] < MIN_PAIRS:
            break
        own = np.flatnonzero(fits[best] & left)
        normal = normal_of(tried[best], middles[own] * focal, across[own])
        near = np.abs(middles @ normal) * focal < 2 * MIDDLE_PX
        left &= ~(near & (np.abs(across @ normal) > MAX_TILT)) & ~fits[best]
        own = np.resize(own, NUM_KEPT)
        found.append(normal)
        kept.append(rows[np.concatenate([first[own], second[own]])])
    return Planes(
        np.array(found).reshape(-1, 3), np.array(kept, np.int64).reshape(-1, 2 * NUM_KEPT)
    )


def normal_of(start: FloatArray, middles: FloatArray, across: FloatArray) -> FloatArray:
    """The normal of the plane through (n, 3) middles of pairs, nearly along their (n, 3) gaps."""
    mean = (across * np.sign(across @ start)[:, None]).sum(axis=0)
    mean /= np.linalg.norm(mean)
    # A direction is known to a few degrees only.
    held = len(across) * (MIDDLE_PX / np.sqrt(1 - MAX_TILT**2)) ** 2
    matrix = middles.T @ middles + held * (np.eye(3) - np.outer(mean, mean))
    return np.asarray(np.linalg.eigh(matrix)[1][:, 0])


def axes_of_planes(
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
    parts = (*np.moveaxis(profiles, 3, 0), angles)
    for block in blocks(len(found), BLOCK):
        near = np.ones((1, 1, 1), bool)
        for part, limit in zip(parts, AGREE, strict=True):
            with np.errstate(invalid="ignore"):
                one, other = part[block, 0, :, None], part[block, 1, None, :]
                near = near & (np.abs(one - other) < limit)
        found[block] = [np.minimum(*(of.any(axis=k).sum() for k in range(2))) for of in near]
    return found
