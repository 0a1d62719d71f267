"""Extension of edge ends to shared 3D corners.

Blur rounds corners, and depths are estimated only up to a few pixels before them, so edges end
slightly before or behind a corner. If the lines through their ends meet, and views observe an edge
there, the edges are extended to the (least-squares) meeting point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.csgraph import connected_components

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    offsets_of,
    ranges_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.core.polylines import end_points, unit
from colmap_edges.edges2d.edge_index import IndexedGraphs, positions_near
from colmap_edges.edges3d.linking.bends import go_on_smoothly, polynomials
from colmap_edges.edges3d.linking.joining import (
    SHORT_GAP,
    Ends,
    find_ends,
    near_pairs,
    num_behind,
    views_near,
)
from colmap_edges.options import LinkingOptions, PipelineOptions

FIT_POINTS = 8  # points next to the last one to which the line of an end is fitted
BEND_RATIO = 2.0  # ratio of squared residuals of a bend; F test of 8 points at 99 %
MIN_ANGLE_DEG = 20.0  # minimum angle between lines; nearly parallel ones have no defined corner
APART_RATIO = 1.5  # maximum distance of two ends, in maximum extensions to the corner
MAX_MISS_SPACINGS = 0.5  # maximum distance of an end's line to the corner
MAX_PAST_SPACINGS = 0.75  # maximum length by which an edge overshoots the corner
MIN_GAP_SPACINGS = 0.5  # distance within which the corner replaces an edge point
STAY_WEIGHT = 1e-6  # weight of a corner's prior position, relative to a line
# positions on an extension at which an edge must be observed, as fractions
WAY = np.array([1 / 3, 2 / 3])
MIN_SEEN_RATIO = 0.5  # minimum share of an end's observing views that observe the extension


@dataclass(frozen=True, kw_only=True)
class Corners:
    """Ends of edges that meet.

    Attributes:
        positions: (C, 3) world points of the corners.
        members: (M,) indices of the ends.
        owners: (M,) corner of each.
    """

    positions: FloatArray
    members: IntArray
    owners: IntArray

    @property
    def points(self) -> FloatArray:
        """(M, 3) the corner of each end."""
        return self.positions[self.owners]

    def select(self, rows: BoolArray) -> Corners:
        """The selected ends, and the corners that keep at least two ends."""
        counts = np.bincount(self.owners[rows], minlength=len(self.positions))
        left = rows & (counts[self.owners] >= 2)
        return replace(self, members=self.members[left], owners=self.owners[left])


@dataclass(frozen=True, kw_only=True)
class Lines:
    """The lines that fit the 2E ends of E edges.

    Attributes:
        ends: the ends.
        centers: (2E, 3) a point of each line.
        outward: (2E, 3) their unit directions, outwards from the edges.
    """

    ends: Ends
    centers: FloatArray
    outward: FloatArray

    def reaches(self, of: IntArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances of (n, k or 1, 3) points from (n, k) ends, along their lines and across them.

        Both are (n, k), in spacings.
        """
        outward, spacings = self.outward[of], self.ends.spacings[of] + 1e-300
        along = np.einsum("nki,nki->nk", points - self.ends.positions[of], outward)
        offset = points - self.centers[of]
        offset = offset - np.einsum("nki,nki->nk", offset, outward)[:, :, None] * outward
        return along / spacings, np.linalg.norm(offset, axis=2) / spacings


