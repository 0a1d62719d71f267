"""Bodies of revolution: whether views believe a profile, its caps, and points on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve

from colmap_edges.core.arrays import BoolArray, FloatArray, owners_of, ranks_of
from colmap_edges.core.polylines import plane_basis, unit
from colmap_edges.core.seen_points import NO_POINTS, SeenPoints
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.revolution.profiles import BIN_PX, MAX_OFF, Profile, stretch_of
from colmap_edges.surfaces.revolution.sight import entries_of, rays_that_meet, shell_of
from colmap_edges.surfaces.round_evidence import (
    END_PX,
    MAX_THROUGH,
    MIN_STEPS,
    SPACING_PX,
    Rays,
    Sight,
    closed_along,
    frontal_views,
    seen_on_body,
)

MAX_DEVIATION_PX = 0.5  # maximum median distance of outlines from a profile
CAP_REACH = 0.45  # maximum height of a cap, in radii at its rim
RIM_PX = 4.0  # maximum distance of an edge that is the rim of an opening
RIM_SHARE = 0.3  # minimum share of the turn that such edges cover


def free_part(profile: Profile, rays: Rays) -> Profile | None:
    """The stretch of a profile through which few rays pass; None if it is less than half of it.

    Parts of two bodies on one axis, or of a body and what it stands on, may make one profile.
    """
    sight, count = rays_that_meet(shell_of(profile), rays), len(profile.places)
    bins = np.rint(np.interp(sight.places, profile.places, np.arange(count))).astype(np.int64)
    through = np.bincount(bins[sight.through][are_steep(profile, sight)], minlength=count)
    met = np.bincount(bins[~sight.before], minlength=count) + profile.shown.sum(axis=(0, 1))
    around = np.ones(2 * profile.gap + 1)
    through, met = (convolve(counts, around, mode="constant") for counts in (through, met))
    free = stretch_of(profile, through <= MAX_THROUGH * met)
    return free if free and 2 * len(free.places) >= count else None


def with_caps(profile: Profile, rays: Rays, evidence: Evidence) -> Profile:
    """The profile continued to the axis at ends that close smoothly, as those of balls and eggs.

    There the square of the radius is a quadratic function of the place. No rim may be around the
    end, as around an opening, and few rays may pass through the cap.
    """
    for end in (1, -1):
        found = cap_of(profile, end)
        if found is None or has_rim(profile, end, rays, evidence):
            continue
        whole = joined(profile, *found, end)
        sight = rays_that_meet(shell_of(whole), rays)
        last = profile.places[-1 if end > 0 else 0]
        beyond = (sight.places - last) * end > 0
        passing = beyond[sight.through] & are_steep(whole, sight)
        if passing.sum() <= MAX_THROUGH * (beyond & ~sight.before).sum():
            profile = whole
    return profile


def are_steep(profile: Profile, sight: Sight) -> BoolArray:
    """(m,) whether the rays that pass through a body do not graze it, as those of outlines do."""
    axis = profile.axis
    away = sight.entries - axis.point
    outward = unit(away - np.outer(away @ axis.direction, axis.direction))
    places = sight.places[sight.through]
    slopes, rises = (np.interp(places, profile.places, column) for column in profile.normals.T)
    normals = slopes[:, None] * axis.direction + rises[:, None] * outward
    return sight.are_steep(normals)


def joined(
    profile: Profile, places: FloatArray, radii: FloatArray, normals: FloatArray, end: int
) -> Profile:
    """The profile with a part beyond its end, which is shown as the end is."""
    edge = profile.shown[:, :, [-1 if end > 0 else 0]]
    own = (profile.places, profile.radii, profile.normals, np.moveaxis(profile.shown, 2, 0))
    more = (places, radii, normals, np.moveaxis(np.repeat(edge, len(places), axis=2), 2, 0))
    arrays = [
        np.concatenate([a, b] if end > 0 else [b[::-1], a]) for a, b in zip(own, more, strict=True)
    ]
    return replace(
        profile,
        places=arrays[0],
        radii=arrays[1],
        normals=arrays[2],
        shown=np.moveaxis(arrays[3], 0, 2),
    )


def cap_of(profile: Profile, end: int) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Places, radii and normals from an end of a profile to the axis, outwards; or None."""
    order = slice(None, None, -end)  # from the end inwards
    places, radii = profile.places[order] * end, profile.radii[order]
    own = np.flatnonzero(places[0] - places <= max(radii[0], 6 * BIN_PX))
    if len(own) < 6 or profile.normals[order][0, 0] * end < 0.5:
        return None
    start = places[0]
    curve = np.polynomial.Polynomial.fit(places[own] - start, radii[own] ** 2, 2).convert()
    fitted = np.sqrt(np.maximum(curve(places[own] - start), 0))
    off = (fitted - radii[own]) * profile.normals[order][own, 1]
    roots = np.real(curve.roots()[np.isreal(curve.roots())])
    tops = roots[(roots > BIN_PX) & (roots < CAP_REACH * radii[0])]
    if not len(tops) or curve.coef[2] > 0 or np.max(np.abs(off)) > MAX_OFF * profile.deviation:
        return None
    top = float(tops.min())
    # Evenly along the curve, nearly: places change with the square of the radius.
    shares = np.linspace(1, 0, max(int(radii[0] / BIN_PX), 4))[1:]
    heights = top * (1 - shares**2)
    squares = np.maximum(curve(heights), 0)
    normals = unit(np.column_stack([-curve.deriv()(heights) / 2, np.sqrt(squares)]))
    normals[:, 0] *= end
    return (heights + start) * end, np.sqrt(squares), normals


