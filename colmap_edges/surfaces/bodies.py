"""Bodies before a background: what views see of them, and whether a background is believed."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View, cells_seen
from colmap_edges.images.background import BackgroundMask, BackgroundRays, background_rays
from colmap_edges.images.files import square

logger = logging.getLogger(__name__)

# Maximum share of edge points that project onto the background: 0.03 to 0.3 % for true backdrops,
# 1.7 % and more for black frames around photographs and fisheye images.
MAX_CONTRADICTED = 0.01
# ... in a single view: 0 to 2.4 % for true backdrops, 3 to 69 % where a face of a body has the
# backdrop's colour.
MAX_CONTRADICTED_IN_VIEW = 0.03
NUM_SAMPLES = 4000  # number of edge points checked
NUM_VIEWS = 40  # number of views, spread around, that test for foreground


class Body(NamedTuple):
    """Foreground of a view as a mask (h, w), possibly at reduced resolution."""

    view: View
    mask: BoolArray

    def at(self, points: FloatArray) -> tuple[IntArray, BoolArray]:
        """(K,) indices of the (N, 3) points in the image, (K,) whether in the foreground."""
        seen, rows, columns = cells_seen(self.view, points, self.mask.shape)
        return seen, self.mask[rows, columns]

    def holds(self, points: FloatArray) -> BoolArray:
        """(N,) false for (N, 3) points that project to the background.

        True for points that project to the foreground or outside the image.
        """
        held = np.ones(len(points), bool)
        seen, is_body = self.at(points)
        held[seen] = is_body
        return held

    def dilated(self) -> Body:
        """The mask dilated by a pixel."""
        return Body(self.view, cv2.dilate(self.mask.astype(np.uint8), square(1)) > 0)


def find_background(
    model: Model, background_masks: Sequence[BackgroundMask], are_masks: bool, edges: Edges3D
) -> BackgroundRays | None:
    """Find background rays; None if no reliable background is visible.

    Args:
        model: the V views, and the SfM points, used if there are no edges.
        background_masks: (V,) background of their images.
        are_masks: whether these are masks of the user, all of which are trusted.
        edges: the 3D edges.
    """
    rays = background_rays(model.views, background_masks, are_masks)
    if rays is None:
        return None
    if not any(mask.body_pixels[0] for mask in background_masks):
        logger.warning(
            "masks_are_background is 1, but masks hide all of every image; the mesh is made "
            "without them; invert them if they are the other way round: black hides"
        )
        return None
    known = edges.points if edges.num_points else model.points3D_xyz
    if not are_masks and is_contradicted(model.views, background_masks, known):
        return None  # colours of backdrops are compared by direction then, see `find_sky`
    bodies = spread_bodies(model.views, background_masks, known)
    contradicted = contradicted_share(bodies, known)
    if contradicted > MAX_CONTRADICTED:
        if not are_masks:
            return None  # probably a frame around the images
        logger.warning(
            "masks_are_background is 1, but masks hide %.1f %% of the 3D points that are in an "
            "image; it is meant for masks that hide nothing but the background",
            100 * contradicted,
        )
    return rays


def spread_bodies(
    views: Sequence[View], background_masks: Sequence[BackgroundMask], known: FloatArray
) -> list[Body]:
    """Foregrounds of `NUM_VIEWS` views, spread around (N, 3) points, in the order of the views."""
    seen = [i for i, background_mask in enumerate(background_masks) if background_mask.is_seen]
    center = known.mean(axis=0) if len(known) else np.zeros(3)
    away = np.array([views[i].center for i in seen]) - center
    chosen = [seen[k] for k in np.sort(spread(away, NUM_VIEWS))]
    return [Body(views[i], background_masks[i].body()) for i in chosen]


def is_contradicted(
    views: Sequence[View], background_masks: Sequence[BackgroundMask], known: FloatArray
) -> bool:
    """Whether many of (N, 3) points lie on the background of a view.

    A face of a body, in the light or in the dark, has the backdrop's colour there.
    """
    return any(
        contradicted_share([Body(view, mask.body())], known) > MAX_CONTRADICTED_IN_VIEW
        for view, mask in zip(views, background_masks, strict=True)
        if mask.is_seen
    )


def contradicted_share(bodies: Sequence[Body], known: FloatArray) -> float:
    """Share of the projections of (N, 3) points of bodies that lie on the background."""
    points = known[:: max(1, len(known) // NUM_SAMPLES)]
    hidden = total = 0
    for body in bodies:
        _, is_body = body.dilated().at(points)
        hidden += int(np.sum(~is_body))
        total += len(is_body)
    return hidden / total if total else 0.0


def spread(positions: FloatArray, count: int) -> IntArray:
    """Indices of `count` of (N, 3) positions, or all, by farthest-point sampling."""
    if len(positions) <= count:
        return np.arange(len(positions))
    directions = unit(positions)
    chosen = [0]
    nearest = directions @ directions[0]
    while len(chosen) < count:
        chosen.append(int(np.argmin(nearest)))
        nearest = np.maximum(nearest, directions @ directions[chosen[-1]])
    return np.array(chosen)


def within(bodies: Sequence[Body], points: FloatArray) -> BoolArray:
    """(N,) whether (N, 3) points project to the background of no view."""
    left = np.arange(len(points))
    for body in bodies:
        left = left[body.holds(points[left])]
    inside = np.zeros(len(points), bool)
    inside[left] = True
    return inside
