"""3D edges: what tracing makes, refinement moves, and model and exports write."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    offsets_of,
    owners_of,
)


@dataclass(frozen=True, kw_only=True)
class Edges3D:
    """3D edges as polylines of edge points, each point with its track, all in CSR arrays.

    Attributes:
        points: (N, 3) float64 edge points, world units; those of one edge are contiguous.
        edge_offsets: (E + 1,) int64; edge e is points[edge_offsets[e]:edge_offsets[e + 1]].
        closed: (E,) bool; the last point of a closed edge connects to its first.
        track_offsets: (N + 1,) int64; observations of point i are track_offsets[i]:[i + 1].
        track_views: (T,) int32 indices into the model's views; a view at most once a point.
        track_points2D: (T, 2) float64 observed edge points, image pixels, COLMAP's origin.
        sigmas: (N,) float64 standard deviation of a point, world units; NaN where unknown.
        end_nodes: (E, 2) int32; edges with the same node id at an end meet there; -1 is none.
        colors: (N, 3) uint8 RGB, the mean of the images where they observe the point.
        outlines: curves that are no edges, since they move over a body from view to view as its
            outline and its reflections do, but near its surface: only the mesh uses them.
    """

    points: FloatArray
    edge_offsets: IntArray
    closed: BoolArray
    track_offsets: IntArray
    track_views: Int32Array
    track_points2D: FloatArray
    sigmas: FloatArray
    end_nodes: Int32Array
    colors: ByteArray
    outlines: Edges3D | None = None

    @property
    def num_edges(self) -> int:
        """Number of 3D edges."""
        return len(self.closed)

    @property
    def num_points(self) -> int:
        """Number of edge points over all edges."""
        return len(self.points)

    @property
    def edge_ids(self) -> IntArray:
        """(N,) edge of each point."""
        return owners_of(self.edge_offsets)

    @cached_property
    def track_points(self) -> IntArray:
        """(T,) point of each observation."""
        return owners_of(self.track_offsets)

    @cached_property
    def segments(self) -> Int32Array:
        """(S, 2) successive edge points; closed edges return to their first."""
        first, last = self.edge_offsets[:-1], self.edge_offsets[1:] - 1
        starts = np.arange(self.num_points)
        ends = starts + 1
        is_last = np.zeros(self.num_points, bool)
        is_last[last] = True
        ends[last] = first
        loops = np.zeros(self.num_points, bool)
        loops[last] = self.closed
        kept = ~is_last | loops
        return np.column_stack([starts, ends])[kept].astype(np.int32)

    def reordered(
        self,
        order: IntArray,
        edge_offsets: IntArray,
        closed: BoolArray,
        end_nodes: Int32Array,
    ) -> Edges3D:
        """The points (n,) of these edges in another order, with their tracks, cut anew.

        Args:
            order: (n,) indices of the points.
            edge_offsets: (E' + 1,) offsets of the new edges.
            closed: (E',) which of them are closed.
            end_nodes: (E', 2) their nodes.
        """
        rows = entries_of(self.track_offsets, order)
        return Edges3D(
            points=self.points[order],
            edge_offsets=edge_offsets,
            closed=closed,
            track_offsets=offsets_of(np.diff(self.track_offsets)[order]),
            track_views=self.track_views[rows],
            track_points2D=self.track_points2D[rows],
            sigmas=self.sigmas[order],
            end_nodes=end_nodes,
            colors=self.colors[order],
        )


def mean_colors(values: FloatArray, track_offsets: IntArray) -> ByteArray:
    """(N, 3) colours of points from (T, 3) those of their observations; black without any."""
    counts = np.diff(track_offsets)
    points = owners_of(track_offsets)
    sums = np.column_stack([np.bincount(points, channel, len(counts)) for channel in values.T])
    colors: ByteArray = np.rint(sums / np.maximum(counts, 1)[:, None]).astype(np.uint8)
    return colors


def arrays_of_edges(edges: Edges3D) -> dict[str, NDArray[Any]]:
    """The arrays of edges and, after "outlines.", of their outlines."""
    arrays = {entry.name: getattr(edges, entry.name) for entry in fields(edges)}
    outlines: Edges3D | None = arrays.pop("outlines")
    if outlines is not None:
        arrays |= {f"outlines.{name}": a for name, a in arrays_of_edges(outlines).items()}
    return arrays


def edges_from_arrays(arrays: Mapping[str, NDArray[Any]]) -> Edges3D:
    """What `arrays_of_edges` took apart."""
    own = {name: array for name, array in arrays.items() if not name.startswith("outlines.")}
    rest = {
        name.removeprefix("outlines."): array for name, array in arrays.items() if name not in own
    }
    return Edges3D(**own, outlines=edges_from_arrays(rest) if rest else None)
