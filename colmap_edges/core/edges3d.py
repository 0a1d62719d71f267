"""3D edges with points, observations and nodes: the result of tracing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    offsets_of,
    owners_of,
    parts_of,
)
from colmap_edges.core.checks import (
    MAX_INTEGER,
    check_arrays,
    check_offsets,
    check_values,
    checked,
)
from colmap_edges.core.observations import Observations
from colmap_edges.core.outlines import NO_OUTLINES, Outlines
from colmap_edges.errors import check_type


@dataclass(frozen=True, kw_only=True)
class Nodes:
    """Points at which ends of 3D edges meet: K corners, joints and T junctions.

    Attributes:
        points: (K, 3) float64 world points.
        sigmas: (K,) float64 standard deviation of a point, world units.
        observations: tracks of the K points.
        colors: (K, 3) uint8 RGB.
        through_points: (K,) int64 the edge point that coincides with the node on an edge passing
            through it (T junction); -1 for none.
    """

    points: Annotated[FloatArray, "K", 3]
    sigmas: Annotated[FloatArray, "K"]
    observations: Observations
    colors: Annotated[ByteArray, "K", 3]
    through_points: Annotated[IntArray, "K"]

    def check(self, name: str, num_points: int, num_views: int | None = None) -> None:
        """Check shapes, dtypes and values; see `Edges3D.check`.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        check_values(f"{name}.through_points", self.through_points, -1, num_points - 1)
        check_type(f"{name}.observations", self.observations, (Observations,))
        self.observations.check(f"{name}.observations", num_views, N=len(self.points))

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
    """3D edges as polylines of edge points with tracks, in CSR arrays.

    Attributes:
        points: (N, 3) float64 edge points, world units; those of one edge are contiguous.
        edge_offsets: (E + 1,) int64; edge e is points[edge_offsets[e]:edge_offsets[e + 1]].
        closed: (E,) bool; the last point of a closed edge connects to its first.
        observations: tracks of the N points.
        sigmas: (N,) float64 standard deviation of a point, world units; NaN where unknown.
        end_nodes: (E, 2) int32 node at each end, -1 for none; edges that share a node meet there.
        colors: (N, 3) uint8 RGB, mean colour of the observations.
        nodes: the nodes that `end_nodes` refers to, where they have own points. Edge points at
            such ends are copies of the node's point.
    """

    points: Annotated[FloatArray, "N", 3]
    edge_offsets: Annotated[IntArray, "E+1"]
    closed: Annotated[BoolArray, "E"]
    observations: Observations
    sigmas: Annotated[FloatArray, "N"]
    end_nodes: Annotated[Int32Array, "E", 2]
    colors: Annotated[ByteArray, "N", 3]
    nodes: Nodes = field(default_factory=Nodes.none)

    def __repr__(self) -> str:
        """The numbers of edges, points and nodes and the total length, in one line."""
        return (
            f"<Edges3D: {self.num_edges:,} edges of {self.num_points:,} points, total length "
            f"{self.lengths().sum():.4g}, {len(self.nodes.points):,} nodes>"
        )

    def __len__(self) -> int:
        """Number of 3D edges."""
        return self.num_edges

    def __getitem__(self, chosen: Any) -> Edges3D:
        """Some of the edges, with their tracks and nodes.

        Args:
            chosen: number of one edge, a slice, or an array of numbers or bools, as of numpy.

        Raises:
            IndexError: if there is no edge of a number.
        """
        edges = np.atleast_1d(np.arange(self.num_edges)[chosen])
        order = entries_of(self.edge_offsets, edges)
        offsets = offsets_of(np.diff(self.edge_offsets)[edges])
        taken = self.reordered(order, offsets, self.closed[edges], self.end_nodes[edges])
        used = np.unique(taken.end_nodes[taken.end_nodes >= 0]).astype(np.int64)
        if not len(self.nodes.points):
            return taken
        numbers = np.full(len(self.nodes.points) + 1, -1, np.int32)  # the last is that of -1
        numbers[used] = np.arange(len(used))
        places = np.full(self.num_points + 1, -1, np.int64)
        places[order] = np.arange(len(order))
        nodes = Nodes(
            points=self.nodes.points[used],
            sigmas=self.nodes.sigmas[used],
            observations=self.nodes.observations.select(used),
            colors=self.nodes.colors[used],
            through_points=places[self.nodes.through_points[used]],
        )
        return replace(taken, end_nodes=numbers[taken.end_nodes], nodes=nodes)

    def lengths(self) -> FloatArray:
        """Length (E,) of each edge, world units."""
        first, second = self.segments.T
        steps = np.linalg.norm(self.points[second] - self.points[first], axis=1)
        lengths = np.bincount(self.edge_ids[first], steps, self.num_edges)
        return np.asarray(lengths, np.float64)

    def polylines(self) -> list[FloatArray]:
        """The points (n, 3) of each edge; those of closed edges end with the first again."""
        parts = parts_of(self.points, self.edge_offsets)
        return [
            np.concatenate([part, part[:1]]) if closed else part
            for part, closed in zip(parts, self.closed, strict=True)
        ]

    @checked
    def observations_of(self, edge: int) -> Observations:
        """The observations of the points of an edge, in their order.

        Raises:
            ColmapEdgesError: if there is no such edge.
        """
        check_values("edge", np.array(edge), 0, self.num_edges - 1)
        first, end = self.edge_offsets[edge : edge + 2].tolist()
        return self.observations.select(np.arange(first, end, dtype=np.int64))

    def check(self, name: str = "edges", num_views: int | None = None) -> None:
        """Check shapes, dtypes and values, as all functions of the Python interface do.

        Args:
            name: name of the edges in messages.
            num_views: number of views of their model; any if None.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        check_offsets(f"{name}.edge_offsets", self.edge_offsets, self.num_points, least=1)
        check_type(f"{name}.nodes", self.nodes, (Nodes,))
        self.nodes.check(f"{name}.nodes", self.num_points, num_views)
        last = len(self.nodes.points) - 1 if len(self.nodes.points) else MAX_INTEGER
        check_values(f"{name}.end_nodes", self.end_nodes, -1, last)
        check_type(f"{name}.observations", self.observations, (Observations,))
        self.observations.check(f"{name}.observations", num_views, N=self.num_points)

    @classmethod
    def none(cls) -> Edges3D:
        """No edges."""
        return cls.of_polylines(np.zeros((0, 3)), np.zeros(0, np.int64))

    @classmethod
    @checked
    def of_polylines(
        cls, points: FloatArray, lengths: IntArray, observations: Observations | None = None
    ) -> Edges3D:
        """Open edges of (E,) numbers of consecutive points, without nodes and deviations.

        Raises:
            ColmapEdgesError: if the numbers do not add up to the number of points.
        """
        unobserved = replace(Observations.none(), offsets=np.zeros(len(points) + 1, np.int64))
        edges = cls(
            points=points,
            edge_offsets=offsets_of(lengths),
            closed=np.zeros(len(lengths), bool),
            observations=unobserved if observations is None else observations,
            sigmas=np.full(len(points), np.nan),
            end_nodes=np.full((len(lengths), 2), -1, np.int32),
            colors=np.zeros((len(points), 3), np.uint8),
        )
        check_arrays("edges", edges)
        check_offsets("offsets of the lengths", edges.edge_offsets, len(points))
        return edges

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
        """Number of distinct points: edge points of one node count once."""
        return int((self.node_ids < 0).sum()) + len(self.nodes.points)

    @property
    def edge_ids(self) -> IntArray:
        """(N,) edge index of each point."""
        return owners_of(self.edge_offsets)

    @property
    def num_views(self) -> IntArray:
        """(E,) number of views that observe any point of each edge."""
        seen = self.observations
        count = int(seen.views.max(initial=0)) + 1
        pairs = np.unique(self.edge_ids[seen.points] * count + seen.views)
        return np.bincount(pairs // count, minlength=self.num_edges)

    @cached_property
    def segments(self) -> Int32Array:
        """(S, 2) pairs of consecutive edge points; closed edges also connect last and first."""
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
        """(N,) node of each edge point; -1 for points that are no node."""
        ids = np.full(self.num_points, -1, np.int64)
        if len(self.nodes.points):
            tips = np.column_stack([self.edge_offsets[:-1], self.edge_offsets[1:] - 1])
            met = self.end_nodes >= 0
            ids[tips[met]] = self.end_nodes[met]
            through = self.nodes.through_points
            ids[through[through >= 0]] = np.flatnonzero(through >= 0)
        return ids

    def distinct(self) -> tuple[DistinctPoints, IntArray]:
        """The distinct points, and the (N,) index of every edge point among them.

        Points of single edges come first, in their order, then the nodes.
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

    @checked
    def reordered(
        self,
        order: IntArray,
        edge_offsets: IntArray,
        closed: BoolArray,
        end_nodes: Int32Array | None = None,
    ) -> Edges3D:
        """These edges with (n,) selected points, reordered and cut into new edges, with tracks.

        Nodes lose their points, since ends may have moved.

        Args:
            order: (n,) indices of the points.
            edge_offsets: (E' + 1,) offsets of the new edges.
            closed: (E',) whether each new edge is closed.
            end_nodes: (E', 2) nodes of the new edges; by default none.

        Raises:
            ColmapEdgesError: if there is no point of an index.
        """
        check_values("order", order, 0, self.num_points - 1)
        return Edges3D(
            points=self.points[order],
            edge_offsets=edge_offsets,
            closed=closed,
            observations=self.observations.select(order),
            sigmas=self.sigmas[order],
            end_nodes=np.full((len(closed), 2), -1, np.int32) if end_nodes is None else end_nodes,
            colors=self.colors[order],
        )


