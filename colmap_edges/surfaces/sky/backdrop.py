"""Regions of a far backdrop: their colours depend on nothing but the viewing direction.

What is far away looks the same from all places, apart from the exposure of each image. The walls of
a room do not: the same direction meets another place of them, or another wall, from each camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, Picture
from colmap_edges.core.view import View
from colmap_edges.images.background import MAX_DEVIATION, MIN_VIEWS_RATIO
from colmap_edges.surfaces.sky.infinity import largest
from colmap_edges.surfaces.sky.regions import Regions, rays_of

NUM_SAMPLES = 100_000  # pixels of all regions whose colours are compared
NUM_ROUNDS = 12  # of reweighting; the first ones still follow regions that are no backdrop
AGREEING = 0.8  # minimum share of a region's samples that agree
# Minimum share of the samples in agreeing regions: 0.6 to 1 before backdrops, at most 0.35 of
# facades with their sky, below 0.2 of rooms.
MIN_SHARE = 0.5
# Maximum length of the mean direction: cameras go round bodies before a backdrop. One wall, seen
# from one side only, may look the same from all places, too.
MAX_MEAN_LENGTH = 0.8
WINDOW = 5  # pixels along the side of the square over which the deviations of pixels are averaged
OTHER_LEVELS = 6.0  # minimum of this deviation of what is no backdrop, with its sign
# Maximum of the mean, in levels: 99 % of the pixels of true backdrops have at most 1, while 90 % of
# those of a dark body before a dark backdrop have 2.2 or more.
MAX_MEAN_DEVIATION = 1.5


class Colors(NamedTuple):
    """Logarithms of a backdrop's levels, by direction.

    Attributes:
        coefficients: (k, 3) of the terms of `harmonics`.
        factors: (V, 3) of each view; NaN of views without samples.
    """

    coefficients: FloatArray
    factors: FloatArray


class Backdrop(NamedTuple):
    """A backdrop in the small pictures of V views.

    Attributes:
        shown: (V,) (h, w) pixels that show it.
        others: (V,) (h, w) pixels of other colours.
    """

    shown: list[BoolArray]
    others: list[BoolArray]


def find_backdrop(views: Sequence[View], regions: Regions) -> Backdrop | None:
    """The backdrop that nearly all views show; None if there is none.

    Colours are modelled by smooth functions of the direction and a factor of each view. A region
    goes on over a body where its outline is faint and no point is near; the body's pixels do not
    agree with the model.

    Args:
        views: the V views.
        regions: R regions of them; those below structure are no backdrop.
    """
    owners, directions, levels = samples(views, regions)
    if not len(owners):
        return None
    off, colors = fitted(regions.views[owners], harmonics(directions), levels, len(views))
    chosen = agreeing_regions(views, regions, owners, directions, off)
    if not chosen.any():
        return None
    found = Backdrop([], [])
    for index, (view, inside) in enumerate(zip(views, regions.shown(chosen), strict=True)):
        shown, others = compared_pixels(view, regions.pictures[index], inside, colors, index)
        found.shown.append(shown)
        found.others.append(others)
    return found


def agreeing_regions(
    views: Sequence[View],
    regions: Regions,
    owners: IntArray,
    directions: FloatArray,
    off: FloatArray,
) -> BoolArray:
    """(R,) regions of which most (n,) samples deviate little from the model; or none.

    In views of an overexposed backdrop, a light face of a body may agree with the model by the
    view's factor. Most of what reaches the border of a view must agree, too.
    """
    seen_by, agree = regions.views[owners], off <= MAX_DEVIATION
    counts = np.bincount(owners, minlength=len(regions.views))
    found = np.bincount(owners, agree, minlength=len(counts)) > AGREEING * counts
    chosen = found[owners]
    shown = len(np.unique(seen_by[chosen])) >= MIN_VIEWS_RATIO * len(views)
    if chosen.mean() < MIN_SHARE or not shown:
        return np.zeros(len(found), bool)
    is_round = np.linalg.norm(directions[chosen].mean(axis=0)) <= MAX_MEAN_LENGTH
    outer = counts * regions.at_border
    at_border, agreeing = (
        np.bincount(regions.views, each, len(views)) for each in (outer, outer * found)
    )
    return found & is_round & (agreeing >= MIN_SHARE * at_border)[regions.views]


def compared_pixels(
    view: View, picture: Picture, inside: BoolArray, colors: Colors, index: int
) -> tuple[BoolArray, BoolArray]:
    """The pixels of a view around which colours agree with the model, and where they are others.

    Returns:
        (h, w) those `inside` that agree, and (h, w) all whose colours are others; none if the
        view's factor is unknown.
    """
    rays, size = rays_of(view, picture, np.arange(inside.size)), (WINDOW, WINDOW)
    model = np.exp(harmonics(rays) @ colors.coefficients + colors.factors[index])
    off = picture - model.reshape(picture.shape)
    sums = cv2.blur(np.where(inside[..., None], np.nan_to_num(off, nan=255), 0.0), size)
    counts = cv2.blur(inside.astype(np.float64), size)
    deviations = largest(sums.reshape(-1, 3)).reshape(inside.shape)
    agree = inside & (deviations <= MAX_MEAN_DEVIATION * counts)
    means = largest(cv2.blur(np.nan_to_num(off), size).reshape(-1, 3)).reshape(inside.shape)
    return np.asarray(agree), np.asarray(means > OTHER_LEVELS)


def samples(views: Sequence[View], regions: Regions) -> tuple[IntArray, FloatArray, FloatArray]:
    """Pixels of regions with nothing above them, view after view.

    Returns:
        (n,) regions, (n, 3) unit viewing rays and (n, 3) levels.
    """
    parts: list[tuple[IntArray, FloatArray, FloatArray]] = []
    step = max(1, sum(labels.size for labels in regions.labels) // NUM_SAMPLES)
    for index, view in enumerate(views):
        picture = regions.pictures[index]
        for region, pixels in zip(*regions.pixels(index), strict=True):
            if not regions.below[region]:
                chosen = pixels[step // 2 :: step]
                rays = rays_of(view, picture, chosen)
                kept = np.isfinite(rays).all(axis=1)
                levels = picture.reshape(-1, 3)[chosen[kept]].astype(np.float64)
                parts.append((np.full(len(levels), region), rays[kept], levels))
    nothing = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))
    owners, rays, levels = (np.concatenate(of) for of in zip(nothing, *parts, strict=True))
    return owners, rays, levels


def harmonics(directions: FloatArray) -> FloatArray:
    """(n, 15) polynomials of (n, 3) directions: of degree 3 on the sphere, without the constant."""
    x, y, z = np.ascontiguousarray(directions.T)
    second = [x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1]
    third = [(x * x - y * y) * z, (x * x - 3 * y * y) * x, (3 * x * x - y * y) * y]
    third += [x * y * z, (5 * z * z - 1) * x, (5 * z * z - 1) * y, (5 * z * z - 3) * z]
    return np.column_stack([x, y, z, *second, *third])


def fitted(
    seen_by: IntArray, design: FloatArray, levels: FloatArray, num_views: int
) -> tuple[FloatArray, Colors]:
    """The model of a backdrop's colours, and how far samples deviate from it.

    Logarithms of colours are fitted by iteratively reweighted least squares; subtracting the mean
    of each view takes its factor out of the equations.

    Args:
        seen_by: (n,) ascending views.
        design: (n, k) terms of the model.
        levels: (n, 3) colours.
        num_views: V.

    Returns:
        (n,) largest deviations of the three levels, and the model.
    """
    logs = np.log(np.maximum(levels, 2.0))
    level = levels.mean(axis=1) / 255  # a level is less of the logarithm where it is bright
    starts = np.flatnonzero(np.diff(seen_by, prepend=-1))
    numbers = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(seen_by)))
    values, weights = np.column_stack([design, logs]), np.ones(len(logs))
    terms, rest = slice(design.shape[1]), slice(design.shape[1], None)
    for _ in range(NUM_ROUNDS):
        weighted = weights[:, None] * values
        sums = np.add.reduceat(weighted, starts)
        means = sums / np.add.reduceat(weights, starts)[:, None]
        products = weighted[:, terms].T @ values - sums[:, terms].T @ means
        coefficients = np.linalg.lstsq(products[:, terms], products[:, rest], rcond=None)[0]
        constants = means[:, rest] - means[:, terms] @ coefficients
        off = largest(levels - np.exp(design @ coefficients + constants[numbers]))
        weights = (level / (1 + (off / MAX_DEVIATION) ** 2)) ** 2 + 1e-12
    factors = np.full((num_views, 3), np.nan)
    factors[seen_by[starts]] = constants
    return off, Colors(np.asarray(coefficients, np.float64), factors)
