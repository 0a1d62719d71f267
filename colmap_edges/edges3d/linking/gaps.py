"""Test of whether views observe an edge in the gap between two pieces.

Without it, edges that end at corners would be joined to others on the same line, such as the sides
of windows in a row.
"""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges2d.edge_index import IndexedGraphs, positions_near
from colmap_edges.edges3d.linking.joining import Ends, views_near
from colmap_edges.options import PipelineOptions

# positions in a gap at which an edge must be observed, as fractions
PLACES = np.array([0.25, 0.5, 0.75])
# search radius relative to that of edge points, as positions in a gap are less certain
RADIUS_RATIO = 1.5


def are_observed(
    edges: Edges3D,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
    ends: Ends,
    a: IntArray,
    b: IntArray,
) -> BoolArray:
    """Whether enough views that observe one of two ends also observe an edge between them.

    Args:
        edges: the pieces.
        given: the edge graphs of all views.
        options: search radius and maximum angle of observations, minimum number of views.
        num_threads: threads to use; the result does not depend on it.
        ends: the ends of the pieces.
        a: (n,) ends on one side of the gaps.
        b: (n,) ends on the other side.

    Returns:
        (n,) whether an edge is observed in the gap.
    """
    points, tangents = curves_between(ends, a, b)
    asked = views_near(edges, np.column_stack([a, b]), given.num_views)
    radius = RADIUS_RATIO * options.refinement.max_residual_px
    cosine = float(np.cos(np.radians(options.linking.max_join_angle_deg)))
    counts = np.zeros(len(a), np.int64)
    for view in np.flatnonzero(np.diff(asked.indptr)).tolist():
        rows = asked.indices[asked.indptr[view] : asked.indptr[view + 1]]
        positions = positions_near(
            given.index(view), radius, num_threads, points[rows], tangents[rows], cosine
        )
        counts[rows] += (positions >= 0).all(axis=1)
    enough: BoolArray = counts >= options.tracing.min_observations
    return enough


def curves_between(ends: Ends, a: IntArray, b: IntArray) -> tuple[FloatArray, FloatArray]:
    """(n, P, 3) points at `PLACES` of cubic Hermite curves between ends, and their directions."""
    first, last = ends.positions[a], ends.positions[b]
    lengths = np.linalg.norm(last - first, axis=1, keepdims=True)
    leaving, arriving = lengths * ends.outward[a], -lengths * ends.outward[b]
    ruled = np.stack([first, leaving, last, arriving])
    points, tangents = np.einsum("dkp,kni->dnpi", hermite_weights(PLACES), ruled)
    return points, tangents


def hermite_weights(t: FloatArray) -> FloatArray:
    """(2, 4, P) Hermite weights of first point, first tangent, last point and last tangent.

    For the cubic and its derivative, at (P,) parameters in [0, 1].
    """
    places = [2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, 3 * t**2 - 2 * t**3, t**3 - t**2]
    slopes = [6 * t**2 - 6 * t, 3 * t**2 - 4 * t + 1, 6 * t - 6 * t**2, 3 * t**2 - 2 * t]
    return np.array([places, slopes])
