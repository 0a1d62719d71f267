"""What tracing looks at: views with their edge graphs, who is compared with whom, what is covered.

In later rounds that are the stretches of chains through which no edge runs: among few chains less
agreement tells a depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, IntArray, owners_of, ranges_of
from colmap_edges.core.view import View
from colmap_edges.edges2d.cached_graphs import CachedEdgeViews, CachedGraphs, Some
from colmap_edges.edges2d.edge_graph import EdgeGraph, keep_points
from colmap_edges.edges2d.edge_index import make_edge_view
from colmap_edges.edges2d.graph_store import GraphStore, Recent
from colmap_edges.edges3d.chains.filtering import Sorted, Traced, chosen, find_pieces
from colmap_edges.edges3d.chains.side_similarity import NOTHING_LEARNED, SideLikelihoods
from colmap_edges.edges3d.chains.view_selection import Neighborhood
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import TracingOptions
from colmap_edges.runtime.executors import Workers


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What tracing looks at: the views with their edge graphs in both forms, and who sees what.

    Attributes:
        views: the posed views.
        graphs: their edge graphs.
        edge_views: the same in the kernels' form.
        neighbors: per view those that its depths come from.
        witnesses: per view those in which its edges are looked for.
        polyline_offsets: those of the graphs, which are always in memory.
        covered: per view the points of its graph through which edges run already.
        whole: the graphs as they were made; those here may be parts of them.
        sides: what the gray beside an edge says of a match.
        free: per view the points of the whole graph that the one here has; none when it has all.
    """

    views: Sequence[View]
    graphs: Sequence[EdgeGraph]
    edge_views: Sequence[_kernels.EdgeView]
    neighbors: Sequence[IntArray]
    witnesses: Sequence[IntArray]
    polyline_offsets: Sequence[IntArray]
    covered: Sequence[BoolArray]
    whole: Sequence[EdgeGraph]
    sides: SideLikelihoods = NOTHING_LEARNED
    free: Sequence[BoolArray] | None = None

    def part(self, view: int, others: IntArray, workers: Workers) -> Scene:
        """What a task on a view and others needs: all, or what a worker elsewhere is sent."""
        if not (workers.remote and workers.cache and isinstance(self.whole, GraphStore)):
            return self
        places = [view, *others]
        keys, views = Some(self.whole.keys, places), Some(self.views, places)
        whole = CachedGraphs(workers.cache, keys)
        graphs: Sequence[EdgeGraph] = whole
        edge_views: Sequence[Any] = CachedEdgeViews(workers.cache, keys, views)
        if self.free is not None:
            graphs = RemainingGraphs(whole, Some(self.free, places))
            edge_views = edge_views_of(graphs, views, len(places))
        return Scene(
            views=views,
            graphs=graphs,
            edge_views=edge_views,
            neighbors=Some(self.neighbors, [view]),
            witnesses=Some(self.witnesses, [view]),
            polyline_offsets=Some(self.polyline_offsets, []),
            covered=Some(self.covered, [view]),
            whole=whole,
            sides=self.sides,
        )


@dataclass(frozen=True)
class RemainingGraphs(Sequence[EdgeGraph]):
    """The parts of edge graphs that are free."""

    graphs: Sequence[EdgeGraph]
    free: Sequence[BoolArray]

    def __len__(self) -> int:
        """Number of views."""
        return len(self.graphs)

    def __getitem__(self, view: Any) -> Any:
        """The free part of a view's edge graph."""
        return keep_points(self.graphs[view], self.free[view])


def make_scene(model: Model, graphs: Sequence[EdgeGraph], near: Neighborhood) -> Scene:
    """What tracing looks at, nothing covered yet; as many edge views are kept as graphs."""
    offsets = [graph.polyline_offsets for graph in graphs]
    return Scene(
        views=model.views,
        graphs=graphs,
        edge_views=edge_views_of(graphs, model.views, num_kept_of(graphs)),
        neighbors=near.neighbors,
        witnesses=near.witnesses,
        polyline_offsets=offsets,
        covered=nothing_covered(offsets),
        whole=graphs,
    )


def nothing_covered(offsets: Sequence[IntArray]) -> list[BoolArray]:
    """Per view, by the offsets of its polylines, its points, none of them marked."""
    return [np.zeros(bounds[-1], bool) for bounds in offsets]


