"""What rays to observed points say of a cylinder: they pass through it, end on it or before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, owners_of
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View
from colmap_edges.surfaces.cylinders.hypotheses import Cylinders
from colmap_edges.surfaces.faces.evidence import Evidence

WITHIN_PX = 3.0  # minimum distance of a ray from the outline, within which it meets the cylinder
DEVIATIONS = 4.0  # minimum distance of a point from the surface, in its standard deviations
DEPTH_SHARE = 0.02  # ... and in its depth


@dataclass(frozen=True, kw_only=True)
class Sight:
    """Rays to observed points that meet a cylinder.

    Attributes:
        views: (n,) their views.
        points: (n,) their points.
        places: (n,) where they meet it, along the axis.
        through: (n,) whether the point lies behind the surface there.
        before: (n,) whether it lies before it.
    """

    views: Int32Array
    points: IntArray
    places: FloatArray
    through: BoolArray
    before: BoolArray


def rays_that_meet(
    one: Cylinders, low: float, high: float, evidence: Evidence, views: Sequence[View]
) -> Sight:
    """The rays to observed points that meet a cylinder between two places of its axis."""
    owners = owners_of(evidence.offsets)
    seeing = evidence.views
    centers = np.array([view.center for view in views])[seeing]
    focals = np.array([view.focal_px for view in views])[seeing]
    ends = evidence.points[owners]
    rays = unit(ends - centers)
    reach, places = entry_of(one, centers, rays, WITHIN_PX / focals)
    meets = np.flatnonzero(np.isfinite(reach) & (places > low) & (places < high))
    owners, seeing = owners[meets], seeing[meets]
    length = np.linalg.norm(ends[meets] - centers[meets], axis=1)
    behind = length - reach[meets]
    limit = np.maximum(DEVIATIONS * evidence.ray_sigmas[owners], DEPTH_SHARE * length)
    return Sight(
        views=seeing,
        points=owners,
        places=places[meets],
        through=behind > limit,
        before=behind < -limit,
    )


def entry_of(
    one: Cylinders, centers: FloatArray, rays: FloatArray, margin: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Lengths (N,) of rays to where they enter a cylinder, inf if never, and places on its axis.

    Rays that pass within an angle `margin` of the outline do not count.
    """
    axis, radius = one.axes[0], one.radii[0]
    away = centers - one.points[0]
    heights, slopes = away @ axis, rays @ axis
    flat, way = away - heights[:, None] * axis, rays - slopes[:, None] * axis
    a = (way**2).sum(axis=1) + 1e-300
    b = np.einsum("ij,ij->i", flat, way) / a
    nearest = np.sqrt(np.maximum((flat**2).sum(axis=1) - b**2 * a, 0))
    half = radius**2 - nearest**2
    enters = (nearest < radius - margin * np.abs(b)) & (b < 0)
    enters &= (flat**2).sum(axis=1) > radius**2
    reach = np.where(enters, -b - np.sqrt(np.maximum(half, 0) / a), np.inf)
    with np.errstate(invalid="ignore"):
        return reach, heights + reach * slopes
