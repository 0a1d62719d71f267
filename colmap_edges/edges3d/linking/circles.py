"""Joining of the pieces of one circle, with points on it where views observe the gap.

Pieces of a small circle are short, and their ends are their least certain points, so directions of
ends do not determine whether they face each other. One circle through both pieces does: it must
describe them at less cost (BIC) than a line or a circle for each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Table,
    offsets_of,
    ranges_of,
    ranks_of,
)
from colmap_edges.core.curves3d import ARC, LINE
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.core.polylines import end_points, match_best_first
from colmap_edges.edges2d.edge_index import IndexedGraphs
from colmap_edges.edges3d.curves.joints import coordinates_in, foot_points
from colmap_edges.edges3d.curves.lines_and_circles import fit_circles, fit_lines
from colmap_edges.edges3d.curves.noise import NUM_PARAMETERS, Noise
from colmap_edges.edges3d.curves.point_sequences import OUTLIER_SIGMAS
from colmap_edges.edges3d.curves.segmentation import learn_noise
from colmap_edges.edges3d.curves.shared_circles import joint_circles
from colmap_edges.edges3d.linking.ends import (
    REACH,
    SHORT_GAP,
    Ends,
    find_ends,
    near_pairs,
    points_inward,
    views_near,
)
from colmap_edges.edges3d.linking.gaps import observed_along
from colmap_edges.edges3d.linking.joining import joined, with_more
from colmap_edges.options import LinkingOptions, PipelineOptions

MIN_TURN = np.radians(45.0)  # minimum angle of the circle that both pieces cover


@dataclass(frozen=True, kw_only=True)
class Gaps(Table):
    """N points on circles that bridge the gaps between ends of edges, in order along each gap.

    Attributes:
        points: (N, 3) the points.
        tangents: (N, 3) directions of the circles there.
        ends: (N, 2) end before and end behind the gap.
        owners: (N,) gap of each point.
    """

    points: FloatArray
    tangents: FloatArray
    ends: IntArray
    owners: IntArray


def join_circles(
    edges: Edges3D, given: IndexedGraphs, options: PipelineOptions, num_threads: int
) -> Edges3D:
    """Join open edges that are pieces of one circle, across gaps without ends of other edges.

    Args:
        edges: linked edges.
        given: the edge graphs of all views.
        options: maximum gap, search radius and minimum number of observations.
        num_threads: threads to use; the result does not depend on it.
    """
    if edges.num_edges == 0:
        return edges
    ends = find_ends(edges)
    pairs = candidate_pairs(edges, ends, options.linking)
    if not len(pairs):
        return edges
    noise = learn_noise(edges, num_threads)
    frames, same = circles_through(edges, noise, pairs // 2)
    strays = np.column_stack([num_strays(edges, noise, frames, of) for of in pairs.T])
    spacings = ends.spacings[pairs].min(axis=1)
    gaps, lengths, facing = gaps_on(edges, frames, pairs, strays, spacings)
    facing &= same
    gaps = gaps.select(np.flatnonzero(facing[gaps.owners]))
    observed = observed_along(
        given,
        views_near(edges, gaps.ends, given.num_views),
        gaps.points[:, None],
        gaps.tangents[:, None],
        options.refinement.max_residual_px,
        (options.refinement.max_tangent_angle_deg,),
        num_threads,
    )
    seen = observed.counts >= options.tracing.min_observations
    everywhere = np.bincount(gaps.owners[~seen], minlength=len(pairs)) == 0
    allowed = facing & ((lengths <= options.linking.max_gap_spacings) | everywhere)
    partner = match_best_first(len(ends.positions), pairs[:, 0], pairs[:, 1], allowed, lengths)
    used = partner[pairs[:, 0]] == pairs[:, 1]
    skip = np.zeros(len(partner), np.int64)
    skip[pairs[used]] = strays[used]
    points = np.flatnonzero(seen & used[gaps.owners])
    found = Observations.of_positions(observed.select(points))
    return filled(without_tips(edges, skip), gaps.select(points), partner, found)


def candidate_pairs(edges: Edges3D, ends: Ends, options: LinkingOptions) -> IntArray:
    """(n, 2) ends of two open edges, one of them bent, near each other but no third edge's end."""
    # Gaps that are observed everywhere may be twice as long.
    a, b, gap = near_pairs(ends, 2.0 * options.max_gap_spacings)
    sizes = np.diff(edges.edge_offsets)[np.column_stack([a // 2, b // 2])]
    # The shorter and the longer piece of a circle.
    keep = (sizes.min(axis=1) >= 3) & (sizes.max(axis=1) >= 8)
    keep &= ~edges.closed[a // 2] & ~edges.closed[b // 2] & (a // 2 != b // 2)
    bends = sagittas(edges)
    keep &= np.maximum(bends[a // 2], bends[b // 2]) >= np.tan(MIN_TURN / 8) / 2
    c, d, _ = near_pairs(ends, options.node_radius_spacings)
    met = np.bincount(np.concatenate([c, d]), minlength=len(ends.positions))
    spacing = np.minimum(ends.spacings[a], ends.spacings[b])
    lengths = np.linalg.norm(gap, axis=1)
    own = lengths <= options.node_radius_spacings * spacing
    ahead = [np.einsum("ni,ni->n", ends.outward[of], gap * way) for of, way in ((a, 1), (b, -1))]
    keep &= (lengths <= (REACH + SHORT_GAP) * spacing) | (np.minimum(*ahead) > 0)
    keep &= (met[a] <= own) & (met[b] <= own)
    return np.asarray(np.column_stack([a, b])[keep], np.int64)


def sagittas(edges: Edges3D) -> FloatArray:
    """(E,) distances of the edges' middle points from their chords' middles, relative to chords."""
    first, last = edges.edge_offsets[:-1], edges.edge_offsets[1:] - 1
    start, middle, end = (edges.points[at] for at in (first, (first + last) // 2, last))
    aside = np.linalg.norm(middle - (start + end) / 2, axis=1)
    return np.asarray(aside / (np.linalg.norm(end - start, axis=1) + 1e-300))


def circles_through(edges: Edges3D, noise: Noise, pairs: IntArray) -> tuple[FloatArray, BoolArray]:
    """(n, 3, 3) circles through (n, 2) pairs of edges, (n,) whether a pair is one circle (BIC)."""
    bounds = np.column_stack([edges.edge_offsets[:-1], edges.edge_offsets[1:]])
    each, place = np.unique(pairs, return_inverse=True)
    single = noise.sequences(edges.points, bounds[each])
    both = noise.sequences(edges.points, bounds[pairs.ravel()])
    steps = np.append(np.linalg.norm(np.diff(both.points, axis=0), axis=1), 0)
    steps[both.offsets[1:] - 1] = 0
    both = replace(both, offsets=both.offsets[::2])
    prices = noise.parameter_costs(both.lengths)
    separate = [
        noise.costs(single, fit(single).squares)[place.reshape(-1, 2)]
        + NUM_PARAMETERS[kind] * prices[:, None]
        for fit, kind in ((fit_lines, LINE), (fit_circles, ARC))
    ]
    fits, gains = joint_circles(noise, both, 1, np.minimum(*separate).sum(axis=1))
    turns = both.sums(steps) / np.linalg.norm(fits.frames[:, 1], axis=1)
    return fits.frames, (gains > 0) & (turns >= MIN_TURN)


def num_strays(edges: Edges3D, noise: Noise, frames: FloatArray, of: IntArray) -> IntArray:
    """(n,) number of points at the tips of ends that lie beside their circles, at most `REACH`.

    At least two points of an edge remain if both of its ends lose as many.
    """
    count, straight = np.zeros(len(of), np.int64), np.zeros(len(of), bool)
    sizes = np.diff(edges.edge_offsets)[of // 2]
    for step in range(REACH):
        at = points_inward(edges, of, step)
        off = edges.points[at] - foot_points(frames, straight, edges.points[at])
        stray = np.linalg.norm(off, axis=1) > OUTLIER_SIGMAS * noise.sigmas[at]
        count += (count == step) & stray & (2 * step + 3 < sizes)
    return count


def gaps_on(
    edges: Edges3D, frames: FloatArray, pairs: IntArray, strays: IntArray, spacings: FloatArray
) -> tuple[Gaps, FloatArray, BoolArray]:
    """The gaps between (n, 2) ends on circles, without their (n, 2) numbers of stray points.

    Returns:
        The gaps, (n,) their lengths in spacings, and (n,) whether the ends face each other.
    """
    angles, ways = [], []
    for of, skip in zip(pairs.T, strays.T, strict=True):
        tips, inner = (
            coordinates_in(frames, edges.points[points_inward(edges, of, skip + more)])
            for more in (0, REACH)
        )
        angles.append(np.arctan2(tips[1], tips[0]))
        ways.append(np.sign(tips[1] * inner[0] - tips[0] * inner[1]))
    turns = (angles[1] - angles[0] + np.pi) % (2 * np.pi) - np.pi
    lengths = ways[0] * turns * np.linalg.norm(frames[:, 1], axis=1) / spacings
    facing = (ways[0] == -ways[1]) & (lengths > -SHORT_GAP)
    counts = np.where(facing & (lengths > SHORT_GAP), np.ceil(lengths) - 1, 0).astype(np.int64)
    owners = np.repeat(np.arange(len(pairs)), counts)
    t = angles[0][owners] + turns[owners] * (ranks_of(counts) + 1) / (counts[owners] + 1)
    centers, a, b = np.moveaxis(frames[owners], 1, 0)
    cosines, sines = np.cos(t)[:, None], np.sin(t)[:, None]
    gaps = Gaps(
        points=centers + cosines * a + sines * b,
        tangents=cosines * b - sines * a,
        ends=pairs[owners],
        owners=owners,
    )
    return gaps, lengths, facing


def without_tips(edges: Edges3D, skip: IntArray) -> Edges3D:
    """The edges without (2E,) numbers of points at their ends."""
    first, last = edges.edge_offsets[:-1] + skip[::2], edges.edge_offsets[1:] - skip[1::2]
    order = ranges_of(first, last)
    return edges.reordered(order, offsets_of(last - first), edges.closed)


def filled(edges: Edges3D, gaps: Gaps, partner: IntArray, observations: Observations) -> Edges3D:
    """Join (2E,) ends to their partners, with the points in gaps as edges in between."""
    _, first, owners = np.unique(gaps.owners, return_index=True, return_inverse=True)
    sizes = np.bincount(owners, minlength=len(first))
    new = edges.num_edges + np.arange(len(first))
    loops = np.flatnonzero(edges.closed)
    partner = np.concatenate([partner, gaps.ends[first].ravel()])
    partner[gaps.ends[first]] = np.column_stack([2 * new, 2 * new + 1])
    partner[2 * loops], partner[2 * loops + 1] = 2 * loops + 1, 2 * loops
    tips = end_points(edges.edge_offsets, 0)[0]
    sigmas = edges.sigmas[tips[gaps.ends]].max(axis=1)
    longer = with_more(edges, gaps.points, sizes, observations, sigmas)
    return joined(longer, find_ends(longer), partner)
