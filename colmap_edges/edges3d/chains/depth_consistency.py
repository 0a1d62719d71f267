"""Cross-check of the depths along chains between views."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, owners_of
from colmap_edges.core.view import View, lift
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges3d.chains.depths import ChainDepths
from colmap_edges.edges3d.chains.tracing_input import TracingInput


def count_agreeing_views(
    given: TracingInput,
    depths: Sequence[ChainDepths],
    source: int,
    max_disagreement_px: float,
) -> Int32Array:
    """(S,) number of supporting views whose own depth agrees, for the samples of one view.

    A sample's support in another view lies on a chain that has its own depths. Both describe the
    same 3D point if these depths differ by at most `max_disagreement_px` pixels of disparity.
    """
    own = depths[source]
    owners = owners_of(own.support_offsets)
    points = world_points(given.views[source], given.graph(source), own)
    counts = np.zeros(len(own.samples), np.int32)
    for other in np.unique(own.support_views).tolist():
        used = own.support_views == other
        rows = owners[used]
        inverse, sigmas = depths_at(given.graph(other), depths[other], own.support_positions[used])
        local = given.views[other].cam_from_world(points[rows])[:, 2]
        expected = 1 / np.where(local > 0, local, np.nan)
        scale = expected / own.inverse_depths[rows]
        allowed = max_disagreement_px * np.hypot(sigmas, own.sigmas[rows] * scale)
        agrees = np.abs(inverse - expected) <= allowed
        counts += np.bincount(rows[agrees], minlength=len(counts)).astype(np.int32)
    return counts


def world_points(view: View, graph: EdgeGraph, depths: ChainDepths) -> FloatArray:
    """(S, 3) world points of the samples of one view; NaN where no depth was found."""
    found = depths.found
    inverse = np.where(found, depths.inverse_depths, np.nan)
    return lift(view, graph.undistorted[depths.samples].astype(np.float64), inverse)


def depths_at(
    graph: EdgeGraph, depths: ChainDepths, positions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Inverse depth and sigma at (T,) fractional positions on a view's chains.

    Linear between two samples with depths, otherwise the value of the nearest sample; NaN if it
    has no depth.
    """
    if len(positions) == 0:
        return np.zeros(0), np.zeros(0)
    polyline = graph.polyline_ids[positions.astype(np.int64)]
    first, end = depths.sample_offsets[polyline], depths.sample_offsets[polyline + 1]
    intervals = end - first - 1
    span = depths.samples[end - 1] - depths.samples[first]
    place = (positions - depths.samples[first]) * intervals / np.maximum(span, 1)  # evenly spaced
    place = np.clip(place, 0, intervals)
    low = first + place.astype(np.int64)
    high = np.minimum(low + 1, end - 1)
    weight = place - np.floor(place)
    nearest = np.where(weight > 0.5, high, low)
    found = depths.found
    both = found[low] & found[high]
    inverse = np.where(
        both,
        (1 - weight) * depths.inverse_depths[low] + weight * depths.inverse_depths[high],
        np.where(found[nearest], depths.inverse_depths[nearest], np.nan),
    )
    return inverse, depths.sigmas[nearest]
