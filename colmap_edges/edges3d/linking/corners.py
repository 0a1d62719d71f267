"""Search for 3D corners: points where the lines through ends of edges meet.

Blur rounds corners, and depths are estimated only up to a few pixels before them, so edges end
slightly before or behind a corner.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.groups import linked_groups
from colmap_edges.core.polylines import end_points, nearest_on_lines, unit
from colmap_edges.edges3d.linking.bends import go_on_smoothly, polynomials
from colmap_edges.edges3d.linking.ends import (
    MAX_MISS_SPACINGS,
    MIN_ANGLE_DEG,
    Ends,
    find_ends,
    near_pairs,
)

FIT_POINTS = 8  # points next to the last one to which the line of an end is fitted
BEND_RATIO = 2.0  # ratio of squared residuals of a bend; F test of 8 points at 99 %
APART_RATIO = 1.5  # maximum distance of two ends, in maximum extensions to the corner
MAX_PAST_SPACINGS = 0.75  # maximum length by which an edge overshoots the corner
MIN_SIGMA_SPACINGS = 1e-3  # minimum standard deviation of an end


@dataclass(frozen=True, kw_only=True)
class EndLines:
    """The lines that fit the 2E ends of E edges.

    Attributes:
        ends: the ends.
        centers: (2E, 3) a point of each line.
        outward: (2E, 3) their unit directions, outwards from the edges.
        sigmas: (2E,) standard deviations of the ends, world units.
    """

    ends: Ends
    centers: FloatArray
    outward: FloatArray
    sigmas: FloatArray

    def reaches(self, of: IntArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) distances of (n, 3) points from (n,) ends, along their lines and across them.

        Both are in spacings.
        """
        outward, spacings = self.outward[of], self.ends.spacings[of] + 1e-300
        along = np.einsum("ni,ni->n", points - self.ends.positions[of], outward)
        offset = points - self.centers[of]
        offset = offset - np.einsum("ni,ni->n", offset, outward)[:, None] * outward
        return along / spacings, np.linalg.norm(offset, axis=1) / spacings

    def may_reach(self, of: IntArray, points: FloatArray, limit: float) -> BoolArray:
        """Whether (n,) ends may be extended to (n, 3) points, by at most `limit` spacings."""
        along, miss = self.reaches(of, points)
        near = (along >= -MAX_PAST_SPACINGS) & (along <= limit) & (miss <= MAX_MISS_SPACINGS)
        return np.asarray(near)


@dataclass(frozen=True, kw_only=True)
class Meetings:
    """Ends of edges that meet, and points of edges that pass through where they meet.

    Attributes:
        positions: (C, 3) world points where ends meet.
        members: (M,) indices of the ends.
        owners: (M,) meeting of each end.
        through: (C,) the edge point that passes through each meeting, -1 where none does.
    """

    positions: FloatArray
    members: IntArray
    owners: IntArray
    through: IntArray

    @property
    def points(self) -> FloatArray:
        """(M, 3) the point at which each end meets others."""
        return self.positions[self.owners]

    @classmethod
    def of_links(cls, a: IntArray, b: IntArray, num_ends: int) -> Meetings:
        """Ends that are connected by links between (n,) and (n,) ends; positions are unknown."""
        labels = linked_groups(np.column_stack([a, b]), num_ends)
        members = np.flatnonzero(np.bincount(labels)[labels] > 1)
        owners = np.unique(labels[members], return_inverse=True)[1].astype(np.int64)
        count = int(owners.max(initial=-1)) + 1
        return cls(
            positions=np.zeros((count, 3)),
            members=members,
            owners=owners,
            through=np.full(count, -1, np.int64),
        )

    def with_ends(self, rows: BoolArray) -> Meetings:
        """The selected ends, and the meetings that keep at least two ends, renumbered."""
        counts = np.bincount(self.owners[rows], minlength=len(self.positions))
        kept = replace(self, members=self.members[rows], owners=self.owners[rows])
        return kept.select(counts >= 2)

    def select(self, meetings: BoolArray) -> Meetings:
        """The selected meetings, renumbered, with their ends."""
        left = meetings[self.owners]
        return Meetings(
            positions=self.positions[meetings],
            members=self.members[left],
            owners=(np.cumsum(meetings) - 1)[self.owners[left]],
            through=self.through[meetings],
        )


