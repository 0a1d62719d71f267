"""Test of whether views observe an edge along a curve, such as in the gap between two pieces.

Without it, edges that end at corners would be joined to others on the same line, such as the sides
of windows in a row.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import ChainObservations
from colmap_edges.edges2d.edge_index import IndexedGraphs, positions_near
from colmap_edges.edges3d.linking.ends import Ends, views_near
from colmap_edges.options import PipelineOptions

# positions in a gap at which an edge must be observed, as fractions
PLACES = np.array([0.25, 0.5, 0.75])


def observed_along(
    given: IndexedGraphs,
    asked: csc_array,
    points: FloatArray,
    tangents: FloatArray,
    radius_px: float,
    max_angles_deg: tuple[float, ...],
    num_threads: int,
    needed: BoolArray | None = None,
) -> ChainObservations:
    """Observations of the first points of curves, in views that observe an edge all along them.

    Args:
        given: the edge graphs of all views.
        asked: (n, V) sparse; the views that are asked about each curve.
        points: (n, k, 3) points on the curves.
        tangents: (n, k, 3) directions of the curves there.
        radius_px: search radius around the projected points.
        max_angles_deg: maximum angle between curve and chain at each of the k points.
        num_threads: threads to use; the result does not depend on it.
        needed: (n, k) which of the points must be observed; by default all.

    Returns:
        Observations of n points.
    """
    cosines = np.cos(np.radians(max_angles_deg))
    found = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64))]
    for view in np.flatnonzero(np.diff(asked.indptr)).tolist():
        rows = asked.indices[asked.indptr[view] : asked.indptr[view + 1]]
        index, places = given.index(view), np.zeros((len(rows), len(cosines)))
        for cosine in np.unique(cosines):
            at = np.ix_(rows, np.flatnonzero(cosines == cosine))
            places[:, cosines == cosine] = positions_near(
                index, radius_px, num_threads, points[at], tangents[at], float(cosine)
            )
        seen = ((places >= 0) | (False if needed is None else ~needed[rows])).all(axis=1)
        found.append((np.full(seen.sum(), view), places[seen, 0], rows[seen]))
    views, positions, curves = (np.concatenate(of) for of in zip(*found, strict=True))
    order = np.argsort(curves, kind="stable")
    return ChainObservations(
        offsets=offsets_of(np.bincount(curves, minlength=len(points))),
        views=views[order].astype(np.int32),
        positions=positions[order],
    )


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
    asked = views_near(edges, np.column_stack([a, b]), given.num_views)
    # Positions in a gap are less certain than edge points.
    radius = 1.5 * options.refinement.max_residual_px
    angles = (options.linking.max_join_angle_deg,) * len(PLACES)
    between = curves_between(ends, a, b)
    observed = observed_along(given, asked, *between, radius, angles, num_threads)
    return np.asarray(observed.counts >= options.tracing.min_observations)


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
