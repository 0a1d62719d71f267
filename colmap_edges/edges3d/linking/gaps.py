"""Tests whether views observe an edge in the gap between two pieces.

Without that, edges that end at corners would be joined to others that happen to lie on the same
line, as the sides of windows in a row do.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges2d.edge_index import IndexedGraphs, positions_near
from colmap_edges.edges3d.linking.joining import Ends, views_near
from colmap_edges.options import PipelineOptions

PLACES = np.array([0.25, 0.5, 0.75])  # along a gap, at which an edge must be observed
RADIUS_RATIO = 1.5  # what lies in between is known less well than edge points are


def are_observed(
    edges: Edges3D,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
    ends: Ends,
    a: IntArray,
    b: IntArray,
) -> BoolArray:
    """Whether enough of the views that observe one of two ends observe an edge between them.

    Args:
        edges: the pieces.
        given: the edge graphs of all views.
        options: how near to a chain and how parallel to it an edge is observed, and how many
            views are enough.
        num_threads: threads to use; the result does not depend on it.
        ends: those of the pieces.
        a: (n,) the one ends.
        b: (n,) the others.

    Returns:
        (n,) whether they do.
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
    """(n, P, 3) points at `PLACES` of smooth curves from ends to ends, and their directions."""
    positions = np.stack([ends.positions[a], ends.positions[b]])
    lengths = np.linalg.norm(positions[1] - positions[0], axis=1, keepdims=True)
    leaving, arriving = lengths * ends.outward[a], -lengths * ends.outward[b]
    curves = CubicHermiteSpline([0, 1], positions, np.stack([leaving, arriving]))
    return curves(PLACES).swapaxes(0, 1), curves(PLACES, 1).swapaxes(0, 1)
