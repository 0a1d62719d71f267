"""Observed points on surfaces, from edges and SfM, for face detection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    joined_offsets,
    owners_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import lengths_of

TANGENT_REACH = 8  # half length, in points, of the chord that is an edge point's tangent
MAX_BEND = 0.05  # maximum deviation of the edge from that chord, relative to its length
SFM_WEIGHT_PX = 4.0  # weight of an SfM point, as length of an edge


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Points of surfaces, with how sure they are, and the views that observe them.

    Attributes:
        points: (N, 3) world units; first the SfM points, then those of edges.
        tangents: (N, 3) unit directions of straight edges; 0 of other points.
        rays: (N, 3) unit directions in which the points are seen, from the middle of their views.
        sigmas: (N,) standard deviations across the rays, world units.
        ray_sigmas: (N,) standard deviations along the rays, world units.
        weights: (N,) lengths of edges in pixels.
        edge_ids: (N,) edges of the points, which follow each other; -1 of SfM points.
        offsets: (N + 1,) of the tracks.
        views: (T,) int32 views of the tracks.
    """

    points: FloatArray
    tangents: FloatArray
    rays: FloatArray
    sigmas: FloatArray
    ray_sigmas: FloatArray
    weights: FloatArray
    edge_ids: IntArray
    offsets: IntArray
    views: Int32Array

    def deviations(self, rows: IntArray, normals: FloatArray, offsets: FloatArray) -> FloatArray:
        """(R,) signed distances of (R,) points from planes, in standard deviations.

        Args:
            rows: (R,) the points.
            normals: (R, 3) unit normals of the planes.
            offsets: (R,) their offsets, world units.
        """
        off = np.einsum("ij,ij->i", self.points[rows], normals) - offsets
        across = np.einsum("ij,ij->i", self.rays[rows], normals)
        sigmas = np.hypot(self.sigmas[rows], self.ray_sigmas[rows] * across)
        return np.asarray(off / sigmas)


def gather_evidence(model: Model, edges: Edges3D) -> Evidence:
    """What SfM points and edges say of surfaces."""
    points, offsets, views = points_and_views(model, edges)
    rays, pixels, spread = sight_of(points, offsets, views, model)
    num_sfm = len(model.points3D_xyz)
    ray_sigmas = pixels / spread
    ray_sigmas[num_sfm:] = ray_sigmas_of(edges, pixels[num_sfm:], spread[num_sfm:])
    lengths = edge_lengths(edges) / pixels[num_sfm:]
    return Evidence(
        points=points,
        tangents=np.concatenate([np.zeros((num_sfm, 3)), tangents_of(edges)]),
        rays=rays,
        sigmas=pixels,
        ray_sigmas=ray_sigmas,
        weights=np.concatenate([np.full(num_sfm, SFM_WEIGHT_PX), lengths]),
        edge_ids=np.concatenate([np.full(num_sfm, -1), edges.edge_ids]),
        offsets=offsets,
        views=views,
    )


def points_and_views(model: Model, edges: Edges3D) -> tuple[FloatArray, IntArray, Int32Array]:
    """(N, 3) SfM points and points of edges, and (N + 1,) offsets and int32 views of their tracks.

    They are the first arrays of the evidence.
    """
    points = np.concatenate([model.points3D_xyz, edges.points])
    offsets = joined_offsets([model.track_offsets, edges.observations.offsets])
    views = np.concatenate([model.track_views, edges.observations.views]).astype(np.int32)
    return points, offsets, views


def sight_of(
    points: FloatArray, offsets: IntArray, views: Int32Array, model: Model
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How points are seen.

    Returns:
        (N, 3) unit directions to them, (N,) size of a pixel at their place in the views that see
        them from near by, and (N,) spread of the directions, radians.
    """
    owners, counts = owners_of(offsets), np.maximum(np.diff(offsets), 1)
    away = points[owners] - model.camera_centers[views]
    distances = lengths_of(away) + 1e-300
    away /= distances[:, None]
    sums = np.column_stack([np.bincount(owners, axis, len(points)) for axis in away.T])
    length = np.linalg.norm(sums, axis=1) + 1e-300
    spread = np.sqrt(np.maximum(1 - (length / counts) ** 2, 1e-12)) * np.sqrt(counts)
    focals = np.array([view.focal_px / view.scale for view in model.views])
    sizes = distances / focals[views]
    pixels = np.full(len(points), np.median(sizes) if len(sizes) else 1.0)
    seen = np.diff(offsets)
    for count in np.unique(seen[seen > 0]).tolist():  # a tenth of the time of sorting them all
        rows, rank = np.flatnonzero(seen == count), (count - 1) // 4
        own = sizes[offsets[rows, None] + np.arange(count)]
        pixels[rows] = np.partition(own, rank, axis=1)[:, rank]
    return sums / length[:, None], pixels, spread


def ray_sigmas_of(edges: Edges3D, pixels: FloatArray, spread: FloatArray) -> FloatArray:
    """(N,) standard deviations of edge points along their rays, world units.

    They are those of the edges where known, otherwise follow from `pixels` and `spread` (N,) of
    `sight_of`.
    """
    return np.where(np.isfinite(edges.sigmas), edges.sigmas, pixels / spread)


def tangents_of(edges: Edges3D) -> FloatArray:
    """(N, 3) unit tangents of edge points; 0 where the edge is bent."""
    index = np.arange(edges.num_points)
    owners = edges.edge_ids
    before = np.maximum(index - TANGENT_REACH, edges.edge_offsets[owners])
    after = np.minimum(index + TANGENT_REACH, edges.edge_offsets[owners + 1] - 1)
    chords = edges.points[after] - edges.points[before]
    lengths = np.linalg.norm(chords, axis=1)
    tangents = chords / (lengths[:, None] + 1e-300)
    from_start = edges.points - edges.points[before]
    off = from_start - np.einsum("ij,ij->i", from_start, tangents)[:, None] * tangents
    bent = np.linalg.norm(off, axis=1) > MAX_BEND * lengths
    tangents[bent | (lengths == 0)] = 0
    return np.asarray(tangents, np.float64)


def edge_lengths(edges: Edges3D) -> FloatArray:
    """(N,) length of edge that belongs to each point, world units."""
    segments = edges.segments
    lengths = np.linalg.norm(edges.points[segments[:, 0]] - edges.points[segments[:, 1]], axis=1)
    halves = np.repeat(lengths / 2, 2)
    lengths_of_points = np.bincount(segments.ravel(), halves, edges.num_points)
    return np.asarray(lengths_of_points, np.float64)


def joined(one: Evidence, other: Evidence) -> Evidence:
    """The evidence of both."""
    arrays = {
        name: np.concatenate([getattr(one, name), getattr(other, name)])
        for name in vars(one)
        if name != "offsets"
    }
    return Evidence(offsets=joined_offsets([one.offsets, other.offsets]), **arrays)
