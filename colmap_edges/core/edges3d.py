"""3D edges: what tracing makes, refinement moves, and model and exports write."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    owners_of,
)
from colmap_edges.core.observations import Observations


@dataclass(frozen=True, kw_only=True)
class Nodes:
    """Where ends of 3D edges meet: K corners, joints and T junctions, each one point.

    Attributes:
        points: (K, 3) float64 world points.
        sigmas: (K,) float64 standard deviation of a point, world units.
        observations: where views observe the K points: their tracks.
        colors: (K, 3) uint8 RGB.
        through_points: (K,) int64 the edge point that is this node, of an edge that passes through
            it and goes on (T junction); -1 is none.
    """

    points: FloatArray
    sigmas: FloatArray
    observations: Observations
    colors: ByteArray
    through_points: IntArray

    @classmethod
    def none(cls) -> Nodes:
        """No nodes."""
        return cls(
            points=np.zeros((0, 3)),
            sigmas=np.zeros(0),
            observations=Observations.none(),
            colors=np.zeros((0, 3), np.uint8),
            through_points=np.zeros(0, np.int64),
        )


@dataclass(frozen=True, kw_only=True)
class Edges3D:
    """3D edges as polylines of edge points, each point with its track, all in CSR arrays.

    Attributes:
        points: (N, 3) float64 edge points, world units; those of one edge are contiguous.
        edge_offsets: (E + 1,) int64; edge e is points[edge_offsets[e]:edge_offsets[e + 1]].
        closed: (E,) bool; the last point of a closed edge connects to its first.
        observations: where views observe the N points: their tracks.
        sigmas: (N,) float64 standard deviation of a point, world units; NaN where unknown.
        end_nodes: (E, 2) int32; edges with the same node id at an end meet there; -1 is none.
        colors: (N, 3) uint8 RGB, the mean of the images where they observe the point.
        nodes: the nodes that `end_nodes` numbers, where they have points of their own. The edge
            points at such ends are copies of them.
    """

    points: FloatArray
    edge_offsets: IntArray
    closed: BoolArray
    observations: Observations
    sigmas: FloatArray
    end_nodes: Int32Array
    colors: ByteArray
    nodes: Nodes = field(default_factory=Nodes.none)

    @classmethod
    def none(cls) -> Edges3D:
        """No edges."""
        return cls(
            points=np.zeros((0, 3)),
            edge_offsets=np.zeros(1, np.int64),
            closed=np.zeros(0, bool),
            observations=Observations.none(),
            sigmas=np.zeros(0),
            end_nodes=np.zeros((0, 2), np.int32),
            colors=np.zeros((0, 3), np.uint8),
        )

    @property
    def num_edges(self) -> int:
        """Number of 3D edges."""
        return len(self.closed)

    @property
    def num_points(self) -> int:
        """Number of edge points over all edges."""
        return len(self.points)

    @property
    def num_distinct(self) -> int:
        """Number of physical points: edge points that are one node count once."""
        return int((self.node_ids < 0).sum()) + len(self.nodes.points)

    @property
    def edge_ids(self) -> IntArray:
        """(N,) edge of each point."""
        return owners_of(self.edge_offsets)

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

    @property
    def node_ids(self) -> IntArray:
        """(N,) the node that an edge point is, -1 of all that are points of one edge alone."""
        ids = np.full(self.num_points, -1, np.int64)
        if len(self.nodes.points):
            tips = np.column_stack([self.edge_offsets[:-1], self.edge_offsets[1:] - 1])
            met = self.end_nodes >= 0
            ids[tips[met]] = self.end_nodes[met]
            through = self.nodes.through_points
            ids[through[through >= 0]] = np.flatnonzero(through >= 0)
        return ids

    def distinct(self) -> tuple[DistinctPoints, IntArray]:
        """The physical points, each once, and the (N,) place of every edge point among them.

        Points of one edge alone come first, in their order, then the nodes.
        """
        ids = self.node_ids
        own = np.flatnonzero(ids < 0)
        rows = np.where(ids < 0, np.cumsum(ids < 0) - 1, len(own) + ids)
        points = DistinctPoints(
            points=np.concatenate([self.points[own], self.nodes.points]),
            colors=np.concatenate([self.colors[own], self.nodes.colors]),
            observations=Observations.concatenated(
                [self.observations.select(own), self.nodes.observations]
            ),
        )
        return points, rows.astype(np.int64)

    def reordered(
        self,
        order: IntArray,
        edge_offsets: IntArray,
        closed: BoolArray,
        end_nodes: Int32Array,
    ) -> Edges3D:
        """The points (n,) of these edges in another order, with their tracks, cut anew.

        Nodes lose their points, as ends may no longer be where they were.

        Args:
            order: (n,) indices of the points.
            edge_offsets: (E' + 1,) offsets of the new edges.
            closed: (E',) which of them are closed.
            end_nodes: (E', 2) their nodes.
        """
        return Edges3D(
            points=self.points[order],
            edge_offsets=edge_offsets,
            closed=closed,
            observations=self.observations.select(order),
            sigmas=self.sigmas[order],
            end_nodes=end_nodes,
            colors=self.colors[order],
        )


@dataclass(frozen=True, kw_only=True)
class DistinctPoints:
    """Edge points and nodes, each physical point once.

    Attributes:
        points: (D, 3) float64 world points.
        colors: (D, 3) uint8 RGB.
        observations: their tracks.
    """

    points: FloatArray
    colors: ByteArray
    observations: Observations


@dataclass(frozen=True, kw_only=True)
class TracedEdges:
    """What tracing makes of the edge graphs of all views.

    Attributes:
        edges: curves that lie still.
        contours: view-dependent contours: curves that move over a body from view to view, as its
            silhouette and its reflections do, but near its surface. They are used for meshing,
            never written as edges.
    """

    edges: Edges3D
    contours: Edges3D


def mean_colors(values: FloatArray, offsets: IntArray) -> ByteArray:
    """(N, 3) colours of points from (T, 3) those of their observations; black without any."""
    counts = np.diff(offsets)
    points = owners_of(offsets)
    sums = np.column_stack([np.bincount(points, channel, len(counts)) for channel in values.T])
    colors: ByteArray = np.rint(sums / np.maximum(counts, 1)[:, None]).astype(np.uint8)
    return colors
