"""Extraction of curves from consecutive samples with confirmed depths (paper: following)."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    ranks_of,
)
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges3d.chains.curves import Curves
from colmap_edges.edges3d.chains.depths import ChainDepths
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import TracingOptions


def find_curves(
    graph: EdgeGraph,
    edge_index: _kernels.EdgeIndex,
    covered: BoolArray,
    depths: ChainDepths,
    agreeing: Int32Array,
    options: TracingOptions,
) -> tuple[Curves, int]:
    """Curves on the chains of one view that are not covered yet.

    Args:
        graph: the view's edge graph of P points.
        edge_index: search index of the graph.
        covered: (P,) whether a point already observes an edge.
        depths: depths of S samples on its chains.
        agreeing: (S,) number of other views that confirm each depth.
        options: conditions for a run, and spacing of edge points.

    Returns:
        The curves, and the number of samples in kept runs.
    """
    rows = np.flatnonzero(depths.found & (agreeing >= 1))
    sizes, sure = sure_runs(link_samples(graph, depths, rows, options), agreeing[rows], options)
    indices, inverse, runs = densify(graph, depths, rows, sizes, sure, options)
    free = ~covered[indices]
    indices, inverse, runs = indices[free], inverse[free], runs[free]
    # Curves end at covered stretches as at the ends of their runs.
    broken = np.ones(len(indices), bool)
    broken[1:] = (np.diff(runs) != 0) | (np.diff(indices) > options.curve_step_points)
    ids = np.cumsum(broken) - 1
    long = np.bincount(ids, minlength=1)[ids] >= options.min_curve_points
    indices, inverse, ids = indices[long], inverse[long], ids[long]
    lengths = np.unique(ids, return_counts=True)[1]
    tangent = _kernels.chain_points(edge_index, indices.astype(np.float64))[1]
    normal = graph.normals[indices]
    sides = np.where(tangent[:, 0] * normal[:, 1] - tangent[:, 1] * normal[:, 0] >= 0, 1, -1)
    curves = Curves(
        undistorted=graph.undistorted[indices].astype(np.float64),
        inverse_depths=inverse,
        indices=indices,
        offsets=offsets_of(lengths),
        sides=sides.astype(np.int8),
    )
    return curves, int(sizes[sure].sum())


def link_samples(
    graph: EdgeGraph, depths: ChainDepths, rows: IntArray, options: TracingOptions
) -> BoolArray:
    """(n - 1,) whether sample rows[i] and rows[i + 1] belong to one curve.

    They do when depth changes between them by at most `max_disparity_gradient` pixels of disparity
    a pixel of chain, and no sample is missing, or the gap is at most `max_bridge_px`.
    """
    if len(rows) < 2:
        return np.zeros(0, bool)
    left, right = rows[:-1], rows[1:]
    polylines = graph.polyline_ids[depths.samples[rows]]
    steps = depths.samples[right] - depths.samples[left]
    counts = np.diff(depths.support_offsets)
    sigma = np.maximum(depths.sigmas[left], depths.sigmas[right]) * np.sqrt(counts[left])
    change = np.abs(depths.inverse_depths[right] - depths.inverse_depths[left])
    smooth = change <= options.max_disparity_gradient * steps * sigma
    bridged = steps <= options.max_bridge_px
    linked: BoolArray = (polylines[1:] == polylines[:-1]) & smooth
    linked &= (right - left == 1) | bridged
    return linked


def densify(
    graph: EdgeGraph,
    depths: ChainDepths,
    rows: IntArray,
    sizes: IntArray,
    sure: BoolArray,
    options: TracingOptions,
) -> tuple[IntArray, FloatArray, IntArray]:
    """Points along the kept runs of samples, with inverse depths linear between samples.

    Args:
        graph: edge graph of the view.
        depths: depths of its samples.
        rows: (n,) indices of the samples of all runs, run by run.
        sizes: (R,) number of samples of each run.
        sure: (R,) whether a run is kept.
        options: spacing of the points, and length of the extension beyond a run's ends.

    Returns:
        (N,) points of the graph, (N,) inverse depths, (N,) run of each.
    """
    starts = offsets_of(sizes)
    first, last = starts[:-1][sure], starts[1:][sure] - 1
    at, values = depths.samples[rows], depths.inverse_depths[rows]
    polylines = graph.polyline_ids[at[first]]
    low = np.maximum(at[first] - options.extension_px, graph.polyline_offsets[polylines])
    end = graph.polyline_offsets[polylines + 1] - 1
    high = np.minimum(at[last] + options.extension_px, end)
    counts = (high - low) // options.curve_step_points + 1
    runs = np.repeat(np.arange(len(first)), counts)
    points = low[runs] + options.curve_step_points * ranks_of(counts)
    # Beyond a run's ends, depth is extrapolated from its first and last two samples.
    before = np.clip(np.searchsorted(at, points, "right") - 1, first[runs], last[runs])
    left = np.minimum(before, last[runs] - 1)
    slopes = (values[left + 1] - values[left]) / (at[left + 1] - at[left])
    inverse = slopes * (points - at[before]) + values[before]
    return points, np.where(inverse > 0, inverse, values[before]), np.flatnonzero(sure)[runs]


def sure_runs(
    linked: BoolArray, agreeing: Int32Array, options: TracingOptions
) -> tuple[IntArray, BoolArray]:
    """Find runs of linked samples that are long enough and confirmed by enough views.

    Args:
        linked: (n - 1,) whether samples i and i + 1 are linked.
        agreeing: (n,) number of views that confirm each sample.
        options: minimum numbers of samples and views.

    Returns:
        (R,) number of samples of each run, (R,) whether the run is kept.
    """
    if len(agreeing) == 0:
        return np.zeros(0, np.int64), np.zeros(0, bool)
    runs = np.concatenate([[0], np.cumsum(~linked)])
    sizes = np.bincount(runs)
    sure = np.bincount(runs, weights=agreeing >= options.min_agreeing_views)
    kept = (sizes >= options.min_run_samples) & (sure >= options.min_confirmed_ratio * sizes)
    return sizes, kept
