"""Nodes at which ends of edges meet: points with their own standard deviations and tracks.

Nodes are corners, joints of consecutive edges, and T junctions, where an edge ends on another one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of
from colmap_edges.core.edges3d import Edges3D, Nodes
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.core.polylines import curve_tangents, end_points
from colmap_edges.edges2d.edge_index import IndexedGraphs
from colmap_edges.edges3d.linking.bends import go_on_smoothly
from colmap_edges.edges3d.linking.corners3d import (
    MAX_MISS_SPACINGS,
    MAX_PAST_SPACINGS,
    MIN_ANGLE_DEG,
    MIN_SEEN_RATIO,
    Corners,
    Lines,
    fit_lines,
    observe,
    order_to,
)
from colmap_edges.edges3d.linking.joining import REACH, Ends, near_pairs, views_near
from colmap_edges.options import PipelineOptions

# Minimum number of points of an edge that ends on another one: two or three points fit any line.
MIN_JUNCTION_POINTS = 4
MIN_SIGMA_SPACINGS = 1e-3  # minimum standard deviation of an end


@dataclass(frozen=True, kw_only=True)
class Meetings:
    """Ends that meet at nodes, and the points of edges that pass through these nodes.

    Attributes:
        corners: the ends and the nodes at which they meet.
        through: (C,) the edge point that passes through each node, -1 where none does.
    """

    corners: Corners
    through: IntArray

    def select(self, nodes: BoolArray) -> Meetings:
        """The selected nodes, renumbered, with their ends."""
        left = nodes[self.corners.owners]
        corners = Corners(
            positions=self.corners.positions[nodes],
            members=self.corners.members[left],
            owners=(np.cumsum(nodes) - 1)[self.corners.owners[left]],
        )
        return Meetings(corners=corners, through=self.through[nodes])


def meet_at_nodes(
    edges: Edges3D, given: IndexedGraphs, options: PipelineOptions, num_threads: int
) -> Edges3D:
    """Create nodes where ends of edges meet, and extend the ends to them.

    Args:
        edges: linked edges, extended to corners.
        given: the edge graphs of all views.
        options: maximum distance of ends that meet, search radius, minimum number of views.
        num_threads: threads to use; the result does not depend on it.
    """
    if edges.num_edges == 0:
        return edges
    lines = fit_lines(edges)
    meetings = with_junctions(edges, lines, meeting_ends(edges, lines, options), options)
    meetings, observed = observed_meetings(edges, lines, meetings, given, options, num_threads)
    corners = meetings.corners
    nodes = Nodes(
        points=corners.positions,
        sigmas=node_sigmas(edges, lines, meetings),
        observations=Observations.of_positions(observed),
        colors=np.zeros(corners.positions.shape, np.uint8),
        through_points=meetings.through,
    )
    return run_to_nodes(edges, lines, corners, nodes)


def meeting_ends(edges: Edges3D, lines: Lines, options: PipelineOptions) -> Meetings:
    """Find open ends near each other whose lines meet in one point."""
    radius = options.linking.node_radius_spacings
    a, b, gap = near_pairs(lines.ends, radius)
    is_open = np.repeat(~edges.closed, 2)
    # Ends of parallel neighbouring edges point in the same direction and do not meet.
    cosine = np.einsum("ij,ij->i", lines.ends.outward[a], lines.ends.outward[b])
    keep = is_open[a] & is_open[b] & (cosine <= np.cos(np.radians(MIN_ANGLE_DEG)))
    keep &= a // 2 != b // 2
    led = share_place(lines.ends)
    keep[keep] = (led[a] & led[b])[keep] | ~go_on_smoothly(edges, a[keep], b[keep])
    links = nearest_links(a[keep], b[keep], np.linalg.norm(gap[keep], axis=1))
    count = len(lines.centers)
    graph = coo_array((np.ones(len(links)), links.T), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    members = np.flatnonzero(np.bincount(labels)[labels] > 1)
    owners = np.unique(labels[members], return_inverse=True)[1].astype(np.int64)
    none = np.zeros((int(owners.max(initial=-1)) + 1, 3))
    corners = Corners(positions=none, members=members, owners=owners)
    # Ends extended to a corner determine its position; otherwise all ends, then those near it.
    told = np.bincount(owners[led[members]], minlength=len(none)) > 0
    firm = led[members] | ~told[owners]
    of_these = replace(corners, members=members[firm], owners=owners[firm])
    for _ in range(2):
        corners = replace(corners, positions=solve_nodes(edges, lines, of_these)[0])
        along, miss = lines.reaches(corners.members[:, None], corners.points[:, None])
        near = (np.abs(along) <= radius) & (miss <= MAX_MISS_SPACINGS)
        corners = of_these = corners.select(near[:, 0] | led[corners.members])
    used = np.bincount(corners.owners, minlength=len(none)) > 0
    return Meetings(corners=corners, through=np.full(len(none), -1, np.int64)).select(used)


def share_place(ends: Ends) -> BoolArray:
    """(2E,) whether an end coincides with another one, as ends extended to one corner do."""
    _, place, counts = np.unique(ends.positions, axis=0, return_inverse=True, return_counts=True)
    return np.asarray((counts[place.ravel()] > 1) & (ends.spacings > 0))


def nearest_links(a: IntArray, b: IntArray, distances: FloatArray) -> IntArray:
    """(L, 2) pairs of each end with its nearest end only, since corners may be close together."""
    order = np.argsort(np.tile(distances, 2), kind="stable")
    ends, others = np.concatenate([a, b])[order], np.concatenate([b, a])[order]
    each, first = np.unique(ends, return_index=True)
    return np.column_stack([each, others[first]])


def solve_nodes(edges: Edges3D, lines: Lines, corners: Corners) -> tuple[FloatArray, FloatArray]:
    """(C, 3) weighted least-squares points of the lines of their ends, (C, 3, 3) covariances.

    The ends' positions, with a standard deviation of one spacing, fix points along parallel lines.
    """
    members, count = corners.members, len(corners.positions)
    outward, spacings = lines.outward[members], lines.ends.spacings[members]
    spacings = np.maximum(spacings, 1e-6 * spacings.max(initial=0.0))
    tips, _ = end_points(edges.edge_offsets, 0)
    sigmas = np.nan_to_num(edges.sigmas[tips[members]], nan=0.0, posinf=0.0)
    across = np.eye(3) - outward[:, :, None] * outward[:, None, :]
    across /= np.maximum(sigmas, MIN_SIGMA_SPACINGS * spacings)[:, None, None] ** 2
    stay = 1 / spacings**2
    information, pulls = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(information, corners.owners, across + stay[:, None, None] * np.eye(3))
    pull = np.einsum("nij,nj->ni", across, lines.centers[members])
    np.add.at(pulls, corners.owners, pull + stay[:, None] * lines.ends.positions[members])
    information[np.bincount(corners.owners, minlength=count) == 0] = np.eye(3)
    covariances = np.asarray(np.linalg.inv(information), np.float64)
    return np.asarray(np.einsum("nij,nj->ni", covariances, pulls), np.float64), covariances


def node_sigmas(edges: Edges3D, lines: Lines, meetings: Meetings) -> FloatArray:
    """(C,) standard deviations of nodes in their most uncertain directions."""
    if len(meetings.through) == 0:
        return np.zeros(0)
    information = np.linalg.inv(solve_nodes(edges, lines, meetings.corners)[1])
    passed = np.flatnonzero(meetings.through >= 0)
    points = meetings.through[passed]
    tangents = unit_tangents(edges)[points]
    across = np.eye(3) - tangents[:, :, None] * tangents[:, None, :]
    known = (edges.sigmas[points] > 0) & np.isfinite(edges.sigmas[points])
    weights = np.where(known, 1 / np.where(known, edges.sigmas[points], 1) ** 2, 0)
    information[passed] += across * weights[:, None, None]
    return np.asarray(1 / np.sqrt(np.linalg.eigvalsh(information)[:, 0]), np.float64)


def unit_tangents(edges: Edges3D) -> FloatArray:
    """(N, 3) unit directions along the edges."""
    tangents = curve_tangents(edges.points, edges.edge_offsets)
    lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
    return np.asarray(tangents / (lengths + 1e-300), np.float64)


def with_junctions(
    edges: Edges3D, lines: Lines, meetings: Meetings, options: PipelineOptions
) -> Meetings:
    """Add T junctions: ends that meet no other end, but the inside of another edge."""
    reach = options.linking.node_radius_spacings
    known = np.diff(edges.edge_offsets) >= MIN_JUNCTION_POINTS
    free = np.repeat(~edges.closed & known, 2)
    free[meetings.corners.members] = False
    of, onto = pairs_beside(edges, lines, np.flatnonzero(free), reach)
    tangents = unit_tangents(edges)[onto]
    outward, spacings = lines.outward[of], lines.ends.spacings[of] + 1e-300
    cosine = np.einsum("ij,ij->i", outward, tangents)
    away = lines.centers[of] - edges.points[onto]
    # The point on the tangent nearest to the line of the end.
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    shift = np.einsum("ij,ij->i", away, tangents) - cosine * np.einsum("ij,ij->i", away, outward)
    places = edges.points[onto] + (shift / sine2)[:, None] * tangents
    along, miss = (each[:, 0] for each in lines.reaches(of[:, None], places[:, None]))
    steps = np.linalg.norm(places - edges.points[onto], axis=1) / spacings
    fits = (np.abs(cosine) <= np.cos(np.radians(MIN_ANGLE_DEG))) & (steps <= 1)
    fits &= (along >= -MAX_PAST_SPACINGS) & (along <= reach) & (miss <= MAX_MISS_SPACINGS)
    rows = np.flatnonzero(fits)[np.argsort((np.abs(along) + 2 * miss + steps)[fits], kind="stable")]
    rows = rows[np.unique(of[rows], return_index=True)[1]]
    points, owners = np.unique(onto[rows], return_inverse=True)
    first = np.unique(owners, return_index=True)[1]
    earlier = len(meetings.through)
    corners = Corners(
        positions=np.concatenate([meetings.corners.positions, places[rows][first]]),
        members=np.concatenate([meetings.corners.members, of[rows]]),
        owners=np.concatenate([meetings.corners.owners, earlier + owners]).astype(np.int64),
    )
    return Meetings(corners=corners, through=np.concatenate([meetings.through, points]))


def pairs_beside(
    edges: Edges3D, lines: Lines, of: IntArray, reach: float
) -> tuple[IntArray, IntArray]:
    """Pairs of ends and inner points of other edges, within a distance in spacings."""
    sizes = np.diff(edges.edge_offsets)[edges.edge_ids]
    ranks = np.arange(edges.num_points) - edges.edge_offsets[edges.edge_ids]
    inside = (np.minimum(ranks, sizes - 1 - ranks) > REACH) | edges.closed[edges.edge_ids]
    candidates = np.flatnonzero(inside)
    if len(candidates) == 0 or len(of) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    radius = (reach + 1) * lines.ends.spacings[of]
    tree = cKDTree(edges.points[candidates])
    found = tree.query_ball_point(lines.ends.positions[of], radius, return_sorted=True)
    ends = np.repeat(of, [len(row) for row in found])
    onto = candidates[np.concatenate([np.asarray(row, np.int64) for row in found])]
    other = edges.edge_ids[onto] != ends // 2
    return ends[other], onto[other]


def observed_meetings(
    edges: Edges3D,
    lines: Lines,
    meetings: Meetings,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> tuple[Meetings, ChainObservations]:
    """The nodes that enough views observe, with one observation per view."""
    corners = meetings.corners
    asked = views_near(edges, corners.members[:, None], given.num_views)
    seen = observe(corners, lines.ends, asked, given, options, num_threads)
    count = len(meetings.through)
    owners, num_views = corners.owners[seen.points], given.num_views
    _, first = np.unique(owners * num_views + seen.views, return_index=True)
    of_nodes = ChainObservations(
        offsets=offsets_of(np.bincount(owners[first], minlength=count)),
        views=seen.views[first],
        positions=seen.positions[first],
    )
    # The threshold is relative to the end with the fewest views, which must see the node, too.
    num_asked = np.full(count, np.iinfo(np.int64).max)
    np.minimum.at(
        num_asked, corners.owners, np.bincount(asked.indices, minlength=len(corners.members))
    )
    least = np.maximum(options.tracing.min_observations, MIN_SEEN_RATIO * num_asked)
    enough = of_nodes.counts >= least
    return meetings.select(enough), of_nodes.select(np.flatnonzero(enough))


def run_to_nodes(edges: Edges3D, lines: Lines, corners: Corners, nodes: Nodes) -> Edges3D:
    """Extend ends to nodes, and move the points of passing edges to them."""
    owners = corners.owners
    longer = replace(
        edges,
        points=np.concatenate([edges.points, nodes.points[owners]]),
        observations=Observations.concatenated(
            [edges.observations, nodes.observations.select(owners)]
        ),
        sigmas=np.concatenate([edges.sigmas, nodes.sigmas[owners]]),
        colors=np.concatenate([edges.colors, nodes.colors[owners]]),
    )
    order, lengths = order_to(edges, lines.ends, corners)
    through = nodes.through_points
    passed = np.flatnonzero(through >= 0)
    # In an edge that passes through a node, the node replaces the edge's point.
    stands = np.arange(len(longer.points))
    ends_at = np.unique(owners, return_index=True)[1]
    stands[through[passed]] = edges.num_points + ends_at[passed]
    new_index = np.full(len(longer.points), -1, np.int64)
    new_index[order] = np.arange(len(order))
    end_nodes = np.full(2 * edges.num_edges, -1, np.int32)
    end_nodes[corners.members] = owners
    through = np.where(through >= 0, new_index[through], -1)
    longer = longer.reordered(
        stands[order], offsets_of(lengths), edges.closed, end_nodes.reshape(-1, 2)
    )
    return replace(longer, nodes=replace(nodes, through_points=through))
