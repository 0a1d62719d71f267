"""A-contrario test: the probability that accidental observations explain a curve.

Where edges are dense, any 3D curve projects near some chain in many views. The probability of such
accidental observations is estimated from the same curve displaced in depth.
"""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.view import View, in_images, lift
from colmap_edges.edges3d.chains.curves import Curves, replace_depths
from colmap_edges.edges3d.chains.observing import associate, drop_lone
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import RefinementOptions

CLOSE_SIGMAS = 2.5  # maximum residual of observations that count, in standard deviations of a chain
PRIOR_TRIALS = 20  # pseudo-count of trials with one hit, the prior of the accidental rate
MIN_LOG = -12.0  # lower bound of the log probability of a single point


def chance_of_observations(
    reference: View,
    curves: Curves,
    residuals: FloatArray,
    displacements: FloatArray,
    views: list[View],
    edge_indexes: list[_kernels.EdgeIndex],
    options: RefinementOptions,
    num_threads: int,
) -> FloatArray:
    """(N,) log10 of the probability that as many views observe a point by accident.

    Args:
        reference: the view on whose chains the curves are.
        curves: the curves, N points.
        residuals: (N, K) distances to the chains that observe them, in pixels; NaN where none.
        displacements: (N,) change of inverse depth that moves the point one pixel in the views.
        views: the K views.
        edge_indexes: their chains.
        options: the noise across chains, and how parallel an observation is.
        num_threads: threads to use.
    """
    ids, count = curves.curve_ids, len(curves.offsets) - 1
    close_px = CLOSE_SIGMAS * options.noise_px
    points = lift(reference, curves.undistorted, curves.inverse_depths)
    visible = in_images(views, points).sum(axis=0)
    observed = np.sum(np.abs(residuals) <= close_px, axis=1)
    signs = np.where(ids % 2 == 0, 1, -1)
    # The curve is displaced in depth by more than its error.
    moved = replace_depths(curves, curves.inverse_depths + 12.0 * signs * displacements)
    positions = associate(
        reference, moved, edge_indexes, close_px, options.max_tangent_angle_deg, num_threads
    )
    seen = np.isfinite(drop_lone(positions, curves.offsets)).sum(axis=1)
    hits = np.bincount(ids, weights=seen, minlength=count)
    trials = np.bincount(ids, weights=visible, minlength=count)
    rates = np.minimum((hits + 1) / (trials + PRIOR_TRIALS), 0.9)
    trials_each = np.maximum(visible, observed).astype(np.int64)
    with np.errstate(divide="ignore"):
        logs = np.log10(bdtrc(observed - 1, trials_each, rates[ids]))
    result: FloatArray = np.maximum(logs, MIN_LOG)
    return result
