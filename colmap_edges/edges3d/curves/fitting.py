"""Fitting of lines, arcs, circles, ellipses and splines to 3D edges, with standard deviations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    IntArray,
    offsets_of,
    ranges_of,
)
from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import (
    ARC,
    CIRCLE,
    ELLIPSE,
    ELLIPTIC_ARC,
    LINE,
    SPLINE,
    Curves3D,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges3d.curves.arc_groups import find_arc_groups
from colmap_edges.edges3d.curves.fillets import with_fillets
from colmap_edges.edges3d.curves.joints import coordinates_in, joined_at_corners
from colmap_edges.edges3d.curves.noise import Noise
from colmap_edges.edges3d.curves.relations import regularized
from colmap_edges.edges3d.curves.segmentation import NOTHING, learn_noise, segmented
from colmap_edges.edges3d.curves.selection import SelectedCurves, select_curves
from colmap_edges.edges3d.curves.shared_circles import with_shared_circles
from colmap_edges.options import LinkingOptions


@checked
def fit_curves(edges: Edges3D, *, regularize: bool = False, num_threads: int = 1) -> Curves3D:
    """Fit the simplest curves to each edge that describe it within its standard deviations.

    Edges are cut where the curve changes. Cuts and kinds minimise the Bayesian information
    criterion (BIC; Schwarz 1978): half the sum of squared residuals in standard deviations, plus
    half the number of parameters times the logarithm of the number of points. The scale of the
    deviations and the correlation of successive points are estimated from the edges.

    Args:
        edges: the edges, whole or in segments.
        regularize: make curves exactly parallel, perpendicular, coplanar or concentric if they
            are so within their deviations.
        num_threads: number of threads; does not affect the result.

    Returns:
        The curves in the order of the edges; outliers belong to no curve.
    """
    if not edges.num_points:
        return Curves3D.none()
    noise = learn_noise(edges, num_threads)
    order = cut_order(edges, noise, num_threads)
    points = edges.points[order]
    noise = replace(noise, sigmas=noise.sigmas[order])
    segments = segmented(points, edges.edge_offsets, noise, num_threads)
    selected = select_curves(points, noise, segments, edges.closed)
    selected = with_fillets(points, noise, selected, edges.edge_offsets, edges.closed)
    selected, circles = with_shared_circles(points, noise, selected)
    curves = assembled(points, noise, selected)
    curves = joined_at_corners(curves, points, noise)
    if regularize:
        curves = regularized(curves, points, noise)
    groups = find_arc_groups(curves, circles, edges)
    return replace(curves, arc_groups=groups, ranges=ranges_in(order, selected.bounds))


def cut_order(edges: Edges3D, noise: Noise, num_threads: int) -> IntArray:
    """(N,) order of points in which closed edges start where two curves meet."""
    order = np.arange(edges.num_points)
    loops = np.flatnonzero(edges.closed)
    if not len(loops):
        return order
    offsets = offsets_of(np.diff(edges.edge_offsets)[loops])
    rows = ranges_of(edges.edge_offsets[loops], edges.edge_offsets[loops + 1])
    part = replace(noise, sigmas=noise.sigmas[rows])
    segments = segmented(edges.points[rows], offsets, part, num_threads)
    for place, edge in enumerate(loops.tolist()):
        first, end = edges.edge_offsets[edge : edge + 2].tolist()
        own = slice(segments.offsets[place], segments.offsets[place + 1])
        curved = segments.kinds[own] != NOTHING
        cuts = segments.bounds[own, 0][curved if curved.any() else ~curved] - offsets[place]
        middle = int(cuts[np.argmin(np.abs(cuts - (end - first) / 2))])
        order[first:end] = np.roll(order[first:end], -middle)
    return order


def ranges_in(order: IntArray, bounds: IntArray) -> IntArray:
    """(C, 2) ranges of the curves as indices into the edges' original points."""
    first = order[bounds[:, :1]]
    return np.asarray(np.concatenate([first, first + np.diff(bounds)], axis=1))


