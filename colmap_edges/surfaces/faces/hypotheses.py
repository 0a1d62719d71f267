"""Plane hypotheses supported by edges and points, from random edge pairs and directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, Float32Array, FloatArray, offsets_of
from colmap_edges.surfaces.faces.evidence import Evidence

MAX_POINTS = 4000  # maximum number of points for scoring hypotheses
NUM_PAIRS = 6000  # number of sampled pairs of edges
NUM_NEAR = 256  # number of nearest points from which the second edge of a pair is drawn
NUM_AXES = 6  # number of dominant edge directions
AXIS_COSINE = np.cos(np.radians(3.0))
MAX_SLOPE = 0.1  # maximum sine of the angle between an edge and its plane
TOLERANCE = 1.2  # maximum distance of a point from its plane, in standard deviations
MIN_SHARE = 0.002  # minimum share of all edges' length on a plane
MAX_PLANES = 60  # maximum number of planes
EXPLAINED_WEIGHT = 0.3  # weight of edges already on one plane, since two planes meet at an edge
LEAST_WEIGHT = 0.1  # weight of edges on many planes
CHUNK = 256  # hypotheses per batch
SAME_SHARE = 0.7  # minimum share of shared points of duplicate planes
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


class Narrow(NamedTuple):
    """Points in single precision, as many planes are held against them.

    Attributes:
        points: (3, N) from their middle.
        rays: (3, N) directions in which they are seen, as long as their tolerance along these.
        across: (N,) squares of the tolerance across.
        tangents: (3, N).
    """

    points: Float32Array
    rays: Float32Array
    across: Float32Array
    tangents: Float32Array


class Hypotheses:
    """Planes through evidence, and what supports them."""

    def __init__(self, evidence: Evidence, rng: np.random.Generator) -> None:
        """Choose the points on which planes are tried."""
        count = len(evidence.points)
        chosen = np.arange(count)
        if count > MAX_POINTS:
            chosen = np.sort(rng.choice(count, MAX_POINTS, replace=False))
        self.points = evidence.points[chosen]
        self.tangents = evidence.tangents[chosen]
        self.has_tangent = np.abs(self.tangents).sum(axis=1) > 0
        self.rays = evidence.rays[chosen]
        self.sigmas, self.ray_sigmas = evidence.sigmas[chosen], evidence.ray_sigmas[chosen]
        self.weights = evidence.weights[chosen]
        self.rng = rng
        self.middle = np.median(self.points, axis=0) if count else np.zeros(3)
        self.narrow = Narrow(
            points=(self.points - self.middle).astype(np.float32).T,
            rays=(TOLERANCE * self.ray_sigmas[:, None] * self.rays).astype(np.float32).T,
            across=((TOLERANCE * self.sigmas) ** 2).astype(np.float32),
            tangents=self.tangents.astype(np.float32).T,
        )

    def members(self, normals: FloatArray, offsets: FloatArray) -> Any:
        """(K, N) sparse float32 array, 1 where a point lies on a plane."""
        planes = normals.astype(np.float32)
        places = (offsets - normals @ self.middle).astype(np.float32)
        columns, counts = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for first in range(0, len(offsets), CHUNK):
            part = slice(first, first + CHUNK)
            off = planes[part] @ self.narrow.points - places[part, None]
            near = off**2 <= (planes[part] @ self.narrow.rays) ** 2 + self.narrow.across
            near &= np.abs(planes[part] @ self.narrow.tangents) <= MAX_SLOPE
            columns.append(np.nonzero(near)[1])
            counts.append(np.count_nonzero(near, axis=1))
        indices, starts = np.concatenate(columns), offsets_of(np.concatenate(counts))
        ones = np.ones(len(indices), np.float32)
        return sparse.csr_array((ones, indices, starts), (len(offsets), len(self.points)))

    def deviations(self, normal: FloatArray) -> FloatArray:
        """(N,) standard deviations of the points' distances from a plane."""
        return np.hypot(self.sigmas, self.ray_sigmas * (self.rays @ normal))

    def on(self, normal: FloatArray, offset: float, tolerance: float = TOLERANCE) -> BoolArray:
        """(N,) whether points and their tangents lie on a plane."""
        near = np.abs(self.points @ normal - offset) <= tolerance * self.deviations(normal)
        return near & (np.abs(self.tangents @ normal) <= MAX_SLOPE)

    def axes(self) -> FloatArray:
        """(A, 3) directions that many edges have."""
        straight = np.flatnonzero(self.has_tangent)
        axes: list[FloatArray] = []
        if not len(straight):
            return np.zeros((0, 3))
        tangents, weights = self.tangents[straight], self.weights[straight].copy()
        total = weights.sum()
        tried = self.rng.choice(len(straight), min(300, len(straight)), replace=False)
        for _ in range(NUM_AXES):
            cosines = np.abs(tangents[tried] @ tangents.T) > AXIS_COSINE
            best = tangents[tried[np.argmax(cosines @ weights)]]
            for _ in range(4):
                near = (np.abs(tangents @ best) > AXIS_COSINE) * self.weights[straight]
                best = np.linalg.eigh((tangents.T * near) @ tangents)[1][:, -1]
            near = np.abs(tangents @ best) > AXIS_COSINE
            if weights[near].sum() < 0.03 * total:
                break
            axes.append(best)
            weights[np.abs(tangents @ best) > np.cos(np.radians(10))] = 0
        return np.array(axes).reshape(-1, 3)

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

    def candidates(self, common: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(H, 3) normals and (H,) offsets of planes through pairs of near edges, and points."""
        share = self.weights / self.weights.sum()
        first = self.rng.choice(len(self.points), NUM_PAIRS, p=share)
        num_near = min(NUM_NEAR, len(self.points))
        sources, rows = np.unique(first, return_inverse=True)
        _, near = cKDTree(self.points).query(self.points[sources], num_near)
        ranks = np.floor(num_near ** self.rng.random((NUM_PAIRS, 2))).astype(np.int64)
        ranks = np.minimum(ranks, num_near - 1)
        second, third = near[rows, ranks[:, 0]], near[rows, ranks[:, 1]]
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

    def fitted(
        self, normal: FloatArray, offset: float, common: FloatArray
    ) -> tuple[FloatArray, float] | None:
        """The plane fitted to all that lies on it; one of the common normals where that is as good.

        None where too little lies on it.
        """
        for tolerance in (1.6 * TOLERANCE, 1.2 * TOLERANCE, TOLERANCE):
            on = np.flatnonzero(self.on(normal, offset, tolerance))
            if len(on) < 8:
                return None
            weights = self.weights[on] / self.deviations(normal)[on] ** 2
            middle = np.average(self.points[on], axis=0, weights=weights)
            off = (self.points[on] - middle) * np.sqrt(weights)[:, None]
            values, vectors = np.linalg.eigh(off.T @ off)
            if values[1] > 0.005 * values[2]:  # otherwise nearly a line, which says no normal
                normal = vectors[:, 0]
            offset = float(middle @ normal)
        return self.snapped(normal, offset, common)

    def snapped(
        self, normal: FloatArray, offset: float, common: FloatArray
    ) -> tuple[FloatArray, float]:
        """The plane with the nearest common normal, where as much lies on that."""
        if not len(common):
            return normal, offset
        nearest = common[np.argmax(np.abs(common @ normal))]
        if abs(nearest @ normal) < np.cos(np.radians(10)):
            return normal, offset
        on = self.on(normal, offset)
        offsets = self.points[on] @ nearest
        tried = np.quantile(offsets, np.linspace(0.1, 0.9, 17))
        support = self.members(np.repeat(nearest[None], len(tried), axis=0), tried) @ self.weights
        best = int(np.argmax(support))
        if support[best] < SNAP_GAIN * self.weights[on].sum():
            return normal, offset
        near = self.on(nearest, tried[best])
        at = np.average(
            self.points[near] @ nearest,
            weights=self.weights[near] / self.deviations(nearest)[near] ** 2,
        )
        return nearest, float(at)


def find_planes(evidence: Evidence, rng: np.random.Generator) -> Planes:
    """Planes on which much of the evidence lies, those with the most first."""
    none = Planes(normals=np.zeros((0, 3)), offsets=np.zeros(0))
    if len(evidence.points) < 8:
        return none
    tried = Hypotheses(evidence, rng)
    common = tried.common_normals()
    normals, offsets = tried.candidates(common)
    if not len(offsets):
        return none
    found = greedy(tried, normals, offsets, common)
    return Planes(
        normals=np.array([n for n, _ in found]).reshape(-1, 3),
        offsets=np.array([d for _, d in found]),
    )


def greedy(
    tried: Hypotheses, normals: FloatArray, offsets: FloatArray, common: FloatArray
) -> list[tuple[FloatArray, float]]:
    """One plane after the other, each with the most support that is not another's yet."""
    whole = tried.weights.astype(np.float32)
    least = MIN_SHARE * float(whole.sum())
    members = tried.members(normals, offsets)
    support = members @ whole
    enough = np.flatnonzero(support >= least)
    members, support = members[enough], support[enough]
    normals, offsets = normals[enough], offsets[enough]
    weights, open_ = whole.copy(), np.ones(len(offsets), bool)
    found: list[tuple[FloatArray, float]] = []
    owned: list[BoolArray] = []
    unexplained = support
    while len(found) < MAX_PLANES and open_.any():
        left = np.where(open_, unexplained, 0)
        best = int(np.argmax(left))
        if left[best] < least:
            break
        open_[best] = False
        fitted = tried.fitted(normals[best], offsets[best], common)
        if fitted is None:
            continue
        own = tried.on(*fitted)
        open_ &= members @ (whole * own) <= SAME_SHARE * support
        if any(is_same(own, other, whole) for other in owned):
            continue
        weights[own] = np.maximum(EXPLAINED_WEIGHT * weights[own], LEAST_WEIGHT * whole[own])
        unexplained = members @ weights
        found.append(fitted)
        owned.append(own)
    return found


def is_same(one: BoolArray, other: BoolArray, weights: Float32Array) -> bool:
    """Whether most of what lies on one of two planes lies on the other."""
    shared = weights[one & other].sum()
    return bool(shared > SAME_SHARE * min(weights[one].sum(), weights[other].sum()))