def what_remains(whole: Scene, kept: Sorted, options: TracingOptions) -> Scene:
    """The scene of those stretches of chains that no edge runs through.

    Outlines take nothing: moving over a body they cross chains of edges beside it.
    """
    covered = nothing_covered(whole.polyline_offsets)
    for traced in kept.edges:
        mark_covered(
            covered,
            whole.polyline_offsets,
            traced.views,
            traced.positions,
            options.point_spacing_px,
        )
    least = options.min_curve_points * options.point_spacing_px // 2
    free = [
        without_short(~each, bounds, least)
        for each, bounds in zip(covered, whole.polyline_offsets, strict=True)
    ]
    num_kept = num_kept_of(whole.graphs)
    graphs = Recent(RemainingGraphs(whole.graphs, free).__getitem__, len(free), num_kept)
    offsets = [graph.polyline_offsets for graph in graphs]
    return replace(
        whole,
        graphs=graphs,
        edge_views=edge_views_of(graphs, whole.views, num_kept),
        polyline_offsets=offsets,
        covered=nothing_covered(offsets),
        free=free,
    )


def without_repeats(
    whole: Scene, kept: Sorted, options: TracingOptions
) -> tuple[Sorted, dict[str, int]]:
    """The same with each stretch of a chain in one outline, its first, and counts.

    Outlines take nothing of what remains, so that other views find them again.
    """
    covered = nothing_covered(whole.polyline_offsets)
    firsts = []
    for outlines in kept.outlines:
        own = outlines.positions[:, [0]]  # on the driver's chains, unless something hides it there
        free = np.ones(len(outlines.points), bool)
        free[owners_of(own.indptr)] = ~covered[outlines.views[0]][own.data.astype(np.int64)]
        pieces, lasting = find_pieces(outlines, free, np.inf, options)
        first = chosen(outlines, pieces, free & lasting[pieces])
        mark_covered(
            covered,
            whole.polyline_offsets,
            first.views,
            first.positions,
            options.point_spacing_px,
        )
        firsts.append(first)
    left, all_found = (sum(len(t.points) for t in of) for of in (firsts, kept.outlines))
    counts = {"points_of_outlines": left, "points_dropped_repeated": all_found - left}
    return replace(kept, outlines=firsts), counts


def in_whole_graphs(scene: Scene, traced: list[Traced]) -> list[Traced]:
    """Curves at positions on the scene's graphs -> the same at positions on the whole graphs."""
    if scene.free is None:
        return traced
    points = [np.flatnonzero(free) for free in scene.free]
    return [
        replace(each, positions=positions_among_all(each.positions, each.views, points))
        for each in traced
    ]


def mark_covered(
    covered: Sequence[BoolArray],
    offsets: Sequence[IntArray],
    views: IntArray,
    positions: csr_array,
    reach: int,
) -> None:
    """Mark the stretches of chains that points of curves are observed on, in every view.

    Args:
        covered: per view its points, to be marked.
        offsets: per view those of its polylines.
        views: (K,) view of each column of `positions`.
        positions: (N, K) sparse positions on the views' chains.
        reach: points to both sides of an observation.
    """
    observed = positions.tocsc()
    for column, view in enumerate(views):
        first, last = observed.indptr[column : column + 2]
        at = observed.data[first:last].astype(np.int64)
        polyline = np.searchsorted(offsets[view], at, "right") - 1
        low = np.maximum(at - reach, offsets[view][polyline])
        high = np.minimum(at + reach + 1, offsets[view][polyline + 1])
        covered[view][ranges_of(low, high)] = True


def without_short(free: BoolArray, offsets: IntArray, least: int) -> BoolArray:
    """(N,) the points of `free` in runs of at least so many along one polyline."""
    begins = np.zeros(len(free), np.int64)
    begins[1:] = (np.diff(owners_of(offsets)) != 0) | (free[1:] != free[:-1])
    runs = np.cumsum(begins)
    kept: BoolArray = free & (np.bincount(runs)[runs] >= least)
    return kept


def positions_among_all(
    positions: csr_array, views: IntArray, points: Sequence[IntArray]
) -> csr_array:
    """Positions counted among some points of each view -> the same counted among all of them.

    Args:
        positions: (N, K) sparse.
        views: (K,) view of each column.
        points: per view the places of those some, ascending.
    """
    data = positions.data.copy()
    for column, view in enumerate(views):
        rows = positions.indices == column
        low = data[rows].astype(np.int64)
        data[rows] += points[view][low] - low
    return csr_array((data, positions.indices, positions.indptr), shape=positions.shape)


def num_kept_of(graphs: Sequence[EdgeGraph]) -> int:
    """How many graphs are held in memory at a time."""
    return max(graphs.num_kept, 1) if isinstance(graphs, GraphStore) else len(graphs)


def edge_views_of(graphs: Sequence[EdgeGraph], views: Sequence[View], num_kept: int) -> Recent[Any]:
    """The kernels' forms of the edge graphs, made when asked for."""
    return Recent(partial(edge_view_of, graphs, views), len(graphs), num_kept)


def edge_view_of(graphs: Sequence[EdgeGraph], views: Sequence[View], view: int) -> Any:
    """The kernels' form of one view's edge graph."""
    return make_edge_view(graphs[view], views[view])
