"""Samples of the 2D chains of all views: rays that may touch smooth bodies, with normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.graphs import Graphs

STEP = 6  # chain points from sample to sample
HALF_WINDOW = 5  # chain points on each side of a sample from which its tangent is fitted
MIN_POINTS = 24  # minimum number of points of a chain
MAX_BEND = 0.15  # maximum second difference of a smooth chain's normals
REACH = 4  # chain points on each side of an observation that belong to the observed edge


@dataclass(frozen=True, kw_only=True)
class Samples:
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

    def chosen(self, rows: IntArray) -> Samples:
        """Some of the samples."""
        return Samples(**{name: array[rows] for name, array in vars(self).items()})


def find_samples(views: Sequence[View], graphs: Graphs, edges: Edges3D) -> Samples:
    """Samples of the chains of all views.

    Args:
        views: all views.
        graphs: their edge graphs.
        edges: fixed 3D edges that observe the graphs.
    """
    observed = edges.observations
    rows_of = rows_by_view(observed.views, len(views))
    parts = [
        vars(samples_of(view, index, graphs.load(index), observed.positions[rows]))
        for index, (view, rows) in enumerate(zip(views, rows_of, strict=True))
    ]
    return Samples(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def samples_of(view: View, index: int, graph: EdgeGraph, positions: FloatArray) -> Samples:
    """Samples of a view's chains; 3D edges observe (n,) `positions` on them."""
    points = graph.undistorted.astype(np.float64)
    lengths = np.diff(graph.polyline_offsets)
    ids = graph.polyline_ids
    ranks = np.arange(len(points)) - graph.polyline_offsets[ids]
    inner = (ranks >= HALF_WINDOW) & (ranks < lengths[ids] - HALF_WINDOW)
    inner &= (lengths[ids] >= MIN_POINTS) & ((ranks - HALF_WINDOW) % STEP == 0)
    rows = np.flatnonzero(inner)
    reach = np.arange(-HALF_WINDOW, HALF_WINDOW + 1)
    tangents = np.einsum("k,nkj->nj", reach, points[rows[:, None] + reach])
    flat = np.column_stack([tangents, np.zeros(len(rows))]) @ view.rotation
    local = np.column_stack([points[rows] / view.focal_px, np.ones(len(rows))])
    rays = unit(local @ view.rotation)
    normals = unit(np.cross(rays, flat))
    return Samples(
        views=np.full(len(rows), index, np.int32),
        centers=np.tile(view.center, (len(rows), 1)),
        rays=rays,
        normals=normals,
        focals=np.full(len(rows), view.focal_px),
        lengths=smooth_lengths(normals, ids[rows]),
        fixed=are_observed(len(points), positions)[rows],
    )


def smooth_lengths(normals: FloatArray, chains: Int32Array) -> IntArray:
    """(n,) at how many samples of its chain each one's runs smoothly, as outlines do."""
    bends = np.linalg.norm(normals[:-2] - 2 * normals[1:-1] + normals[2:], axis=1)
    smooth = np.zeros(len(normals), bool)
    smooth[1:-1] = (bends < MAX_BEND) & (chains[2:] == chains[:-2])
    counts = np.bincount(chains[smooth], minlength=chains.max(initial=-1) + 1)
    return np.asarray(counts[chains], np.int64)


def are_observed(count: int, positions: FloatArray) -> BoolArray:
    """(count,) whether chain points are within `REACH` of observed (n,) positions."""
    near = np.zeros(count + 2 * REACH + 1, np.int64)
    at = np.clip(np.nan_to_num(positions, nan=-1.0), -1, count - 1).astype(np.int64)
    at = at[at >= 0]
    np.add.at(near, at, 1)
    np.add.at(near, at + 2 * REACH + 1, -1)
    return np.asarray(np.cumsum(near)[REACH : REACH + count] > 0)