@dataclass(frozen=True, kw_only=True)
class DistinctPoints:
    """Edge points and nodes without duplicates.

    Attributes:
        points: (D, 3) float64 world points.
        colors: (D, 3) uint8 RGB.
        observations: their tracks.
    """

    points: FloatArray
    colors: ByteArray
    observations: Observations


@dataclass(frozen=True, kw_only=True)
class AdjustedPoses:
    """Poses and SfM points of a model after bundle adjustment.

    Attributes:
        motions: (F, 3, 4) rigid motion before each frame's pose, frames by ascending id; (0, 3, 4)
            if poses stay as they are.
        points3D_xyz: (N, 3) the SfM points; (0, 3) if poses stay as they are.
    """

    motions: FloatArray
    points3D_xyz: FloatArray


AS_GIVEN = AdjustedPoses(motions=np.zeros((0, 3, 4)), points3D_xyz=np.zeros((0, 3)))


@dataclass(frozen=True, kw_only=True)
class TracedEdges:
    """The result of tracing the edge graphs of all views.

    Attributes:
        edges: 3D edges, fixed in the scene.
        contours: view-dependent contours, which move over a surface from view to view, as
            silhouettes and reflections do. They are used for meshing, never written as edges.
        outlines: points at which viewing rays touch smooth bodies; they are used for meshing.
        poses: the poses with which they were traced, refined on edges or as given.
    """

    edges: Edges3D
    contours: Edges3D
    outlines: Outlines = NO_OUTLINES
    poses: AdjustedPoses = AS_GIVEN


def mean_colors(values: FloatArray, offsets: IntArray) -> ByteArray:
    """(N, 3) mean colours of points, of the (T, 3) colours of their observations; else black."""
    counts = np.diff(offsets)
    points = owners_of(offsets)
    sums = np.column_stack([np.bincount(points, channel, len(counts)) for channel in values.T])
    return np.asarray(np.rint(sums / np.maximum(counts, 1)[:, None]).astype(np.uint8))
