"""Plane hypotheses supported by edges and points, from random edge pairs and directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.faces.evidence import Evidence

MAX_POINTS = 8000  # maximum number of points for scoring hypotheses
NUM_PAIRS = 4000  # number of pairs of edges that are drawn at once
NUM_DRAWS = 2  # number of draws; all but the first are from points that lie on no plane yet
NUM_NEAR = 256  # number of nearest points from which the second edge of a pair is drawn
AXIS_COSINE = np.cos(np.radians(3.0))
MAX_SLOPE = 0.1  # maximum sine of the angle between an edge and its plane
TOLERANCE = 1.2  # maximum distance of a point from its plane, in standard deviations
MIN_SHARE = 0.002  # minimum share of all edges' length on a plane
MAX_PLANES = 60  # maximum number of planes with much evidence
MAX_ENDS = 10  # maximum number of planes at which others end, besides those
EXPLAINED_WEIGHT = 0.3  # weight of edges after each plane that they lie on: two meet at an edge
SAME_SHARE = 0.7  # maximum share of shared points of planes within 20 degrees of each other
MAX_BEYOND = 0.05  # maximum share of views behind a plane at which others end
SNAP_GAIN = 0.97  # minimum share of a plane's support kept when it takes a common normal


@dataclass(frozen=True, kw_only=True)
class Planes:
    """Planes normal . x = offset.

    Attributes:
        normals: (K, 3) unit normals.
        offsets: (K,) world units.
    """

    normals: FloatArray
    offsets: FloatArray


class Hypotheses:
    """Planes through evidence, and what supports them."""

    def __init__(self, evidence: Evidence, rng: np.random.Generator) -> None:
        """Choose the points on which planes are tried."""
        count = len(evidence.points)
        chosen = np.arange(count)
        if count > MAX_POINTS:
            chosen = np.sort(rng.choice(count, MAX_POINTS, replace=False))
        self.points = evidence.points[chosen]
        self.tree = cKDTree(self.points)
        self.tangents = evidence.tangents[chosen]
        self.has_tangent = np.abs(self.tangents).sum(axis=1) > 0
        self.rays = evidence.ray_sigmas[chosen, None] * evidence.rays[chosen]
        self.sigmas = evidence.sigmas[chosen]
        self.weights = evidence.weights[chosen]
        self.rng = rng

    def axes(self) -> FloatArray:
        """(A, 3) directions that many edges have."""
        straight = np.flatnonzero(self.has_tangent)
        axes: list[FloatArray] = []
        if not len(straight):
            return np.zeros((0, 3))
        tangents, weights = self.tangents[straight], self.weights[straight].copy()
        total = weights.sum()
        tried = self.rng.choice(len(straight), min(300, len(straight)), replace=False)
        along = (np.abs(tangents[tried] @ tangents.T) > AXIS_COSINE).astype(np.float64)
        while True:
            best = tangents[tried[np.argmax(along @ weights)]]
            for _ in range(4):
                near = (np.abs(tangents @ best) > AXIS_COSINE) * self.weights[straight]
                best = np.linalg.eigh((tangents.T * near) @ tangents)[1][:, -1]
            near = np.abs(tangents @ best) > AXIS_COSINE
            if weights[near].sum() <= 0.03 * total:
                return np.array(axes).reshape(-1, 3)
            axes.append(best)
            weights[np.abs(tangents @ best) > np.cos(np.radians(10))] = 0

    def common_normals(self) -> FloatArray:
        """(A, 3) directions that planes along many edges have."""
        axes = self.axes()
        normals = [*axes]
        for i in range(len(axes)):
            for j in range(i):
                normal = np.cross(axes[i], axes[j])
                length = np.linalg.norm(normal)
                if length > 0.3:
                    normals.append(normal / length)
        kept: list[FloatArray] = []
        for normal in normals:
            if all(abs(normal @ other) < AXIS_COSINE for other in kept):
                kept.append(normal)
        return np.array(kept).reshape(-1, 3)

    def candidates(self, common: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(H, 3) normals and (H,) offsets of planes through pairs of near edges, and points.

        The first of a pair is drawn by (N,) weights.
        """
        share = weights / weights.sum()
        first = self.rng.choice(len(self.points), NUM_PAIRS, p=share)
        num_near = min(NUM_NEAR, len(self.points))
        ranks = np.floor(num_near ** self.rng.random((NUM_PAIRS, 2))).astype(np.int64)
        ranks = np.minimum(ranks, num_near - 1)
        second = nearest(self.tree, first, ranks[:, 0])
        third = np.where(self.has_tangent[second], second, 0)
        open_ = np.flatnonzero(~self.has_tangent[second])
        third[open_] = nearest(self.tree, first[open_], ranks[open_, 1])
        lengths = self.points[second] - self.points[first]
        one = np.where(self.has_tangent[first][:, None], self.tangents[first], lengths)
        other = np.where(
            self.has_tangent[second][:, None],
            self.tangents[second],
            self.points[third] - self.points[first],
        )
        one /= np.linalg.norm(one, axis=1, keepdims=True) + 1e-300
        other /= np.linalg.norm(other, axis=1, keepdims=True) + 1e-300
        normals = np.cross(one, other)
        sines = np.linalg.norm(normals, axis=1)
        normals /= sines[:, None] + 1e-300
        offsets = np.einsum("ij,ij->i", normals, self.points[first])
        gaps = np.abs(np.einsum("ij,ij->i", normals, self.points[second]) - offsets)
        good = (sines > 0.3) & (gaps <= TOLERANCE * (self.sigmas[first] + self.sigmas[second]))
        normals, offsets = normals[good], offsets[good]
        if len(common):
            through = self.rng.choice(len(self.points), NUM_PAIRS // 8, p=share)
            flat = np.abs(self.tangents[through] @ common.T) < MAX_SLOPE
            rows, columns = np.nonzero(flat)
            more = common[columns]
            normals = np.concatenate([normals, more])
            at = np.einsum("ij,ij->i", more, self.points[through[rows]])
            offsets = np.concatenate([offsets, at])
        return normals, offsets

    def best_of(
        self,
        found: Planes,
        more: tuple[FloatArray, FloatArray],
        common: FloatArray,
        with_ends: bool = False,
    ) -> tuple[Planes, Planes]:
        """The planes with the most support among those found before and (H) more.

        Args:
            found: planes found before.
            more: normals and offsets of the others.
            common: (A, 3) normals that many planes have.
            with_ends: whether planes at which others end are sought, too.

        Returns:
            The planes, and those at which others end: a wall may be known by its line with the
            ceiling alone, and shares all of its points with it.
        """
        options = (TOLERANCE, MIN_SHARE, EXPLAINED_WEIGHT, SAME_SHARE, SNAP_GAIN)
        normals, offsets, count = _kernels.search_planes(
            self.points,
            self.tangents,
            self.rays,
            self.sigmas,
            self.weights,
            np.concatenate([found.normals, more[0]]),
            np.concatenate([found.offsets, more[1]]),
            common,
            MAX_SLOPE,
            np.array(options),
            MAX_PLANES,
            with_ends,
        )
        first, others = slice(count), slice(count, None)
        return Planes(normals=normals[first], offsets=offsets[first]), Planes(
            normals=normals[others], offsets=offsets[others]
        )

    def lie_alone(self, planes: Planes) -> BoolArray:
        """(N,) whether points lie on none of the planes."""
        offsets, _ = _kernels.planes_of_points(
            self.points,
            self.tangents,
            self.rays,
            self.sigmas,
            planes.normals,
            planes.offsets,
            TOLERANCE,
            MAX_SLOPE,
        )
        alone: BoolArray = np.diff(offsets) == 0
        return alone


def nearest(tree: cKDTree, sources: IntArray, ranks: IntArray) -> IntArray:
    """(M,) the point of a given rank among those that are nearest to each of (M,) points."""
    found, least = np.zeros(len(sources), np.int64), 0
    while least < tree.n and (ranks >= least).any():
        count = min(max(2 * least, 4), tree.n)  # few are found more quickly than many
        rows = np.flatnonzero((ranks >= least) & (ranks < count))
        near, own = np.unique(sources[rows], return_inverse=True)
        found[rows] = tree.query(tree.data[near], count)[1][own, ranks[rows]]
        least = count
    return found


def find_planes(evidence: Evidence, centers: FloatArray, rng: np.random.Generator) -> Planes:
    """Planes on which much of the evidence lies, those with the most first.

    Planes at which others end follow, if nearly all cameras are on one side of them: nobody takes
    photographs from within or behind a wall.

    Args:
        evidence: observed points.
        centers: (V, 3) camera centres of all views.
        rng: of the random choice of hypotheses.
    """
    none = Planes(normals=np.zeros((0, 3)), offsets=np.zeros(0))
    if len(evidence.points) < 8:
        return none
    tried = Hypotheses(evidence, rng)
    common, found, weights = tried.common_normals(), none, tried.weights
    for _ in range(NUM_DRAWS):
        if not weights.any():
            break
        found, _ = tried.best_of(found, tried.candidates(common, weights), common)
        weights = tried.weights * tried.lie_alone(found)
    everywhere = tried.candidates(common, tried.weights)
    found, ends = tried.best_of(found, everywhere, common, with_ends=True)
    beyond = (centers @ ends.normals.T > ends.offsets).mean(axis=0)
    closed = np.flatnonzero(np.minimum(beyond, 1 - beyond) <= MAX_BEYOND)[:MAX_ENDS]
    return Planes(
        normals=np.concatenate([found.normals, ends.normals[closed]]),
        offsets=np.concatenate([found.offsets, ends.offsets[closed]]),
    )
