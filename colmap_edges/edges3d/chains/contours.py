"""Decision between fixed edges and contours of smooth bodies, by how residuals change with views.

(paper: Visibility refinement and outliers filtering)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.edges3d.chains.traced_curves import TracedCurves
from colmap_edges.options import TracingOptions


def are_fixed(
    traced: TracedCurves, groups: IntArray, limits_px: FloatArray | float, options: TracingOptions
) -> BoolArray:
    """(G,) whether the observations of groups of points are of a fixed edge.

    The point that is seen on a smooth body moves over it with the view, as on a cylinder whose
    radius the observations determine. An edge next to overexposed pixels is displaced towards its
    dark side in all views, as if it had a radius of this displacement. So a displacement explains
    residuals of edges; if a larger radius explains significantly more, they are of a contour.

    Args:
        traced: the curves, N points.
        groups: (N,) group of each point, numbered from 0.
        limits_px: one or (G,) maximum mean residuals of an edge.
        options: the largest displacement of an edge.
    """
    seen = Seen.of(traced, groups)
    radii = fit_radii(seen)
    displaced = np.clip(radii, -options.max_displacement_px, options.max_displacement_px)
    fixed, moving = (seen.residuals + of[seen.owners] * seen.drifts for of in (displaced, radii))
    scatter = scatter_of(seen, np.abs(fixed))
    return np.asarray((scatter <= limits_px) & ~are_less(seen, moving, fixed))


def are_less(seen: Seen, moving: FloatArray, fixed: FloatArray) -> BoolArray:
    """(G,) whether residuals are significantly less with a radius than without (F test).

    Residuals of one view are not independent of each other, so their means by view are tested.
    """
    kept, views = np.unique(seen.views, return_inverse=True)  # few of the scene's
    shape = len(seen.spare), max(len(kept), 1)
    pairs = np.ravel_multi_index((seen.owners, views), shape)
    counts = np.bincount(pairs, minlength=shape[0] * shape[1])

    def squares(residuals: FloatArray) -> FloatArray:
        means = np.bincount(pairs, residuals, len(counts)) / np.maximum(counts, 1)
        sums: FloatArray = (means**2).reshape(shape).sum(axis=1)
        return sums

    left = squares(moving)
    freedom = (counts > 0).reshape(shape).sum(axis=1) - 2  # a depth and a radius are fitted
    ratio = (squares(fixed) - left) * freedom / (left + 1e-300)
    # The chance of taking an edge for a contour because a radius explains its noise.
    limits = fdtri(1, np.arange(1, freedom.max(initial=1) + 1), 1 - 1e-3)
    return np.asarray((freedom > 0) & (ratio > limits[np.maximum(freedom, 1) - 1]))


def fit_radii(seen: Seen) -> FloatArray:
    """(G,) radii of rounded edges in pixels, robustly fitted (Geman-McClure weights)."""
    radii = np.zeros(len(seen.spare))
    for _ in range(4):
        rest = seen.residuals + radii[seen.owners] * seen.drifts  # at 1 px, the weight is 1/4
        weighted = seen.drifts / (1 + rest**2) ** 2
        information = np.bincount(seen.owners, weighted * seen.drifts, len(radii))
        pull = np.bincount(seen.owners, weighted * seen.residuals, len(radii))
        radii = -pull / (information + 1e-300)
    return radii


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Observations of groups of points in other views than the reference view.

    Attributes:
        residuals: (T,) signed distances across the observing chains, in pixels.
        drifts: (T,) their changes by the radius of a rounded edge, pixels per pixel.
        owners: (T,) group of each observation.
        views: (T,) view of each observation.
        spare: (G,) number of observations less one for each point, which determines its depth.
    """

    residuals: FloatArray
    drifts: FloatArray
    owners: IntArray
    views: IntArray
    spare: IntArray

    @classmethod
    def of(cls, traced: TracedCurves, groups: IntArray) -> Seen:
        """The observations of groups of points, numbered from 0 in (N,) `groups`."""
        observed = traced.observations
        others = np.flatnonzero(observed.views != traced.reference)
        return cls(
            residuals=observed.residuals[others].astype(np.float64),
            drifts=observed.drifts[others].astype(np.float64),
            owners=groups[observed.points[others]],
            views=observed.views[others].astype(np.int64),
            spare=np.bincount(groups, observed.counts - 2).astype(np.int64),
        )


def scatter_of(seen: Seen, distances: FloatArray) -> FloatArray:
    """(G,) mean of the (T,) distances of the observations of each group."""
    sums = np.bincount(seen.owners, distances, len(seen.spare))
    scatter: FloatArray = sums / np.maximum(seen.spare, 1)
    return scatter