def assembled(points: FloatArray, noise: Noise, selected: SelectedCurves) -> Curves3D:
    """Convert the selected fits to curves, each from its first point to its last."""
    kinds, free = selected.kinds.astype(np.uint8), selected.kinds == SPLINE
    spread = np.sqrt(noise.correlation)
    splines = selected.splines[free].tolist()
    spans = np.zeros((len(kinds), 2))
    lengths = np.zeros(len(kinds), np.int64)
    spans[free] = [fit.knots[[0, -1]] for fit in splines] or np.zeros((0, 2))
    lengths[free] = [len(fit.knots) for fit in splines]
    sigmas = np.where(free[:, None], np.nan, selected.sigmas * spread)
    curves = Curves3D(
        kinds=kinds,
        edges=selected.edges,
        ranges=selected.bounds,
        arc_groups=np.arange(len(kinds)),
        frames=np.where(free[:, None, None], 0, selected.frames),
        spans=spans,
        knot_offsets=offsets_of(lengths),
        knots=np.concatenate([np.zeros(0), *(fit.knots for fit in splines)]),
        control_points=np.concatenate([np.zeros((0, 3)), *(fit.control for fit in splines)]),
        position_sigmas=sigmas[:, :2],
        direction_sigmas=sigmas[:, 2],
        radius_sigmas=np.where(has_radii(kinds)[:, None], sigmas[:, 3:], np.nan),
        control_sigmas=np.concatenate([np.zeros(0), *(fit.sigmas for fit in splines)]) * spread,
    )
    return bounded_arcs(bounded_lines(curves, points), points)


def has_radii(kinds: ByteArray) -> BoolArray:
    """(C,) whether a curve has radii (arcs, circles, ellipses)."""
    return np.asarray((kinds != LINE) & (kinds != SPLINE))


def bounded_lines(curves: Curves3D, points: FloatArray) -> Curves3D:
    """Bound lines by the foot points of their first and last points."""
    which = np.flatnonzero(curves.kinds == LINE)
    frames, positions = curves.frames.copy(), curves.position_sigmas.copy()
    ends = points[np.column_stack([curves.ranges[which, 0], curves.ranges[which, 1] - 1])]
    origin, direction = frames[which, 0], frames[which, 1]
    along = np.einsum("cij,cj->ci", ends - origin[:, None], direction)
    flip = np.where(along[:, 1] < along[:, 0], -1.0, 1.0)
    direction, along = direction * flip[:, None], along * flip[:, None]
    frames[which, 0] = origin + along[:, :1] * direction
    frames[which, 1] = (along[:, 1:] - along[:, :1]) * direction
    lever = along * curves.direction_sigmas[which, None]
    positions[which] = np.hypot(positions[which], lever)
    spans = curves.spans.copy()
    spans[which] = (0, 1)
    return replace(curves, frames=frames, position_sigmas=positions, spans=spans)


def bounded_arcs(curves: Curves3D, points: FloatArray) -> Curves3D:
    """Bound arcs by their first and last points; nearly closed ones become closed."""
    kinds, frames, spans = curves.kinds.copy(), curves.frames.copy(), curves.spans.copy()
    for curve in np.flatnonzero(has_radii(kinds)).tolist():
        first, end = curves.ranges[curve].tolist()
        x, y = coordinates_in(frames[curve][None], points[first:end])
        angles = np.unwrap(np.arctan2(y, x))
        if angles[-1] < angles[0]:
            frames[curve, 2] *= -1
            angles = -angles
        step = abs(angles[-1] - angles[0]) / (len(angles) - 1)
        open_kind = kinds[curve] in (ARC, ELLIPTIC_ARC)
        # A gap across which edges are joined is closed.
        largest = LinkingOptions().max_gap_spacings * step
        if open_kind and 2 * np.pi - (angles[-1] - angles[0]) > largest:
            spans[curve] = angles[0], angles[-1]
        else:
            kinds[curve] = CIRCLE if kinds[curve] in (ARC, CIRCLE) else ELLIPSE
            spans[curve] = angles[0], angles[0] + 2 * np.pi
    return replace(curves, kinds=kinds, frames=frames, spans=spans)