def has_rim(profile: Profile, end: int, rays: Rays, evidence: Evidence) -> bool:
    """Whether edges run around an end of a profile, as around an opening.

    Outlines that pass for edges are there, too, but only views from beyond the axis show these.
    """
    axis, last = profile.axis, -1 if end > 0 else 0
    points = evidence.points - axis.point
    along = points @ axis.direction
    across = points - np.outer(along, axis.direction)
    off = np.hypot(
        along / axis.pixel - profile.places[last],
        np.linalg.norm(across, axis=1) / axis.pixel - profile.radii[last],
    )
    owners = owners_of(evidence.offsets)
    before = np.einsum("ij,ij->i", rays.directions, across[owners]) < 0
    faced = np.bincount(owners[before], minlength=len(points)) > 0
    rim = across[(off < 2 * RIM_PX) & (evidence.edge_ids >= 0) & faced]
    basis = plane_basis(axis.direction)
    angles = np.arctan2(rim @ basis[0], rim @ basis[1])
    turn = len(np.unique(np.floor(angles / (2 * np.pi) * 36)))
    return turn > RIM_SHARE * 36


def seen_bins(profile: Profile, views: Sequence[View]) -> BoolArray:
    """(V, B) whether a view sees a bin: a body before it would hide one of the outlines.

    Where a view can see no outline, on top of a body, those of the nearest bin count.
    """
    axis, count = profile.axis, len(profile.places)
    seen = np.asarray(closed_along(profile.shown, profile.gap).all(axis=1))
    away = (np.array([view.center for view in views]) - axis.point) / axis.pixel
    heights = away @ axis.direction
    reach = np.linalg.norm(away - np.outer(heights, axis.direction), axis=1)
    slopes, rises = profile.normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        cosines = rises * profile.radii + slopes * (profile.places - heights[:, None])
        cosines /= rises * reach[:, None]
        outlined = np.abs(cosines) < 1
    outlined &= profile.shown.any(axis=(0, 1)) & (profile.normals[:, 1] > 0.25)
    for view in range(len(views)):
        own = np.flatnonzero(outlined[view])
        if not len(own):
            seen[view] = False
            continue
        nearest = own[np.argmin(np.abs(np.arange(count)[:, None] - own), axis=1)]
        seen[view] = seen[view, nearest]
    return seen


def points_on(
    profile: Profile,
    seen: BoolArray,
    views: Sequence[View],
    evidence: Evidence,
    rays: Rays,
) -> SeenPoints | None:
    """Points on a body, away from its edges, with the views that see them.

    Args:
        profile: the profile.
        seen: (V, B) whether a view sees a bin.
        views: all views.
        evidence: the edge points.
        rays: rays to observed points.

    Returns:
        The points; None if rays pass through much of the body.
    """
    axis, shell = profile.axis, shell_of(profile)
    showing = np.flatnonzero(seen.any(axis=1))
    step = min(SPACING_PX, 2 * np.pi * np.median(profile.radii) / MIN_STEPS)
    places, radii, slopes, bins = along_profile(profile, step)
    if not len(showing) or not len(places):
        return NO_POINTS
    counts = np.maximum(np.ceil(2 * np.pi * radii / step), 3).astype(np.int64)
    owners = np.repeat(np.arange(len(places)), counts)
    turns = (ranks_of(counts) + owners % 2 / 2) / counts[owners]
    basis = plane_basis(axis.direction)
    away = np.column_stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)]) @ basis
    local = places[owners, None] * axis.direction + radii[owners, None] * away
    points = axis.point + axis.pixel * local
    normals = slopes[owners, :1] * axis.direction + slopes[owners, 1:] * away
    centers = np.array([views[v].center for v in showing.tolist()])
    frontal = frontal_views(points, normals, seen[showing][:, bins[owners]].T, centers)
    rows, ranks = np.nonzero(frontal.kept)
    toward = frontal.toward[rows, frontal.order[rows, ranks]]
    hidden = np.isfinite(entries_of(shell, points[rows], toward, skipped=2.0)[0])
    frontal.kept[rows[hidden], ranks[hidden]] = False
    sight = rays_that_meet(shell, rays)
    return seen_on_body(points, normals, frontal, showing, evidence, sight, step * axis.pixel)


def along_profile(
    profile: Profile, step: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Places, radii, normals (n, 2) and bins of points along a profile, away from its ends."""
    lengths = np.hypot(np.diff(profile.places), np.diff(profile.radii))
    arc = np.concatenate([[0], np.cumsum(lengths)])
    first, last = (0.0 if radius == 0 else END_PX for radius in profile.radii[[0, -1]].tolist())
    if arc[-1] - first - last < BIN_PX:
        return np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros(0, np.int64)
    count = max(int((arc[-1] - first - last) / step) + 1, 2)
    at = np.linspace(first, arc[-1] - last, count)
    places, radii, slopes, rises = (
        np.interp(at, arc, column) for column in (profile.places, profile.radii, *profile.normals.T)
    )
    bins = np.rint(np.interp(at, arc, np.arange(len(arc)))).astype(np.int64)
    return places, radii, unit(np.column_stack([slopes, rises])), bins
