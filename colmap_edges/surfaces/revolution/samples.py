"""Samples of the 2D chains of all views: rays that may touch smooth bodies, with normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, Table, ranks_of
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph

STEP = 6  # chain points from sample to sample
HALF_WINDOW = 5  # chain points on each side of a sample from which its tangent is fitted
MIN_POINTS = 24  # minimum number of points of a chain
MAX_BEND = 0.15  # maximum second difference of a smooth chain's normals


@dataclass(frozen=True, kw_only=True)
class Samples(Table):
    """Samples of chains.

    Attributes:
        views: (n,) int32 views, ascending.
        centers: (n, 3) their centres.
        rays: (n, 3) unit viewing rays.
        normals: (n, 3) unit normals of the planes of ray and tangent, of any sign.
        focals: (n,) focal lengths of the views, pixels.
        lengths: (n,) numbers of samples of their chains at which these run smoothly.
        fixed: (n,) whether fixed 3D edges observe them.
    """

    views: Int32Array
    centers: FloatArray
    rays: FloatArray
    normals: FloatArray
    focals: FloatArray
    lengths: IntArray
    fixed: BoolArray


def samples_of(view: View, index: int, graph: EdgeGraph, is_fixed: BoolArray) -> Samples:
    """Samples of a view's chains; fixed 3D edges observe (n,) of their points."""
    points = graph.undistorted.astype(np.float64)
    lengths = np.diff(graph.polyline_offsets)
    ids = graph.polyline_ids
    ranks = ranks_of(lengths)
    inner = (ranks >= HALF_WINDOW) & (ranks < lengths[ids] - HALF_WINDOW)
    inner &= (lengths[ids] >= MIN_POINTS) & ((ranks - HALF_WINDOW) % STEP == 0)
    rows = np.flatnonzero(inner)
    reach = np.arange(-HALF_WINDOW, HALF_WINDOW + 1)
    tangents = np.einsum("k,nkj->nj", reach, points[rows[:, None] + reach])
    flat = np.column_stack([tangents, np.zeros(len(rows))]) @ view.rotation
    rays = unit(view.rays_of_undistorted(points[rows]))
    normals = unit(np.cross(rays, flat))
    return Samples(
        views=np.full(len(rows), index, np.int32),
        centers=np.tile(view.center, (len(rows), 1)),
        rays=rays,
        normals=normals,
        focals=np.full(len(rows), view.focal_px),
        lengths=smooth_lengths(normals, ids[rows]),
        fixed=is_fixed[rows],
    )


def smooth_lengths(normals: FloatArray, chains: Int32Array) -> IntArray:
    """(n,) at how many samples of its chain each one's runs smoothly, as outlines do."""
    bends = np.linalg.norm(normals[:-2] - 2 * normals[1:-1] + normals[2:], axis=1)
    smooth = np.zeros(len(normals), bool)
    smooth[1:-1] = (bends < MAX_BEND) & (chains[2:] == chains[:-2])
    counts = np.bincount(chains[smooth], minlength=chains.max(initial=-1) + 1)
    return np.asarray(counts[chains], np.int64)
