"""Curves traced in one reference view, with their observations in all views."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.core.arrays import Float32Array, FloatArray, IntArray
from colmap_edges.core.observations import ChainObservations


@dataclass(frozen=True, kw_only=True)
class TracedObservations(ChainObservations):
    """Observations of traced curves.

    Attributes:
        offsets, views, positions: those of `ChainObservations`.
        residuals: (T,) float32 signed distances across the observing chains, in pixels.
        drifts: (T,) float32 their changes by the radius of a rounded edge, pixels per pixel.
    """

    residuals: Float32Array
    drifts: Float32Array


@dataclass(frozen=True, kw_only=True)
class TracedCurves:
    """Curves of one reference view with their observations.

    Attributes:
        points: (N, 3) world points.
        sigmas: (N,) standard deviation along the reference view's ray, world units.
        offsets: (E + 1,) CSR of the points by curve.
        reference: the view on whose chains they lie.
        observations: observations on the views' chains, those of the reference view first.
        uncertainties: (N,) `sigmas` in pixels of the reference view.
        log_chances: (N,) log10 of the probability of as many accidental observations.
    """

    points: FloatArray
    sigmas: FloatArray
    uncertainties: FloatArray
    log_chances: FloatArray
    offsets: IntArray
    reference: int
    observations: TracedObservations
