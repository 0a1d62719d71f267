"""Detection of the sky: its viewing rays pass through free space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, Picture, parts_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.upright import up_directions
from colmap_edges.images.background import (
    NO_BACKGROUND_MASK,
    BackgroundMask,
    BackgroundRays,
    Backgrounds,
    background_rays,
    masked_background,
)
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.faces.evidence import points_and_views
from colmap_edges.surfaces.faces.labelling import NUM_NEIGHBORS, observed_points
from colmap_edges.surfaces.sky.backdrop import find_backdrop
from colmap_edges.surfaces.sky.colours import looks_like_sky
from colmap_edges.surfaces.sky.infinity import (
    are_contradicted,
    confirmed,
    match_regions,
    moves_as_sky,
    spread,
)
from colmap_edges.surfaces.sky.regions import find_regions

# Minimum share of the images that show blue sky: 0.5 to 1 of facades, below 0.1 of rooms.
MIN_VIEWS_SHARE = 1 / 4


def find_sky(
    model: Model, edges: Edges3D, pictures: Mapping[int, Picture]
) -> tuple[BackgroundRays, Backgrounds] | None:
    """Find the sky, and haze or hills at infinity next to it; None if too few images show it.

    Args:
        model: the V views and the SfM points.
        edges: its 3D edges.
        pictures: small pictures of the views by their index; views without one show nothing.

    Returns:
        Its rays, and the sky or the backdrop of each view.
    """
    num_views = len(model.views)
    points, track_offsets, track_views = points_and_views(model, edges)
    offsets, rows = observed_points(track_offsets, track_views, num_views)
    observed = parts_of(rows, offsets)
    for up in up_directions(model.views):
        regions = find_regions(model.views, pictures, points, observed, up)
        backdrop = find_backdrop(model.views, regions)
        if backdrop is not None:
            masks = background_masks(backdrop.shown)
            return open_through(model, Backgrounds(masks, backdrop.others))
        blue, white = looks_like_sky(model.views, regions, up)
        if len(np.unique(regions.views[blue])) >= max(MIN_VIEWS_SHARE * len(pictures), 2):
            break
    else:
        return None
    neighbor_offsets, neighbors = _kernels.neighbors_of(
        track_offsets, track_views, offsets, rows, NUM_NEIGHBORS
    )
    compared = parts_of(neighbors, neighbor_offsets)
    matches = match_regions(model.views, regions, points, observed, compared)
    is_sky = blue | (white & confirmed(matches, blue | white))
    if not moves_as_sky(matches, is_sky):
        return None
    is_sky &= ~are_contradicted(matches, is_sky)
    shown = regions.shown(spread(matches, regions, is_sky))
    return open_through(model, Backgrounds(background_masks(shown)))


def open_through(model: Model, shown: Backgrounds) -> tuple[BackgroundRays, Backgrounds] | None:
    """The rays of what is shown in all views, and that; None without any ray."""
    rays = background_rays(model.views, shown.masks, True)
    return None if rays is None else (rays, shown)


def background_masks(shown: Sequence[BoolArray]) -> list[BackgroundMask]:
    """Background masks of views that show the sky at (h, w) pixels."""
    return [masked_background(~of) if of.any() else NO_BACKGROUND_MASK for of in shown]
