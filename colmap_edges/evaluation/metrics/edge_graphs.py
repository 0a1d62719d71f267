"""Metrics of 3D edges as a graph: duplicates, parallel twins, corners."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray, IntArray, blocks, joined_lists
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.groups import linked_groups
from colmap_edges.core.polylines import curve_tangents, end_points, unit
from colmap_edges.evaluation.metrics.clouds import cloud_to_cloud, scores
from colmap_edges.evaluation.metrics.curves import sample, sample_segments
from colmap_edges.evaluation.metrics.statistics import Record
from colmap_edges.evaluation.readers.curves import Curves


def times_found(
    result: Curves, reference: Curves, thresholds: Sequence[float], unit: float = 1.0
) -> list[Record]:
    """The number of times that true edges are found, at every threshold.

    Args:
        result: Reconstructed curves.
        reference: True curves; samples without segments stand for their median spacing each.
        thresholds: Distances in the unit of the comparison.
        unit: World units of that unit.

    Returns:
        For each `threshold`, the lengths of the edges near true curves (`result_length`) and of
        the true curves near edges (`found_length`), and their ratio `times`: 1 if each true edge
        is found once.
    """
    spacing = unit * min(thresholds) / 5
    found, true = sample(result, spacing), sample(reference, spacing)
    found_weights, true_weights = (sample_lengths(c, spacing) for c in (result, reference))
    to_true, to_found = cloud_to_cloud(found, true), cloud_to_cloud(true, found)
    rows: list[Record] = []
    for threshold in thresholds:
        on_curves = float(found_weights[to_true < threshold * unit].sum())
        length = float(true_weights[to_found < threshold * unit].sum())
        times = on_curves / length if length > 0 else float("nan")
        row = {"threshold": threshold, "times": times}
        rows.append(row | {"result_length": on_curves, "found_length": length})
    return rows


def sample_lengths(curves: Curves, spacing: float) -> FloatArray:
    """(N,) length represented by each sample of `curves.sample`."""
    if len(curves.segments):
        return sample_segments(curves, spacing).lengths
    # Samples coincide where curves meet or are duplicated.
    size = float(np.ptp(curves.points, axis=0).max(initial=0.0)) if len(curves.points) else 0.0
    if size == 0:
        return np.zeros(len(curves.points))
    points = curves.points / size
    distinct = np.unique(points.round(9), axis=0)
    step = float(np.median(cKDTree(distinct).query(distinct, k=2)[0][:, 1]))
    counts = cKDTree(points).query_ball_point(points, step / 4, return_length=True)
    return np.asarray(size * step / counts, np.float64)


def twin_shares(
    result: Curves, pixel_sizes: FloatArray, limits_px: Sequence[float] = (0.5, 3.0, 6.0)
) -> list[Record]:
    """Share of length with a parallel twin: another edge, or another stretch of the same edge.

    Consecutive edges are no twins: the foot of the perpendicular must be on the other edge.

    Args:
        result: Reconstructed curves; those that share points are one edge.
        pixel_sizes: (P,) length of a pixel at each point in the nearest view that observes it.
        limits_px: Distances up to which edges are twins.

    Returns:
        The `share` within each `limit_px`.
    """
    sizes = pixel_sizes[result.segments].mean(axis=1)
    points, owner, weights = sample_segments(result, sizes)
    if not len(owner):
        return [{"limit_px": limit, "share": 0.0} for limit in limits_px]
    tangents = unit(np.diff(result.points[result.segments[owner]], axis=1)[:, 0])
    nearest = nearest_twins(
        points, tangents, weights, edges_of(result)[owner], sizes[owner], max(limits_px)
    )
    return [
        {"limit_px": limit, "share": float(weights[nearest <= limit].sum() / weights.sum())}
        for limit in limits_px
    ]


def edges_of(curves: Curves) -> IntArray:
    """(S,) edge of each segment; segments that share points belong to one edge."""
    return linked_groups(curves.segments, len(curves.points))[curves.segments[:, 0]]


def nearest_twins(
    points: FloatArray,
    tangents: FloatArray,
    weights: FloatArray,
    edges: IntArray,
    sizes: FloatArray,
    limit_px: float,
) -> FloatArray:
    """(N,) distance in pixels from each sample to the nearest parallel other edge; inf without.

    Parallel is within 15 degrees. Points of the same edge less than four times `limit_px` apart
    along it are no other edge.

    Args:
        points: (N, 3) samples along edges, in order.
        tangents: (N, 3) unit directions there.
        weights: (N,) length represented by each.
        edges: (N,) edge of each.
        sizes: (N,) length of a pixel there.
        limit_px: Largest distance looked at.
    """
    nearest = np.full(len(points), np.inf)
    tree, along = cKDTree(points), np.cumsum(weights)
    cosine = np.cos(np.radians(15.0))
    for some in blocks(len(points), 20_000):
        a, b = joined_lists(tree.query_ball_point(points[some], (limit_px + 1) * sizes[some]))
        a += some.start
        apart = np.abs(along[a] - along[b]) > 4 * limit_px * sizes[a]
        keep = (edges[a] != edges[b]) | apart
        a, b = a[keep], b[keep]
        offset = points[a] - points[b]
        beside = np.einsum("ij,ij->i", offset, tangents[b])
        parallel = np.abs(np.einsum("ij,ij->i", tangents[a], tangents[b])) >= cosine
        keep = parallel & (np.abs(beside) <= 0.51 * weights[b])
        across = np.linalg.norm(offset - beside[:, None] * tangents[b], axis=1)
        np.minimum.at(nearest, a[keep], (across / sizes[a])[keep])
    return nearest


def true_corners(reference: Curves) -> FloatArray:
    """(C, 3) corners of true curves: junctions of three or more, and sharp bends.

    Points within a ten thousandth of the reference's size of each other are one.
    """
    size = float(np.ptp(reference.points, axis=0).max()) if len(reference.points) else 0.0
    points, segments = welded(reference, 1e-4 * size)
    chords = points[segments[:, 1]] - points[segments[:, 0]]
    chords /= np.linalg.norm(chords, axis=1, keepdims=True)
    return points[bent(np.concatenate(segments.T), np.concatenate([chords, -chords]), len(points))]


def bent(places: IntArray, directions: FloatArray, count: int) -> IntArray:
    """Indices of the places, of `count`, at which two or more curves meet at an angle.

    Two curves do if they turn there by at least 20 degrees.

    Args:
        places: (M,) place at which a curve ends.
        directions: (M, 3) unit direction of the curve there.
        count: Number of places.
    """
    degrees = np.bincount(places, minlength=count)
    sums = np.column_stack([np.bincount(places, d, count) for d in directions.T])
    # The sum of two unit vectors at an angle of 180 degrees minus the turn is 2 sin(turn / 2).
    turned = np.linalg.norm(sums, axis=1) >= 2 * np.sin(np.radians(20.0) / 2)
    return np.flatnonzero((degrees > 2) | ((degrees == 2) & turned))


def welded(curves: Curves, distance: float) -> tuple[FloatArray, IntArray]:
    """The points after merging those within `distance`, and the remaining segments."""
    pairs = cKDTree(curves.points).query_pairs(distance, output_type="ndarray")
    labels = linked_groups(pairs, len(curves.points))
    sums = [np.bincount(labels, axis) for axis in curves.points.T]
    points = np.column_stack(sums) / np.bincount(labels)[:, None]
    segments = np.sort(labels[curves.segments], axis=1)
    segments = np.unique(segments[segments[:, 0] != segments[:, 1]], axis=0).astype(np.int64)
    return points, segments


def found_corners(edges: Edges3D) -> FloatArray:
    """(C, 3) nodes at which edges meet at an angle."""
    tips, inward = inward_directions(edges)
    nodes = edges.end_nodes.ravel().astype(np.int64)
    used = nodes >= 0
    count = int(nodes.max(initial=-1)) + 1
    passed = np.flatnonzero(edges.nodes.through_points >= 0)
    onto = edges.nodes.through_points[passed]
    along = unit(curve_tangents(edges.points, edges.edge_offsets)[onto])
    places = np.concatenate([nodes[used], passed, passed])
    corners = bent(places, np.concatenate([inward[used], along, -along]), count)
    sums = [np.bincount(nodes[used], of, count) for of in edges.points[tips[used]].T]
    counts = np.bincount(nodes[used], minlength=count)
    return (np.column_stack(sums) / np.maximum(counts, 1)[:, None])[corners]


def inward_directions(edges: Edges3D) -> tuple[IntArray, FloatArray]:
    """(2E,) points at the ends of edges, and (2E, 3) unit directions of the edges from there.

    Directions are of parabolas through the last points, since chords of small circles also turn.
    """
    reach = 4  # points from the end to the last one that is used
    tips, inner = end_points(edges.edge_offsets, reach)
    points, middle = edges.points, (tips + inner) // 2
    curved = (np.abs(tips - inner) == reach)[:, None]
    chords = points[inner] - points[tips]
    inward = np.where(curved, 4 * (points[middle] - points[tips]) - chords, chords)
    return tips, unit(inward)


def compare_corners(
    found: FloatArray, true: FloatArray, thresholds: Sequence[float]
) -> list[Record]:
    """Precision and recall of (N, 3) corners against (M, 3) true ones, in world units.

    Each true corner is found once: of several corners nearest to the same one, only one counts.
    """
    if not len(true) or not len(found):
        return scores(np.full(len(found), np.inf), np.full(len(true), np.inf), thresholds)
    to_true, nearest = cKDTree(true).query(found)
    order = np.lexsort((to_true, nearest))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(nearest[order]) != 0
    to_true[order[~first]] = np.inf
    return scores(to_true, cloud_to_cloud(true, found), thresholds)