def meet_at_corners(
    edges: Edges3D,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> Edges3D:
    """Extend or shorten edges to the corners where they meet others.

    Args:
        edges: linked edges.
        given: the edge graphs of all views.
        options: maximum distance of a corner, search radius and minimum number of observations.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The edges, each with its own point at every corner.
    """
    if edges.num_edges == 0:
        return edges
    lines = fit_lines(edges)
    corners = find_corners(edges, lines, options.linking)
    asked = views_near(edges, corners.members[:, None], given.num_views)
    observed = observe(corners, lines.ends, asked, given, options, num_threads)
    num_asked = np.bincount(asked.indices, minlength=len(corners.members))
    least = np.maximum(options.tracing.min_observations, MIN_SEEN_RATIO * num_asked)
    met = corners.select(observed.counts >= least)
    left = observed.select(np.flatnonzero(np.isin(corners.members, met.members)))
    longer = with_points(edges, met, Observations.of_positions(left))
    return run_to(longer, edges, lines.ends, met)


def with_points(edges: Edges3D, met: Corners, observations: Observations) -> Edges3D:
    """Append a point for each end that meets others after all points of the edges.

    Args:
        edges: the edges.
        met: the M ends and their corners.
        observations: observations of the corners of these ends.
    """
    tips, _ = end_points(edges.edge_offsets, 0)
    return replace(
        edges,
        points=np.concatenate([edges.points, met.points]),
        observations=Observations.concatenated([edges.observations, observations]),
        sigmas=np.concatenate([edges.sigmas, edges.sigmas[tips[met.members]]]),
        colors=np.concatenate([edges.colors, np.zeros(met.points.shape, np.uint8)]),
    )


def fit_lines(edges: Edges3D) -> Lines:
    """Fit lines to the ends of all edges."""
    ends = find_ends(edges)
    tips, inner = end_points(edges.edge_offsets, FIT_POINTS)
    inward = np.sign(inner - tips)[:, None]
    steps = np.minimum(np.arange(1, FIT_POINTS + 1), np.abs(inner - tips)[:, None])
    points = edges.points[tips[:, None] + inward * steps]
    centers = points.mean(axis=1)
    apart = points - centers[:, None]
    outward = np.linalg.eigh(np.einsum("nki,nkj->nij", apart, apart))[1][:, :, 2]
    outward *= np.where((outward * ends.outward).sum(axis=1) < 0, -1, 1)[:, None]
    off = apart - np.einsum("nki,ni->nk", apart, outward)[:, :, None] * outward[:, None]
    steps = np.broadcast_to(np.arange(1.0, FIT_POINTS + 1), points.shape[:2])
    parabolas, rest = polynomials(steps, points, 2)
    # With more than BEND_RATIO times the residuals of a parabola, the line is a chord of a bend.
    bent = (np.abs(inner - tips) >= FIT_POINTS) & ((off**2).sum(axis=(1, 2)) > BEND_RATIO * rest)
    centers[bent], outward[bent] = parabolas[bent, 0], unit(-parabolas[bent, 1])
    return Lines(ends=ends, centers=centers, outward=outward)


def find_corners(edges: Edges3D, lines: Lines, options: LinkingOptions) -> Corners:
    """Find the points where lines through ends of edges meet, the nearest one for each end."""
    reach = options.max_corner_spacings
    pairs = pairs_to_meet(edges, lines, reach)
    middle = meetings(lines, pairs)
    along, miss = lines.reaches(pairs, middle[:, None])
    fits = np.all(fit(along, miss, reach), axis=1)
    # Tangents at both ends of a gap in a smooth curve also meet, but not at a corner.
    fits[fits] = ~go_on_smoothly(edges, *pairs[fits].T)
    cost = (np.abs(along) + 2 * miss).max(axis=1)
    rows = np.flatnonzero(fits)[np.argsort(cost[fits], kind="stable")]
    members, first = np.unique(pairs[rows], return_index=True)
    links = pairs[rows[first // 2]]  # the pair of least cost of each end
    size = (len(lines.centers),) * 2
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=size)
    labels = connected_components(graph, directed=False)[1]
    cheapest = rows[np.unique(labels[pairs[rows, 0]], return_index=True)[1]]
    owners = np.unique(labels[members], return_inverse=True)[1]
    corners = Corners(positions=middle[cheapest], members=members, owners=owners)
    for _ in range(2):  # first the ends near the best pair's meeting point, then near that of all
        along, miss = lines.reaches(corners.members[:, None], corners.points[:, None])
        corners = corners.select(fit(along, miss, reach)[:, 0])
        corners = replace(corners, positions=intersect(corners, lines))
    return corners


def pairs_to_meet(edges: Edges3D, lines: Lines, reach: float) -> IntArray:
    """(n, 2) ends of different open edges, near each other, whose lines are not parallel."""
    a, b, _ = near_pairs(lines.ends, APART_RATIO * reach)
    open_ends = np.repeat(~edges.closed & (np.diff(edges.edge_offsets) > 2), 2)
    keep = open_ends[a] & open_ends[b] & (a // 2 != b // 2)
    pairs = np.column_stack([a, b])[keep]
    least = np.cos(np.radians(MIN_ANGLE_DEG))
    apart = np.abs(np.einsum("ij,ij->i", *lines.outward[pairs.T])) <= least
    return np.asarray(pairs[apart])


def meetings(lines: Lines, pairs: IntArray) -> FloatArray:
    """(n, 3) midpoints of the shortest connections between the lines of (n, 2) ends."""
    (center_a, center_b), (a, b) = lines.centers[pairs.T], lines.outward[pairs.T]
    cosine = np.einsum("ij,ij->i", a, b)
    on_a = np.einsum("ij,ij->i", a, center_b - center_a)
    on_b = np.einsum("ij,ij->i", b, center_b - center_a)
    square = 1 - cosine**2
    near_a = center_a + ((on_a - cosine * on_b) / square)[:, None] * a
    near_b = center_b + ((cosine * on_a - on_b) / square)[:, None] * b
    middle: FloatArray = (near_a + near_b) / 2
    return middle


def fit(along: FloatArray, miss: FloatArray, reach: float) -> BoolArray:
    """Whether ends at these distances from a corner, in spacings, are extended to it."""
    return (along >= -MAX_PAST_SPACINGS) & (along <= reach) & (miss <= MAX_MISS_SPACINGS)


def intersect(corners: Corners, lines: Lines) -> FloatArray:
    """(C, 3) least-squares points of the lines of their ends; unchanged along parallel lines."""
    outward, centers = lines.outward[corners.members], lines.centers[corners.members]
    across = np.eye(3) - outward[:, :, None] * outward[:, None, :]
    sums = np.tile(STAY_WEIGHT * np.eye(3), (len(corners.positions), 1, 1))
    pulls = STAY_WEIGHT * corners.positions
    np.add.at(sums, corners.owners, across)
    np.add.at(pulls, corners.owners, np.einsum("nij,nj->ni", across, centers))
    return np.asarray(np.linalg.solve(sums, pulls[:, :, None])[:, :, 0], np.float64)


def observe(
    corners: Corners,
    ends: Ends,
    asked: csc_array,
    given: IndexedGraphs,
    options: PipelineOptions,
    num_threads: int,
) -> ChainObservations:
    """Observations of the corners of M ends in the views `asked` (M, V), on any chain.

    For a corner farther than `SHORT_GAP` from an end, a view must also observe the extension.
    """
    points = corners.points
    away = points - ends.positions[corners.members]
    far = np.linalg.norm(away, axis=1) > SHORT_GAP * ends.spacings[corners.members]
    outward = ends.outward[corners.members]
    places = points[:, None] - WAY[:, None] * away[:, None]
    along = np.repeat(away[:, None], len(WAY), axis=1)
    radius = options.refinement.max_residual_px
    cosine = float(np.cos(np.radians(options.refinement.max_tangent_angle_deg)))
    found = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64))]
    for view in np.flatnonzero(np.diff(asked.indptr)).tolist():
        rows = asked.indices[asked.indptr[view] : asked.indptr[view + 1]]
        near = partial(positions_near, given.index(view), radius, num_threads)
        on_way = near(places[rows], along[rows], cosine)
        at_corner = near(points[rows, None], outward[rows, None], 0.0)[:, 0]
        seen = (at_corner >= 0) & ((on_way >= 0).all(axis=1) | ~far[rows])
        found.append((np.full(seen.sum(), view), at_corner[seen], rows[seen]))
    views, positions, members = (np.concatenate(of) for of in zip(*found, strict=True))
    order = np.argsort(members, kind="stable")
    return ChainObservations(
        offsets=offsets_of(np.bincount(members, minlength=len(corners.members))),
        views=views[order].astype(np.int32),
        positions=positions[order],
    )