def fit_end_lines(edges: Edges3D) -> EndLines:
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
    sigmas = np.nan_to_num(edges.sigmas[tips], nan=0.0, posinf=0.0)
    return EndLines(ends=ends, centers=centers, outward=outward, sigmas=sigmas)


def find_corners(edges: Edges3D, lines: EndLines, max_extension: float) -> Meetings:
    """Find the points where lines through ends of edges meet, the nearest one for each end.

    Args:
        edges: linked edges.
        lines: the lines of their ends.
        max_extension: maximum extension of an edge to a corner, in spacings.
    """
    a, b, _ = near_pairs(lines.ends, APART_RATIO * max_extension)
    is_open = np.repeat(~edges.closed & (np.diff(edges.edge_offsets) > 2), 2)
    cosines = np.abs(np.einsum("ij,ij->i", lines.outward[a], lines.outward[b]))
    keep = is_open[a] & is_open[b] & (a // 2 != b // 2)
    keep &= cosines <= np.cos(np.radians(MIN_ANGLE_DEG))
    a, b = a[keep], b[keep]
    middle = np.mean(
        nearest_on_lines(lines.centers[a], lines.outward[a], lines.centers[b], lines.outward[b]),
        axis=0,
    )
    meet = lines.may_reach(a, middle, max_extension) & lines.may_reach(b, middle, max_extension)
    # Tangents at both ends of a gap in a smooth curve also meet, but not at a corner.
    meet[meet] = ~go_on_smoothly(edges, a[meet], b[meet])
    (along_a, miss_a), (along_b, miss_b) = lines.reaches(a, middle), lines.reaches(b, middle)
    costs = np.maximum(np.abs(along_a) + 2 * miss_a, np.abs(along_b) + 2 * miss_b)
    rows = np.flatnonzero(meet)[np.argsort(costs[meet], kind="stable")]
    _, first = np.unique(np.column_stack([a, b])[rows], return_index=True)
    best = rows[first // 2]  # the pair of least cost of each end
    corners = Meetings.of_links(a[best], b[best], len(lines.centers))
    corner_of = np.full(len(lines.centers), -1, np.int64)
    corner_of[corners.members] = corners.owners
    cheapest = rows[np.unique(corner_of[a[rows]], return_index=True)[1]]
    corners = replace(corners, positions=middle[cheapest])
    for _ in range(2):  # first the ends near the best pair's meeting point, then near that of all
        near = lines.may_reach(corners.members, corners.points, max_extension)
        corners = corners.with_ends(near)
        certain = np.zeros(len(corners.members))
        positions, _ = meeting_points(lines, corners, corners.points, certain)
        corners = replace(corners, positions=positions)
    return corners


def meeting_points(
    lines: EndLines, meetings: Meetings, near: FloatArray, sigmas: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(C, 3) weighted least-squares points of the lines of their ends, (C, 3, 3) covariances.

    Args:
        lines: the lines of all ends.
        meetings: the ends that meet.
        near: (M, 3) points, with a standard deviation of one spacing, that fix the position along
            parallel lines.
        sigmas: (M,) standard deviations of the ends.
    """
    members, count = meetings.members, len(meetings.positions)
    outward, spacings = lines.outward[members], lines.ends.spacings[members]
    spacings = np.maximum(spacings, 1e-6 * spacings.max(initial=0.0))
    across = np.eye(3) - outward[:, :, None] * outward[:, None, :]
    across /= np.maximum(sigmas, MIN_SIGMA_SPACINGS * spacings)[:, None, None] ** 2
    stay = 1 / spacings**2
    information, pulls = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(information, meetings.owners, across + stay[:, None, None] * np.eye(3))
    pull = np.einsum("nij,nj->ni", across, lines.centers[members]) + stay[:, None] * near
    np.add.at(pulls, meetings.owners, pull)
    information[np.bincount(meetings.owners, minlength=count) == 0] = np.eye(3)
    covariances = np.asarray(np.linalg.inv(information), np.float64)
    return np.asarray(np.einsum("nij,nj->ni", covariances, pulls), np.float64), covariances
