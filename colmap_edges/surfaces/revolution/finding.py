"""Detection of bodies of revolution: axes, their fit to outlines, profiles, acceptance, points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.arrays import BoolArray, IntArray
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.seen_points import NO_POINTS, joined_seen
from colmap_edges.core.upright import upward
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.revolution.bodies import (
    MAX_DEVIATION_PX,
    free_part,
    points_on,
    seen_bins,
    with_caps,
)
from colmap_edges.surfaces.revolution.fitting import fitted
from colmap_edges.surfaces.revolution.hypotheses import (
    axes_of_circles,
    axes_of_mirrored,
    centers_of,
)
from colmap_edges.surfaces.revolution.meridians import Axis, meridian_of, samples_near, voted
from colmap_edges.surfaces.revolution.primitives import faces_of
from colmap_edges.surfaces.revolution.profiles import Profile, profiles_of
from colmap_edges.surfaces.revolution.samples import Samples
from colmap_edges.surfaces.round_evidence import (
    SAME_SHARE,
    TRIED_SHARE,
    FoundRound,
    Rays,
    is_believed,
    on_both_sides,
)
from colmap_edges.surfaces.round_face import RoundFace

MAX_SAMPLES = 60_000  # maximum number of samples, those of the smoothest chains
MIN_VOTES = 6.0  # minimum of a hypothesis
NEAR_PX = 3.0  # maximum distance of outlines from those of a cylinder that other bodies leave out
MAX_NEAR, MIN_VIEWS = 10_000, 8  # number of samples and views around an axis that rank it
MAX_FITS = 16  # maximum number of fitted axes
MAX_TRIES = 3  # number of axes after which samples are tried; one that is fitted counts twice


def find_bodies(
    samples: Samples,
    curves: Curves3D,
    views: Sequence[View],
    evidence: Evidence,
    known: Sequence[RoundFace],
    random_seed: int,
) -> FoundRound:
    """Find the bodies of revolution whose outlines views show.

    Args:
        samples: samples of the views' chains.
        curves: curves of the 3D edges; the axes of their circles are tried.
        views: all views.
        evidence: observed points, which lie on bodies or contradict them.
        known: cylinders that are found already, whose outlines are left out.
        random_seed: of the choice of mirrored outlines.
    """
    unfixed = np.flatnonzero(~samples.fixed)
    smoothest = np.argsort(-samples.lengths[unfixed], kind="stable")[:MAX_SAMPLES]
    free = samples.select(np.sort(unfixed[smoothest]))
    beside = [axis_of_face(face, views) for face in known]
    for axis, face in zip(beside, known, strict=True):
        free = free.select(np.flatnonzero(~are_on_cylinder(free, axis, face)))
    mirrored = axes_of_mirrored(free, views, upward(views, curves), random_seed)
    axes = [*beside, *axes_of_circles(curves, views), *mirrored]
    fits = best_fits(free, axes)
    rays = Rays.of(evidence, views)
    used = np.zeros(len(free.views), bool)
    faces: list[RoundFace] = []
    points = [NO_POINTS]
    for whole in best_profiles(free, fits, len(views)):
        if used[whole.rows].mean() > SAME_SHARE:
            continue
        profile = free_part(whole, rays)
        if profile is None:
            continue
        axis = profile.axis
        ends = axis.point + profile.places[[0, -1], None] * axis.pixel * axis.direction
        if not is_believed(profile.shown, ends, views):
            continue
        capped = with_caps(profile, rays, evidence)
        on = points_on(capped, seen_bins(capped, views), views, evidence, rays)
        if on is None:
            continue
        used[profile.rows] = True
        points.append(on)
        faces += faces_of(capped, np.flatnonzero(on_both_sides(profile.shown)))
    return FoundRound(
        faces=faces, points=joined_seen(points), num_tried=len(axes), num_fitted=len(fits)
    )


def best_profiles(samples: Samples, axes: Sequence[Axis], num_views: int) -> list[Profile]:
    """The profiles about some axes that outlines fit, those first that explain them best."""
    near = [meridian_of(samples, samples_near(samples, axis), axis) for axis in axes]
    found = [
        profile
        for meridian, axis in zip(near, axes, strict=True)
        for profile in profiles_of(samples, meridian, axis, num_views)
        if profile.deviation <= MAX_DEVIATION_PX
    ]
    return sorted(found, key=lambda profile: -profile.gain)


def axis_of_face(face: RoundFace, views: Sequence[View]) -> Axis:
    """The axis of a cylinder, with a ball that reaches beyond it."""
    place, radius = face.profile.mean(axis=0)
    point = face.point + place * face.direction
    centers, focals = centers_of(views)
    pixel = float(np.median(np.linalg.norm(point - centers, axis=1) / focals))
    return Axis(point, face.direction, float(np.ptp(face.profile[:, 0]) + 2 * radius), pixel)


def are_on_cylinder(samples: Samples, axis: Axis, face: RoundFace) -> BoolArray:
    """(n,) whether samples are on the outlines of a cylinder about an axis."""
    found = np.zeros(len(samples.views), bool)
    meridian = meridian_of(samples, np.arange(len(found)), axis)
    places, radii = np.moveaxis(meridian.points, 1, 0)
    half, radius = np.ptp(face.profile[:, 0]) / 2 / axis.pixel, face.profile[0, 1] / axis.pixel
    on = (np.abs(radii - radius) < NEAR_PX * meridian.sizes) & (np.abs(places) < half)
    found[meridian.rows[on]] = True
    return found


def best_fits(samples: Samples, axes: Sequence[Axis]) -> list[Axis]:
    """The axes on which most outlines agree, fitted to them, the best one first."""
    near = [of_some_views(samples, samples_near(samples, axis)) for axis in axes]
    votes = [votes_of(samples, rows, axis) for rows, axis in zip(near, axes, strict=True)]
    tried = np.zeros(len(samples.views), np.int64)
    fits: list[tuple[float, Axis]] = []
    for h in np.argsort([-score for score, _ in votes], kind="stable").tolist():
        score, rows = votes[h]
        if score < MIN_VOTES or len(fits) == MAX_FITS:
            break
        if np.mean(tried[rows] >= MAX_TRIES) > TRIED_SHARE:
            continue
        tried[rows] += 1
        axis = fitted(samples.select(near[h]), axes[h])
        if axis is not None:
            score, rows = votes_of(samples, near[h], axis)
            tried[rows] += 1
            fits.append((score, axis))
    fits.sort(key=lambda fit: -fit[0])
    return [axis for _, axis in fits]


def of_some_views(samples: Samples, rows: IntArray) -> IntArray:
    """Of (n,) samples those of each second, third ... view if there are more than `MAX_NEAR`."""
    views = samples.views[rows]
    ranks = np.cumsum(np.diff(views, prepend=views[:1]) > 0)
    every = min(-(-len(rows) // MAX_NEAR), (ranks[-1] + 1) // MIN_VIEWS) if len(rows) else 1
    return rows[ranks % every == 0] if every > 1 else rows


def votes_of(samples: Samples, rows: IntArray, axis: Axis) -> tuple[float, IntArray]:
    """How many views agree on a body about an axis, and on which samples."""
    meridian = meridian_of(samples, rows, axis)
    score, own = voted(samples, meridian)
    return score, meridian.rows[own]