def run_to(longer: Edges3D, edges: Edges3D, ends: Ends, met: Corners) -> Edges3D:
    """Extend each end to its appended point in `longer`.

    Points beyond the corner or next to it are left out.
    """
    order, lengths = order_to(edges, ends, met)
    return longer.reordered(order, offsets_of(lengths), edges.closed)


def order_to(edges: Edges3D, ends: Ends, met: Corners) -> tuple[IntArray, IntArray]:
    """Order of points with the M appended ones inserted as ends; (E,) number of points per edge."""
    limits = MIN_GAP_SPACINGS * ends.spacings[met.members]
    skip = num_behind(edges, met.members, met.points, -ends.outward[met.members], limits)
    begins = edges.edge_offsets[:-1] + skip[::2]
    stops = edges.edge_offsets[1:] - skip[1::2]
    own = ranges_of(begins, stops)
    owners = np.concatenate(
        [np.repeat(np.arange(edges.num_edges), stops - begins), met.members // 2]
    )
    rank = np.concatenate([np.zeros(len(own)), np.where(met.members % 2 == 0, -1, 1)])
    points = np.concatenate([own, edges.num_points + np.arange(len(met.members))])
    order = np.lexsort((rank, owners))  # stable: points of an edge stay in their order
    return points[order], np.bincount(owners, minlength=edges.num_edges)
