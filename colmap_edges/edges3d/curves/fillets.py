"""Small arcs between two lines that are tangent to both: rounded corners of a few points.

An arc has eight parameters, and the few points of a small one cost less as outliers. Tangent to the
lines on both sides, it has one: its radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, Table, joined_tables
from colmap_edges.core.curves3d import ARC, LINE
from colmap_edges.core.polylines import nearest_on_lines, unit
from colmap_edges.edges3d.curves.joints import MAX_POINTS_BETWEEN
from colmap_edges.edges3d.curves.lines_and_circles import fit_tangent_arcs
from colmap_edges.edges3d.curves.noise import Noise
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS, Fits
from colmap_edges.edges3d.curves.selection import MAX_RADIUS_DOUBT, SelectedCurves


@dataclass(frozen=True, kw_only=True)
class RoundedCorners(Table):
    """Gaps of outliers between successive lines, in the plane of both lines.

    Attributes:
        left: (B,) line before the gap.
        bounds: (B, 2) range of the points in the gap.
        corners: (B, 3) meeting points of the lines.
        axes: (B, 2, 3) unit directions from the corner to the centre of the arc, and along the
            arc's middle.
        slopes: (B,) distances of the centres from the corners, in radii.
        max_radii: (B,) largest radius for which the arc touches the lines where they have points.
    """

    left: IntArray
    bounds: IntArray
    corners: FloatArray
    axes: FloatArray
    slopes: FloatArray
    max_radii: FloatArray


def with_fillets(
    points: FloatArray,
    noise: Noise,
    curves: SelectedCurves,
    offsets: IntArray,
    closed: BoolArray,
) -> SelectedCurves:
    """Add arcs tangent to two successive lines where outliers between these lie on one.

    Args:
        points: (N, 3) edge points.
        noise: the noise of the points.
        curves: the curves.
        offsets: (E + 1,) offsets of the points of the edges.
        closed: (E,) whether the edges are closed.
    """
    found = find_rounded_corners(points, noise, curves, offsets, closed)
    if not len(found.left):
        return curves
    gaps = noise.sequences(points, found.bounds)
    arcs = fit_tangent_arcs(gaps, found.corners, found.axes, found.slopes)
    radii, sigmas = np.linalg.norm(arcs.frames[:, 1], axis=1), arcs.sigmas[:, 3]
    # The radius is the only parameter of a fillet.
    costs = noise.costs(gaps, arcs.squares)
    costs += noise.parameter_costs(np.diff(offsets)[curves.edges[found.left]])
    fine = (costs < noise.outlier_cost * gaps.lengths) & (radii <= found.max_radii)
    fine &= sigmas * np.sqrt(noise.correlation) < MAX_RADIUS_DOUBT * radii
    return inserted(curves, found, np.flatnonzero(fine), arcs, costs)


def find_rounded_corners(
    points: FloatArray,
    noise: Noise,
    curves: SelectedCurves,
    offsets: IntArray,
    closed: BoolArray,
) -> RoundedCorners:
    """Find gaps between successive lines in one plane that turn at an angle."""
    left, right, bounds = gaps_between(curves, offsets, closed)
    before, behind = directed(points, curves, left), directed(points, curves, right)
    cosines = np.einsum("ij,ij->i", before, behind)
    turning = (cosines < np.cos(np.radians(20.0))) & (cosines > np.cos(np.radians(150.0)))
    left, right, bounds, before, behind, cosines = (
        of[turning] for of in (left, right, bounds, before, behind, cosines)
    )
    feet = nearest_on_lines(curves.frames[left, 0], before, curves.frames[right, 0], behind)
    corners = (feet[0] + feet[1]) / 2
    sigmas = noise.sigmas[curves.bounds[left, 1] - 1] + noise.sigmas[curves.bounds[right, 0]]
    halves = np.arccos(cosines) / 2
    starts = points[curves.bounds[left, 0]], points[curves.bounds[right, 1] - 1]
    lengths = np.minimum(*(np.linalg.norm(start - corners, axis=1) for start in starts))
    found = RoundedCorners(
        left=left,
        bounds=bounds,
        corners=corners,
        axes=np.stack([unit(behind - before), unit(before + behind)], axis=1),
        slopes=1 / np.cos(halves),
        max_radii=lengths / np.tan(halves),
    )
    return found.select(np.linalg.norm(feet[1] - feet[0], axis=1) < OUTLIER_SIGMAS * sigmas)


def gaps_between(
    curves: SelectedCurves, offsets: IntArray, closed: BoolArray
) -> tuple[IntArray, ...]:
    """Lines before and behind each gap of a few outliers, and its (n, 2) range of points."""
    count = len(curves.kinds)
    edges = curves.edges
    left = np.arange(count)
    last = np.diff(edges, append=-1) != 0
    first_of = np.searchsorted(edges, edges)
    right = np.where(last, first_of, np.minimum(left + 1, count - 1))
    first = curves.bounds[:, 1]
    end = np.where(last, offsets[edges + 1], curves.bounds[right, 0])
    # Around the seam of a closed edge, where the next curve begins with the edge's first point.
    seam = last & closed[edges] & (curves.bounds[right, 0] == offsets[edges]) & (right != left)
    sizes = end - first
    # Fewer than three points are what blur makes of a corner.
    keep = (~last | seam) & (sizes >= 3) & (sizes <= MAX_POINTS_BETWEEN)
    keep &= (curves.kinds == LINE) & (curves.kinds[right] == LINE)
    return left[keep], right[keep], np.column_stack([first, end])[keep]


def directed(points: FloatArray, curves: SelectedCurves, lines: IntArray) -> FloatArray:
    """(n, 3) unit directions of lines from their first points to their last."""
    first, last = curves.bounds[lines, 0], curves.bounds[lines, 1] - 1
    ways = curves.frames[lines, 1]
    sign = np.sign(np.einsum("ij,ij->i", points[last] - points[first], ways))
    return np.asarray(unit(ways) * sign[:, None])


def inserted(
    curves: SelectedCurves, found: RoundedCorners, which: IntArray, arcs: Fits, costs: FloatArray
) -> SelectedCurves:
    """The curves with the selected fillets in their places."""
    found, sigmas = found.select(which), arcs.sigmas[which, 3]
    middle, turn = curves.sigmas[found.left, 0], curves.sigmas[found.left, 2]
    columns = np.hypot(found.slopes * sigmas, middle), middle, turn, sigmas, sigmas
    fillets = SelectedCurves(
        kinds=np.full(len(which), ARC),
        edges=curves.edges[found.left],
        bounds=found.bounds,
        frames=arcs.frames[which],
        sigmas=np.column_stack(columns),
        costs=costs[which],
        splines=np.full(len(which), None),
    )
    order = np.argsort(np.append(np.arange(len(curves.kinds)), found.left + 0.5), kind="stable")
    return joined_tables([curves, fillets]).select(order)
