"""Search index of a view's edge graph, and lookup of positions on its chains."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from colmap_edges.core.arrays import ByteArray, Float32Array, FloatArray, IntArray
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.executors import in_threads


def make_edge_index(graph: EdgeGraph, view: View) -> _kernels.EdgeIndex:
    """The search index of a view's edge graph."""
    return _kernels.EdgeIndex(
        graph.undistorted,
        graph.normals,
        graph.sides,
        graph.polyline_offsets,
        graph.closed,
        view.rotation,
        view.translation,
        view.focal_px,
    )


class IndexedGraphs(Protocol):
    """Edge graphs of all views, with their search indices."""

    @property
    def num_views(self) -> int:
        """Number of views."""

    def graph(self, view: int) -> EdgeGraph:
        """The edge graph of a view."""

    def index(self, view: int) -> _kernels.EdgeIndex:
        """The search index of a view's edge graph."""


def look_up(
    given: IndexedGraphs, *observed: ChainObservations, num_threads: int
) -> list[tuple[Observations, FloatArray]]:
    """Look up pixels, normals and (T, 3) colours of observations on chains.

    Args:
        given: the edge graphs of all views; each is used once.
        observed: positions on their chains, of one or more kinds of points.
        num_threads: threads to use; the result does not depend on it.
    """
    found = [unknown(of) for of in observed]
    rows_of = [dict(of.by_view()) for of in observed]

    def fill_in(view: int) -> None:
        graph, index = given.graph(view), given.index(view)
        for (seen, colors), rows_by_view in zip(found, rows_of, strict=True):
            rows = rows_by_view.get(view, np.zeros(0, np.int64))
            positions = seen.positions[rows]
            seen.chains[rows] = graph.polyline_ids[positions.astype(np.int64)]
            pixels, colors[rows] = at_positions(graph, positions, graph.points, graph.colors)
            seen.pixels[rows] = pixels
            seen.normals[rows] = across(tangents_at(graph, index, positions))

    in_threads(fill_in, sorted(set().union(*rows_of)), num_threads)
    return found


def unknown(observed: ChainObservations) -> tuple[Observations, FloatArray]:
    """Observations at known positions, and their colours, to be filled in."""
    count = len(observed.views)
    seen = Observations(
        offsets=observed.offsets,
        views=observed.views,
        positions=observed.positions,
        chains=np.zeros(count, np.int32),
        pixels=np.zeros((count, 2)),
        normals=np.zeros((count, 2), np.float32),
    )
    return seen, np.zeros((count, 3))


def tangents_at(graph: EdgeGraph, index: _kernels.EdgeIndex, positions: FloatArray) -> FloatArray:
    """(M, 2) tangents at positions on a view's chains, linear between its points."""
    low = positions.astype(np.int64)
    ends = np.stack([low, next_points(graph, low)]).astype(np.float64)
    before, behind = _kernels.chain_points(index, ends.ravel())[1].reshape(2, -1, 2)
    weight = (positions - low)[:, None]
    return np.asarray((1 - weight) * before + weight * behind)


def across(tangents: FloatArray) -> FloatArray:
    """(N, 2) unit normals of (N, 2) tangents."""
    lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
    normals: FloatArray = tangents[:, ::-1] * (-1, 1) / np.where(lengths > 0, lengths, 1)
    return normals


def at_positions(
    graph: EdgeGraph, positions: FloatArray, *values: FloatArray | Float32Array | ByteArray
) -> list[FloatArray]:
    """(M, k) interpolation of the (N, k) values of a graph's points at (M,) positions."""
    low = positions.astype(np.int64)
    high, share = next_points(graph, low), (positions - low)[:, None]
    return [between(of.take(low, axis=0), of.take(high, axis=0), share) for of in values]


def between(
    first: FloatArray | Float32Array | ByteArray,
    second: FloatArray | Float32Array | ByteArray,
    share: FloatArray,
) -> FloatArray:
    """Linear interpolation: `first` at share 0, `second` at share 1."""
    values: FloatArray = (1 - share) * first + share * second
    return values


def next_points(graph: EdgeGraph, points: IntArray) -> IntArray:
    """(M,) next point on the chain of each of (M,) points; the last of an open chain itself."""
    polyline = graph.polyline_ids[points]
    last = graph.polyline_offsets[polyline + 1] - 1
    wrapped = np.where(graph.closed[polyline], graph.polyline_offsets[polyline], last)
    following: IntArray = np.where(points < last, points + 1, wrapped)
    return following


def positions_near(
    index: _kernels.EdgeIndex,
    radius_px: float,
    num_threads: int,
    points: FloatArray,
    directions: FloatArray,
    min_cosine: float,
) -> FloatArray:
    """(n, k) positions on one view's chains that observe (n, k, 3) world points; -1 for none.

    Args:
        index: search index of the chains.
        radius_px: maximum distance between a chain and the projected point.
        num_threads: number of threads; does not affect the result.
        points: the points.
        directions: (n, k, 3) directions of the 3D edge at the points.
        min_cosine: minimum cosine of the angle between edge and chain in the image.
    """
    positions: FloatArray = _kernels.associate(
        [index],
        points.reshape(-1, 3),
        directions.reshape(-1, 3),
        np.zeros(points.size // 3, np.int8),
        max_distance_px=radius_px,
        min_cosine=min_cosine,
        num_threads=num_threads,
    )
    return positions.reshape(points.shape[:2])
