"""Nodes at which ends of edges meet: points with their own standard deviations and tracks.

Nodes are corners, to which edges are extended if views observe the extension; joints of consecutive
edges; and T junctions, where an edge ends on another one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    FloatArray,
    IntArray,
    joined_lists,
    offsets_of,
    ranges_of,
    ranks_of,
)
from colmap_edges.core.edges3d import Edges3D, Nodes
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.core.polylines import curve_tangents, nearest_on_lines, unit
from colmap_edges.edges2d.edge_index import IndexedGraphs
from colmap_edges.edges3d.linking.bends import go_on_smoothly
from colmap_edges.edges3d.linking.corners import (
    EndLines,
    Meetings,
    find_corners,
    fit_end_lines,
    meeting_points,
)
from colmap_edges.edges3d.linking.ends import (
    MAX_MISS_SPACINGS,
    MIN_ANGLE_DEG,
    REACH,
    SHORT_GAP,
    near_pairs,
    num_behind,
    views_near,
)
from colmap_edges.edges3d.linking.gaps import observed_along
from colmap_edges.options import PipelineOptions

# Minimum number of points of an edge that ends on another one: two or three points fit any line.
MIN_JUNCTION_POINTS = 4
MIN_GAP_SPACINGS = 0.5  # distance within which the node replaces an edge point
# positions at which an edge must be observed, from the node back to the end, as fractions
WAY = np.array([0, 1 / 3, 2 / 3])
MIN_SEEN_RATIO = 0.5  # minimum share of an end's observing views that observe the extension


def meet_at_nodes(
    edges: Edges3D, given: IndexedGraphs, options: PipelineOptions, num_threads: int
) -> Edges3D:
    """Create nodes where ends of edges meet, and extend or shorten the ends to them.

    Args:
        edges: linked edges.
        given: the edge graphs of all views.
        options: maximum distances of corners and of ends that meet, search radius, minimum number
            of views.
        num_threads: threads to use; the result does not depend on it.
    """
    if edges.num_edges == 0:
        return edges
    lines, reach = fit_end_lines(edges), options.linking.max_corner_spacings
    corners = find_corners(edges, lines, reach)
    observed, least = observe(edges, lines, corners, given, options, num_threads)
    corners = corners.with_ends(observed.counts >= least)
    positions = lines.ends.positions.copy()
    positions[corners.members] = corners.points
    lines = replace(lines, ends=replace(lines.ends, positions=positions))
    meetings = with_joints(edges, lines, corners, options.linking.node_radius_spacings)
    meetings = with_junctions(edges, lines, meetings, options.linking.node_radius_spacings)
    meetings, track = observed_meetings(edges, lines, meetings, given, options, num_threads)
    nodes = Nodes(
        points=meetings.positions,
        sigmas=node_sigmas(edges, lines, meetings),
        observations=Observations.of_positions(track),
        colors=np.zeros(meetings.positions.shape, np.uint8),
        through_points=meetings.through,
    )
    return extended(edges, lines, meetings, nodes)


def with_joints(edges: Edges3D, lines: EndLines, corners: Meetings, radius: float) -> Meetings:
    """Add joints: open ends near each other, or near a corner, whose lines meet in one point."""
    at_corner = np.zeros(len(lines.centers), bool)
    at_corner[corners.members] = True
    a, b, gap = near_pairs(lines.ends, radius)
    is_open = np.repeat(~edges.closed, 2)
    # Ends of parallel neighbouring edges point in the same direction and do not meet.
    cosine = np.einsum("ij,ij->i", lines.outward[a], lines.outward[b])
    keep = is_open[a] & is_open[b] & (cosine <= np.cos(np.radians(MIN_ANGLE_DEG)))
    keep &= a // 2 != b // 2
    keep[keep] = (at_corner[a] & at_corner[b])[keep] | ~go_on_smoothly(edges, a[keep], b[keep])
    links = nearest_links(a[keep], b[keep], np.linalg.norm(gap[keep], axis=1))
    meetings = Meetings.of_links(links[:, 0], links[:, 1], len(lines.centers))
    # Ends extended to a corner determine its position; otherwise all ends, then those near it.
    placed = at_corner[meetings.members]
    certain = placed | (np.bincount(meetings.owners, placed) == 0)[meetings.owners]
    rows = replace(meetings, members=meetings.members[certain], owners=meetings.owners[certain])
    for _ in range(2):
        tips, sigmas = lines.ends.positions[rows.members], lines.sigmas[rows.members]
        meetings = replace(meetings, positions=meeting_points(lines, rows, tips, sigmas)[0])
        along, miss = lines.reaches(meetings.members, meetings.points)
        near = (np.abs(along) <= radius) & (miss <= MAX_MISS_SPACINGS)
        meetings = rows = meetings.with_ends(near | at_corner[meetings.members])
    return meetings


def nearest_links(a: IntArray, b: IntArray, distances: FloatArray) -> IntArray:
    """(L, 2) pairs of each end with its nearest end only, since corners may be close together."""
    order = np.argsort(np.tile(distances, 2), kind="stable")
    ends, others = np.concatenate([a, b])[order], np.concatenate([b, a])[order]
    each, first = np.unique(ends, return_index=True)
    return np.column_stack([each, others[first]])


def node_sigmas(edges: Edges3D, lines: EndLines, meetings: Meetings) -> FloatArray:
    """(C,) standard deviations of nodes in their most uncertain directions."""
    if len(meetings.through) == 0:
        return np.zeros(0)
    sigmas = lines.sigmas[meetings.members]
    information = np.linalg.inv(meeting_points(lines, meetings, meetings.points, sigmas)[1])
    passed = np.flatnonzero(meetings.through >= 0)
    points = meetings.through[passed]
    tangents = unit(curve_tangents(edges.points, edges.edge_offsets))[points]
    across = np.eye(3) - tangents[:, :, None] * tangents[:, None, :]
    known = (edges.sigmas[points] > 0) & np.isfinite(edges.sigmas[points])
    weights = np.where(known, 1 / np.where(known, edges.sigmas[points], 1) ** 2, 0)
    information[passed] += across * weights[:, None, None]
    return np.asarray(1 / np.sqrt(np.linalg.eigvalsh(information)[:, 0]), np.float64)


def with_junctions(edges: Edges3D, lines: EndLines, meetings: Meetings, reach: float) -> Meetings:
    """Add T junctions: ends that meet no other end, but the inside of another edge."""
    known = np.diff(edges.edge_offsets) >= MIN_JUNCTION_POINTS
    free = np.repeat(~edges.closed & known, 2)
    free[meetings.members] = False
    of, onto = pairs_beside(edges, lines, np.flatnonzero(free), reach)
    tangents = unit(curve_tangents(edges.points, edges.edge_offsets))[onto]
    beside, outward = edges.points[onto], lines.outward[of]
    _, places = nearest_on_lines(lines.centers[of], outward, beside, tangents)
    along, miss = lines.reaches(of, places)
    steps = np.linalg.norm(places - beside, axis=1) / (lines.ends.spacings[of] + 1e-300)
    cosine = np.abs(np.einsum("ij,ij->i", outward, tangents))
    fits = (cosine <= np.cos(np.radians(MIN_ANGLE_DEG))) & (steps <= 1)
    fits &= lines.may_reach(of, places, reach)
    rows = np.flatnonzero(fits)[np.argsort((np.abs(along) + 2 * miss + steps)[fits], kind="stable")]
    rows = rows[np.unique(of[rows], return_index=True)[1]]
    points, owners = np.unique(onto[rows], return_inverse=True)
    first = np.unique(owners, return_index=True)[1]
    return Meetings(
        positions=np.concatenate([meetings.positions, places[rows][first]]),
        members=np.concatenate([meetings.members, of[rows]]),
        owners=np.concatenate([meetings.owners, len(meetings.through) + owners]).astype(np.int64),
        through=np.concatenate([meetings.through, points]),
    )


def pairs_beside(
    edges: Edges3D, lines: EndLines, of: IntArray, reach: float
) -> tuple[IntArray, IntArray]:
    """Pairs of ends and inner points of other edges, within a distance in spacings."""
    sizes = np.diff(edges.edge_offsets)[edges.edge_ids]
    ranks = ranks_of(np.diff(edges.edge_offsets))
    inside = (np.minimum(ranks, sizes - 1 - ranks) > REACH) | edges.closed[edges.edge_ids]
    candidates = np.flatnonzero(inside)
    if len(candidates) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    radius = (reach + 1) * lines.ends.spacings[of]
    tree = cKDTree(edges.points[candidates])
    found = tree.query_ball_point(lines.ends.positions[of], radius, return_sorted=True)
    rows, near = joined_lists(found)
    ends, onto = of[rows], candidates[near]
    other = edges.edge_ids[onto] != ends // 2
    return ends[other], onto[other]


def observe(
    edges: Edges3D,
    lines: EndLines,
    meetings: Meetings,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> tuple[ChainObservations, FloatArray]:
    """Observations of the meetings of M ends, on any chain, in the views that observe the ends.

    If it is farther than `SHORT_GAP` from the end, a view must also observe the extension.

    Returns:
        Observations of M points, and the (M,) numbers of observations that they need.
    """
    tips, angle = lines.ends.positions[meetings.members], options.refinement.max_tangent_angle_deg
    asked = views_near(edges, meetings.members[:, None], given.num_views)
    away = meetings.points - tips
    far = np.linalg.norm(away, axis=1) > SHORT_GAP * lines.ends.spacings[meetings.members]
    observed = observed_along(
        given,
        asked,
        meetings.points[:, None] - WAY[:, None] * away[:, None],
        np.stack([lines.ends.outward[meetings.members], away, away], axis=1),
        options.refinement.max_residual_px,
        (90.0, angle, angle),
        num_threads,
        np.column_stack([np.ones(len(far), bool), far, far]),
    )
    num_asked = np.bincount(asked.indices, minlength=len(meetings.members))
    return observed, np.maximum(options.tracing.min_observations, MIN_SEEN_RATIO * num_asked)


def observed_meetings(
    edges: Edges3D,
    lines: EndLines,
    meetings: Meetings,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> tuple[Meetings, ChainObservations]:
    """The meetings that enough views observe, with one observation per view."""
    seen, least = observe(edges, lines, meetings, given, options, num_threads)
    count = len(meetings.through)
    owners = meetings.owners[seen.points]
    _, first = np.unique(owners * given.num_views + seen.views, return_index=True)
    track = ChainObservations(
        offsets=offsets_of(np.bincount(owners[first], minlength=count)),
        views=seen.views[first],
        positions=seen.positions[first],
    )
    # The end with the fewest views, which must see the node, too, determines how many are needed.
    needed = np.full(count, np.inf)
    np.minimum.at(needed, meetings.owners, least)
    enough = track.counts >= needed
    return meetings.select(enough), track.select(np.flatnonzero(enough))


def extended(edges: Edges3D, lines: EndLines, meetings: Meetings, nodes: Nodes) -> Edges3D:
    """Extend ends to nodes, and move the points of passing edges to them."""
    owners, members = meetings.owners, meetings.members
    longer = replace(
        edges,
        points=np.concatenate([edges.points, nodes.points[owners]]),
        observations=Observations.concatenated(
            [edges.observations, nodes.observations.select(owners)]
        ),
        sigmas=np.concatenate([edges.sigmas, nodes.sigmas[owners]]),
        colors=np.concatenate([edges.colors, nodes.colors[owners]]),
    )
    # Points beyond a node or next to it are left out.
    limits = MIN_GAP_SPACINGS * lines.ends.spacings[members]
    skip = num_behind(edges, members, meetings.points, -lines.ends.outward[members], limits)
    begins, stops = edges.edge_offsets[:-1] + skip[::2], edges.edge_offsets[1:] - skip[1::2]
    points = np.concatenate([ranges_of(begins, stops), edges.num_points + np.arange(len(members))])
    of = np.concatenate([np.repeat(np.arange(edges.num_edges), stops - begins), members // 2])
    rank = np.concatenate([np.zeros(len(points) - len(members)), np.where(members % 2 == 0, -1, 1)])
    order = points[np.lexsort((rank, of))]  # stable: points of an edge stay in their order
    # In an edge that passes through a node, the node replaces the edge's point.
    through = nodes.through_points
    passed = np.flatnonzero(through >= 0)
    stands = np.arange(len(longer.points))
    ends_at = np.unique(owners, return_index=True)[1]
    stands[through[passed]] = edges.num_points + ends_at[passed]
    new_index = np.full(len(longer.points), -1, np.int64)
    new_index[order] = np.arange(len(order))
    end_nodes = np.full(2 * edges.num_edges, -1, np.int32)
    end_nodes[members] = owners
    offsets = offsets_of(np.bincount(of, minlength=edges.num_edges))
    longer = longer.reordered(stands[order], offsets, edges.closed, end_nodes.reshape(-1, 2))
    through = np.where(through >= 0, new_index[through], -1)
    return replace(longer, nodes=replace(nodes, through_points=through))
