"""Regions at infinity around the sky, such as haze: they move by the rotation of views alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, evenly_chosen
from colmap_edges.core.view import View
from colmap_edges.surfaces.sky.regions import Regions, rays_of, small_pixels

MIN_COMMON = 20  # minimum number of common points that tell the exposures of two views
MIN_MATCHES = 0.3  # minimum number of agreeing views of a pixel, in the mean of a region

NUM_SAMPLES = 100  # number of pixels of a region that are looked up in other views
MAX_CHANGE = 0.04  # maximum difference of logarithms of the colours of one place
MAX_EXPOSURE = 0.15  # maximum error of the exposure that common points tell
DARKEST = 8.0  # added to levels: the noise of dark pixels is no large change
LIMITS = (0.7, 0.5, 0.3, 0.15)  # maximum shares of contradictions, in turn
# Minimum share of sky among the regions that other views show in the directions of the sky: 0.4 to
# 1 of true skies, where walls and roofs hide it, 0 to 0.2 of bluish walls.
MIN_SKY_SHARE = 0.3
MIN_SEEN = 0.05  # minimum share of sky in the directions of one region: 0 of a blue gable
ADJACENT_PX = 8  # maximum width of the border between adjacent regions


class Matches(NamedTuple):
    """Pixels of R regions that other views see in their regions if they are at infinity.

    Attributes:
        sampled: (R,) number of pixels of each region that were looked up.
        sources: (m,) region of each pixel.
        targets: (m,) region of the other view in which it lies.
        agree: (m,) whether the colours are the same.
    """

    sampled: IntArray
    sources: IntArray
    targets: IntArray
    agree: BoolArray


def confirmed(matches: Matches, is_sky: BoolArray) -> BoolArray:
    """(R,) whether other views see (R,) sky, too, in the directions of regions."""
    return np.asarray(sum(counts_of(matches, is_sky)) >= MIN_MATCHES * matches.sampled)


def are_contradicted(matches: Matches, is_sky: BoolArray) -> BoolArray:
    """(R,) whether nearly all that other views see in the directions of regions is no sky."""
    looked_up = np.bincount(matches.sources, minlength=len(is_sky))
    return np.asarray(sum(counts_of(matches, is_sky)) < MIN_SEEN * looked_up)


def moves_as_sky(matches: Matches, is_sky: BoolArray) -> bool:
    """Whether other views see (R,) sky in its directions rather than other regions.

    A blue wall is elsewhere in views from other places.
    """
    seen = is_sky[matches.targets[is_sky[matches.sources]]]
    return bool(seen.any() and seen.mean() >= MIN_SKY_SHARE)


def spread(matches: Matches, regions: Regions, is_sky: BoolArray) -> BoolArray:
    """(R,) whether regions are sky, or at infinity next to it.

    Haze and far hills have no points either. Views that look in one direction see the same colour
    there, or something nearer. What is near contradicts that sooner or later, since it moves before
    the sky; at the latest what is found does: a roof that agrees with itself alone in other views.

    Args:
        matches: their matches in neighbouring views.
        regions: the R regions.
        is_sky: (R,) whether they are sky.
    """
    # What has structure above it may be a wall that hides the sky.
    counted = ~regions.below[matches.targets] | regions.below[matches.sources] | matches.agree
    matches = matches._replace(
        sources=matches.sources[counted],
        targets=matches.targets[counted],
        agree=matches.agree[counted],
    )
    far = np.ones(len(is_sky), bool)
    for limit in LIMITS:
        far = is_sky | (far & are_consistent(matches, far, limit))
    far = is_sky | (far & (counts_of(matches, far)[1] >= MIN_MATCHES * matches.sampled))
    beside = np.concatenate(
        [adjacent_pairs(*each) for each in zip(regions.labels, regions.near, strict=True)]
    )
    at_border = regions.at_border
    found, count = is_sky, -1
    while found.sum() > count:
        count = int(found.sum())
        reached = at_border & (counts_of(matches, found)[1] >= MIN_MATCHES * matches.sampled)
        reached[beside[found[beside[:, 1]], 0]] = True
        found = found | (far & reached)
    count = -1
    while found.sum() != count:  # what agreed with a region that is left out may go, too
        count = int(found.sum())
        found = is_sky | (found & are_consistent(matches, found, LIMITS[-1]))
    return found


def are_consistent(matches: Matches, of_targets: BoolArray, limit: float) -> BoolArray:
    """(R,) whether at most a share `limit` of the matches with some of the regions disagrees."""
    disagreeing, agreeing = counts_of(matches, of_targets)
    return np.asarray(disagreeing <= limit * (disagreeing + agreeing))


def counts_of(matches: Matches, of_targets: BoolArray) -> tuple[IntArray, IntArray]:
    """(R,) numbers of disagreeing and of agreeing matches with some of the regions."""
    chosen = of_targets[matches.targets]
    disagreeing, agreeing = (
        np.bincount(matches.sources[chosen & (matches.agree == same)], minlength=len(of_targets))
        for same in (False, True)
    )
    return disagreeing, agreeing


def match_regions(
    views: Sequence[View],
    regions: Regions,
    points: FloatArray,
    observed: Sequence[IntArray],
    neighbors: Sequence[IntArray],
) -> Matches:
    """Look up pixels of regions in neighbouring views, as if they were at infinity.

    Args:
        views: the V views.
        regions: their R regions.
        points: (N, 3) points of surfaces, whose colours tell the exposures.
        observed: (V,) indices of the points that each view observes.
        neighbors: (V,) views that each view is compared with.
    """
    colors = [np.log(picture + DARKEST).reshape(-1, 3) for picture in regions.pictures]
    seen = []
    for view, picture, own in zip(views, regions.pictures, observed, strict=True):
        inside, there = small_pixels(view, picture, points[own])
        seen.append((own[inside], there))
    sampled = np.zeros(len(regions.views), np.int64)
    none = np.zeros(0, np.int64)
    found = [(none, none, none > 0)]
    is_common = np.zeros(len(points), bool)
    for index, view in enumerate(views):
        owners, pixels = samples_of(regions, index)
        rays = rays_of(view, regions.pictures[index], pixels)
        usable = np.isfinite(rays).all(axis=1)
        owners, pixels, rays = owners[usable], pixels[usable], rays[usable]
        sampled += np.bincount(owners, minlength=len(sampled))
        for other in neighbors[index].tolist():
            # A point at infinity is its direction; the centre does not matter.
            picture = regions.pictures[other]
            inside, there = small_pixels(views[other], picture, rays + views[other].center)
            targets = regions.labels[other].ravel()[there]
            common = []
            for v, w in ((index, other), (other, index)):
                is_common[observed[w]] = True
                common.append(colors[v][seen[v][1][is_common[seen[v][0]]]])
                is_common[observed[w]] = False
            change = colors[index][pixels[inside]] - colors[other][there]
            change -= exposure(*common)
            alike = largest(change) <= MAX_EXPOSURE
            if alike.sum() >= MIN_COMMON:
                change -= np.median(change[alike], axis=0)
            agree = largest(change) <= MAX_CHANGE
            kept = targets >= 0
            found.append((owners[inside][kept], targets[kept], agree[kept]))
    return Matches(sampled, *(np.concatenate(parts) for parts in zip(*found, strict=True)))


def largest(changes: FloatArray) -> FloatArray:
    """(n,) largest absolute values of (n, 3) rows; column by column, which is much faster."""
    red, green, blue = np.abs(changes).T
    return np.asarray(np.maximum(np.maximum(red, green), blue))


def exposure(one: FloatArray, other: FloatArray) -> FloatArray:
    """(3,) difference of logarithmic colours (n, 3) that two views see of common points."""
    if min(len(one), len(other)) < MIN_COMMON:
        return np.zeros(3)
    # Medians along rows in memory are much faster.
    first, second = (np.median(np.ascontiguousarray(of.T), axis=1) for of in (one, other))
    return np.asarray(first - second)


def samples_of(regions: Regions, view: int) -> tuple[IntArray, IntArray]:
    """(n,) regions of a view, and (n,) pixels spread over each."""
    own, pixels = regions.pixels(view)
    spread = [inside[evenly_chosen(len(inside), NUM_SAMPLES)] for inside in pixels]
    owners = np.repeat(own, [len(inside) for inside in spread])
    return owners, np.concatenate([np.zeros(0, np.int64), *spread])


def adjacent_pairs(labels: Int32Array, near: BoolArray) -> Int32Array:
    """(n, 2) pairs, both ways, of regions with a narrow border without structure between them."""
    pairs = [np.zeros((0, 2), np.int32)]
    for one, between in ((labels, near), (labels.T, near.T)):
        count = len(one) - ADJACENT_PX
        if count > 0:
            free = ~np.any([between[i : i + count] for i in range(ADJACENT_PX + 1)], axis=0)
            pairs.append(np.stack([one[:count][free], one[-count:][free]], axis=-1))
    found = np.concatenate(pairs)
    found = np.unique(found[(found >= 0).all(axis=1) & (found[:, 0] != found[:, 1])], axis=0)
    return np.concatenate([found, found[:, ::-1]])
