"""What rays to observed points say of a cylinder: they pass through it, end on it or before it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.view import View
from colmap_edges.surfaces.cylinders.hypotheses import NEAR_PX, Cylinders
from colmap_edges.surfaces.round_evidence import Rays, Sight


def rays_that_meet(
    one: Cylinders, low: float, high: float, rays: Rays, views: Sequence[View]
) -> Sight:
    """The rays to observed points that meet a cylinder between two places of its axis."""
    focals = np.array([view.focal_px for view in views])[rays.views]
    reach, places = entry_of(one, rays.starts, rays.directions, NEAR_PX / focals)
    meets = np.flatnonzero(np.isfinite(reach) & (places > low) & (places < high))
    return rays.met(meets, reach[meets], places[meets])


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
