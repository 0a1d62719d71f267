"""2D edge graphs -> 3D edges: depths along chains, checked, joined to curves and refined.

Views drive in turn. What a driver's curves cover in the other views is marked, so that each edge
of the scene is traced once, by the view that sees it best (paper: 3D edge reconstruction).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from colmap_edges.chain_depths import (
    ChainDepths,
    compute_chain_depths,
    learn_side_difference,
    make_edge_view,
)
from colmap_edges.cross_check import count_agreeing_views, lift
from colmap_edges.csr import offsets_of, owners_of
from colmap_edges.edge_graph import EdgeGraph
from colmap_edges.edges import Edges3D
from colmap_edges.executors import Call, Workers, local_workers, run_all, run_scheduled
from colmap_edges.graph_store import GraphStore, Recent
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.linking import link_edges
from colmap_edges.model import Model, View, rows_by_view
from colmap_edges.occlusion import find_hidden
from colmap_edges.options import ChainDepthOptions, PipelineOptions, TracingOptions
from colmap_edges.refinement import Curves, refine_curves
from colmap_edges.scheduling import Schedule, local_order
from colmap_edges.significance import chance_of_observations
from colmap_edges.view_graphs import NUM_KEPT, CachedEdgeViews, CachedGraphs, Some
from colmap_edges.view_selection import DepthRange, Neighborhood, select_views

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

TESTS_PER_CURVE = 30  # depths that a chain could have had
MIN_RESIDUAL_PX = 0.15  # no real edge scatters less, however clean the scene
INDEPENDENT_PX = 16  # distance along a chain at which observations are evidence of their own


@dataclass(frozen=True, kw_only=True)
class Traced:
    """Curves of one driver with their observations.

    Attributes:
        points: (N, 3) world points.
        sigmas: (N,) standard deviation along the driver's ray, world units.
        offsets: (E + 1,) CSR of the points by curve.
        views: (K + 1,) view of each column of `positions`, the driver first.
        positions: (N, K + 1) sparse positions on the views' chains, where they are observed.
        uncertainties: (N,) the same standard deviation in pixels of the driver.
        residuals: (N,) median distance to the chains that observe it, in pixels.
        log_chances: (N,) log10 of the chance of as many observations.
    """

    points: FloatArray
    sigmas: FloatArray
    uncertainties: FloatArray
    residuals: FloatArray
    log_chances: FloatArray
    offsets: IntArray
    views: IntArray
    positions: csr_array

    @property
    def num_observations(self) -> IntArray:
        """(N,) number of observations of each point."""
        return np.asarray(np.diff(self.positions.indptr), np.int64)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a piece of a curve may have at most: residual in pixels, log10 of its chance."""

    residual_px: float
    log_chance: float


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
    """

    views: Sequence[View]
    graphs: Sequence[EdgeGraph]
    edge_views: Sequence[_kernels.EdgeView]
    neighbors: Sequence[IntArray]
    witnesses: Sequence[IntArray]
    polyline_offsets: Sequence[IntArray]
    covered: Sequence[BoolArray]

    def part(self, view: int, others: IntArray, workers: Workers) -> Scene:
        """What a task on a view and others needs: all, or what a worker elsewhere is sent."""
        if not (workers.remote and workers.cache and isinstance(self.graphs, GraphStore)):
            return self
        keys = Some(self.graphs.keys, [view, *others])
        views = Some(self.views, [view, *others])
        return Scene(
            views=views,
            graphs=CachedGraphs(workers.cache, keys),
            edge_views=CachedEdgeViews(workers.cache, keys, views),
            neighbors=Some(self.neighbors, [view]),
            witnesses=Some(self.witnesses, [view]),
            polyline_offsets=Some(self.polyline_offsets, []),
            covered=Some(self.covered, [view]),
        )


def trace_edges(
    model: Model,
    graphs: Sequence[EdgeGraph],
    options: PipelineOptions,
    num_threads: int,
    advance: Callable[[], None] = lambda: None,
    workers: Workers | None = None,
) -> tuple[Edges3D, dict[str, Any]]:
    """Reconstruct the 3D edges of a model from the edge graphs of its views.

    Args:
        model: posed views and, where there are any, SfM points.
        graphs: the edge graph of each view.
        options: every step's parameters.
        num_threads: threads to use; the result does not depend on it.
        advance: called twice a view, when its depths are known and when its edges are.
        workers: who does the work on the views; threads of this process when not given.

    Returns:
        The 3D edges and counts in, kept and dropped by reason.
    """
    if workers is None:
        with local_workers(num_threads) as workers:
            return trace_edges(model, graphs, options, num_threads, advance, workers)
    near = select_views(model, options.view_selection)
    scene = make_scene(model, graphs, near)
    chain_depth = options.chain_depth
    if chain_depth.max_side_difference < 0:
        learned = learn_side_difference(
            near.neighbors, scene.edge_views, graphs, near.ranges, chain_depth, num_threads
        )
        chain_depth = replace(chain_depth, max_side_difference=learned)
    order = local_order(near.neighbors)
    depths = find_depths(scene, near, order, chain_depth, workers, advance)
    agreeing = {
        v: count_agreeing_views(model.views, graphs, depths, v, options.tracing.max_cross_check_px)
        for v in order.tolist()
    }
    counts = [agreeing[v] for v in range(len(graphs))]
    depths = [without_supports(found) for found in depths]
    traced, in_runs = trace_views(scene, depths, counts, options, workers, advance)
    traced, hidden = without_hidden(model, traced, options.tracing, num_threads)
    edges, stats = gather(scene, traced, options)
    stats["observations_hidden"] = hidden
    stats["max_side_difference"] = chain_depth.max_side_difference
    return edges, count_samples(scene, depths, counts, in_runs) | stats


def make_scene(model: Model, graphs: Sequence[EdgeGraph], near: Neighborhood) -> Scene:
    """What tracing looks at, nothing covered yet; as many edge views are kept as graphs."""
    num_kept = max(graphs.num_kept, 1) if isinstance(graphs, GraphStore) else len(graphs)
    make = partial(edge_view_of, graphs, model.views)
    offsets = [graph.polyline_offsets for graph in graphs]
    return Scene(
        views=model.views,
        graphs=graphs,
        edge_views=Recent(make, len(graphs), num_kept),
        neighbors=near.neighbors,
        witnesses=near.witnesses,
        polyline_offsets=offsets,
        covered=[np.zeros(bounds[-1], bool) for bounds in offsets],
    )


def edge_view_of(graphs: Sequence[EdgeGraph], views: Sequence[View], view: int) -> Any:
    """The kernels' form of one view's edge graph."""
    return make_edge_view(graphs[view], views[view])


def find_depths(
    scene: Scene,
    near: Neighborhood,
    order: IntArray,
    options: ChainDepthOptions,
    workers: Workers,
    advance: Callable[[], None],
) -> list[ChainDepths]:
    """Depths along the chains of every view, worked on in the given order."""

    def calls() -> Iterator[Call]:
        for view in order.tolist():
            part = scene.part(view, near.neighbors[view], workers)
            depth_range, threads = near.ranges[view], workers.threads_per_view
            yield depths_of_view, (part, view, depth_range, options, threads)

    found = run_all(workers.views, calls(), advance)
    return [found[place] for place in np.argsort(order)]


def depths_of_view(
    scene: Scene,
    view: int,
    depth_range: DepthRange,
    options: ChainDepthOptions,
    num_threads: int,
) -> ChainDepths:
    """Depths along the chains of one view, by its neighbours."""
    return compute_chain_depths(
        view,
        scene.neighbors[view],
        scene.edge_views,
        scene.graphs[view],
        depth_range,
        options,
        num_threads,
    )


def trace_views(
    scene: Scene,
    depths: list[ChainDepths],
    agreeing: list[NDArray[np.int32]],
    options: PipelineOptions,
    workers: Workers,
    advance: Callable[[], None],
) -> tuple[list[Traced], int]:
    """Curves of every view on what those before it left, the best view first.

    Views that have no witness in common do not wait for each other.

    Returns:
        The curves of each view that has any, and how many samples are in sure runs.
    """
    views = scene.views
    worths = [worth_of(*of) for of in zip(views, depths, agreeing, strict=True)]
    order = np.argsort([-worth for worth in worths], kind="stable")
    traced: dict[int, Traced] = {}
    in_runs = np.zeros(len(order), np.int64)

    def call(view: int) -> Call:
        part = scene.part(view, scene.witnesses[view], workers)
        found, threads = (depths[view], agreeing[view]), workers.threads_per_view
        return curves_traced, (part, view, *found, options, threads)

    def finish(view: int, result: tuple[Traced | None, int]) -> None:
        found, in_runs[view] = result
        if found is not None:
            traced[view] = found
            mark_covered(scene, found, options.tracing)
        advance()

    num_kept = scene.edge_views.num_kept if isinstance(scene.edge_views, Recent) else len(order)
    schedule = Schedule(order, scene.witnesses, NUM_KEPT if workers.remote else num_kept)
    run_scheduled(workers, schedule, call, finish)
    return [traced[view] for view in order.tolist() if view in traced], int(in_runs.sum())


def curves_traced(
    scene: Scene,
    view: int,
    depths: ChainDepths,
    agreeing: NDArray[np.int32],
    options: PipelineOptions,
    num_threads: int,
) -> tuple[Traced | None, int]:
    """Curves of one view on what is not covered yet, refined and observed; None without any.

    Returns:
        The curves, and how many samples are in sure runs.
    """
    curves, indices, in_runs = curves_of_view(scene, view, depths, agreeing, options.tracing)
    if len(indices) == 0:
        return None, in_runs
    return trace_view(scene, view, curves, indices, options, num_threads), in_runs


def worth_of(view: View, depths: ChainDepths, agreeing: NDArray[np.int32]) -> float:
    """How much a view sees, how near and how surely: its agreeing samples by their resolution."""
    return float(view.focal_px * (depths.inverse_depths @ agreeing))


def without_supports(depths: ChainDepths) -> ChainDepths:
    """The depths without the places that agree, most of their memory; how many remains known."""
    return replace(
        depths, support_views=np.zeros(0, np.int32), support_positions=np.zeros(0, np.float64)
    )


def count_samples(
    scene: Scene,
    depths: list[ChainDepths],
    agreeing: list[NDArray[np.int32]],
    in_runs: int,
) -> dict[str, Any]:
    """Count the samples on chains after each check, and the views that overlap with none."""
    return {
        "views": len(depths),
        "views_without_neighbors": sum(len(n) == 0 for n in scene.neighbors),
        "samples": sum(len(d.samples) for d in depths),
        "samples_with_depth": int(sum(d.found.sum() for d in depths)),
        "samples_confirmed": int(sum((a >= 1).sum() for a in agreeing)),
        "samples_in_runs": in_runs,
    }


def curves_of_view(
    scene: Scene,
    view: int,
    depths: ChainDepths,
    agreeing: NDArray[np.int32],
    options: TracingOptions,
) -> tuple[Curves, IntArray, int]:
    """Curves on the chains of one view that are not covered yet.

    Returns:
        The curves, (N,) the points of the graph that they run through, and how many samples are
        in sure runs.
    """
    graph = scene.graphs[view]
    rows = np.flatnonzero(depths.found & (agreeing >= 1))
    sizes, sure = sure_runs(link_samples(graph, depths, rows, options), agreeing[rows], options)
    indices, inverse, runs = densify(graph, depths, rows, sizes, sure, options)
    free = ~scene.covered[view][indices]
    indices, inverse, runs = indices[free], inverse[free], runs[free]
    # A covered stretch ends a curve as the end of its run does.
    broken = np.ones(len(indices), bool)
    broken[1:] = (np.diff(runs) != 0) | (np.diff(indices) > options.point_spacing_px)
    ids = np.cumsum(broken) - 1
    long = np.bincount(ids, minlength=1)[ids] >= options.min_curve_points
    indices, inverse, ids = indices[long], inverse[long], ids[long]
    lengths = np.unique(ids, return_counts=True)[1]
    tangent = _kernels.chain_points(scene.edge_views[view], indices.astype(np.float64))[1]
    normal = graph.normals[indices]
    sides = np.where(tangent[:, 0] * normal[:, 1] - tangent[:, 1] * normal[:, 0] >= 0, 1, -1)
    curves = Curves(
        ideal=graph.ideal[indices],
        inverse_depths=inverse,
        offsets=offsets_of(lengths),
        sides=sides.astype(np.int8),
    )
    return curves, indices, int(sizes[sure].sum())


def link_samples(
    graph: EdgeGraph, depths: ChainDepths, rows: IntArray, options: TracingOptions
) -> BoolArray:
    """(n - 1,) whether sample rows[i] and rows[i + 1] belong to one curve.

    They do when depth changes between them by less than a pixel of disparity a pixel of chain,
    and no sample is missing, or at least two other views see both on one chain.
    """
    if len(rows) < 2:
        return np.zeros(0, bool)
    left, right = rows[:-1], rows[1:]
    polylines = graph.polyline_ids[depths.samples[rows]]
    steps = depths.samples[right] - depths.samples[left]
    counts = np.diff(depths.support_offsets)
    sigma = np.maximum(depths.sigmas[left], depths.sigmas[right]) * np.sqrt(counts[left])
    change = np.abs(depths.inverse_depths[right] - depths.inverse_depths[left])
    smooth = change <= options.max_disparity_gradient * steps * sigma
    bridged = steps <= options.max_bridge_px
    linked: BoolArray = (polylines[1:] == polylines[:-1]) & smooth
    linked &= (right - left == 1) | bridged
    return linked


def densify(
    graph: EdgeGraph,
    depths: ChainDepths,
    rows: IntArray,
    sizes: IntArray,
    sure: BoolArray,
    options: TracingOptions,
) -> tuple[IntArray, FloatArray, IntArray]:
    """Points along the sure runs of samples, inverse depths linear between samples.

    Args:
        graph: of the view.
        depths: of its samples.
        rows: (n,) the samples of all runs, one run after the other.
        sizes: (R,) samples of each run.
        sure: (R,) whether the run is.
        options: spacing of the points, and how far they go beyond a run's ends.

    Returns:
        (N,) points of the graph, (N,) inverse depths, (N,) run of each.
    """
    spacing = options.point_spacing_px
    indices, inverse, ids = [], [], []
    starts = offsets_of(sizes)
    for run in np.flatnonzero(sure):
        at = rows[starts[run] : starts[run + 1]]
        polyline = graph.polyline_ids[depths.samples[at[0]]]
        low = max(depths.samples[at[0]] - options.extension_px, graph.polyline_offsets[polyline])
        high = min(
            depths.samples[at[-1]] + options.extension_px, graph.polyline_offsets[polyline + 1] - 1
        )
        points = np.arange(low, high + 1, spacing)
        indices.append(points)
        inverse.append(extrapolate(points, depths.samples[at], depths.inverse_depths[at]))
        ids.append(np.full(len(points), run))
    if not indices:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64)
    return np.concatenate(indices), np.concatenate(inverse), np.concatenate(ids)


def sure_runs(
    linked: BoolArray, agreeing: NDArray[np.int32], options: TracingOptions
) -> tuple[IntArray, BoolArray]:
    """Runs of linked samples that are long enough and confirmed by enough views.

    Args:
        linked: (n - 1,) whether a sample belongs with the one before.
        agreeing: (n,) views that confirm each sample.
        options: gives how many samples and views are enough.

    Returns:
        (R,) samples of each run, (R,) whether the run is kept.
    """
    if len(agreeing) == 0:
        return np.zeros(0, np.int64), np.zeros(0, bool)
    runs = np.concatenate([[0], np.cumsum(~linked)])
    sizes = np.bincount(runs)
    sure = np.bincount(runs, weights=agreeing >= options.min_agreeing_views)
    kept = (sizes >= options.min_run_samples) & (sure >= options.min_confirmed_ratio * sizes)
    return sizes, kept


def extrapolate(at: IntArray, known: IntArray, values: FloatArray) -> FloatArray:
    """Values at `at`, linear between the known places and beyond the first and last two."""
    result = np.interp(at, known, values)
    before, after = at < known[0], at > known[-1]
    first = (values[1] - values[0]) / (known[1] - known[0])
    last = (values[-1] - values[-2]) / (known[-1] - known[-2])
    result[before] = values[0] + first * (at[before] - known[0])
    result[after] = values[-1] + last * (at[after] - known[-1])
    if (result > 0).all():
        return np.asarray(result, np.float64)
    return np.where(result > 0, result, np.interp(at, known, values))


def trace_view(
    scene: Scene,
    view: int,
    curves: Curves,
    indices: IntArray,
    options: PipelineOptions,
    num_threads: int,
) -> Traced:
    """Refine the curves of one driver and find their observations."""
    witnesses = scene.witnesses[view]
    driver = scene.views[view]
    views = [scene.views[w] for w in witnesses]
    edge_views = [scene.edge_views[w] for w in witnesses]
    refined = refine_curves(driver, curves, views, edge_views, options.refinement, num_threads)
    observed = np.isfinite(refined.positions).sum(axis=1)
    shift = np.where(observed > 0, refined.sigmas, 0) * np.sqrt(observed)
    log_chances = chance_of_observations(
        driver,
        refined.curves,
        refined.residuals,
        shift / options.refinement.noise_px,
        views,
        edge_views,
        options.refinement,
        num_threads,
    )
    inverse_depths = refined.curves.inverse_depths
    seeing = np.isfinite(refined.positions).any(axis=0)
    return Traced(
        points=lift(driver, refined.curves.ideal, inverse_depths),
        sigmas=refined.sigmas / inverse_depths**2,
        uncertainties=refined.sigmas / inverse_depths * driver.focal_px,
        residuals=row_medians(np.abs(refined.residuals)),
        log_chances=log_chances,
        offsets=refined.curves.offsets,
        views=np.concatenate([[view], witnesses[seeing]]),
        positions=sparse(np.column_stack([indices, refined.positions[:, seeing]])),
    )


def sparse(values: FloatArray) -> csr_array:
    """The values that are not NaN, of (N, M), zeros among them."""
    known = np.isfinite(values)
    columns = np.nonzero(known)[1].astype(np.int32)
    return csr_array((values[known], columns, offsets_of(known.sum(axis=1))), shape=values.shape)


def mark_covered(scene: Scene, traced: Traced, options: TracingOptions) -> None:
    """Mark the stretches of chains that curves are observed on, in every view.

    A point with too few observations will not last, so it covers nothing.
    """
    lasting = traced.num_observations >= options.min_observations
    observed = traced.positions[lasting].tocsc()
    for column, view in enumerate(traced.views):
        first, last = observed.indptr[column : column + 2]
        at = observed.data[first:last].astype(np.int64)
        offsets = scene.polyline_offsets[view]
        polyline = np.searchsorted(offsets, at, "right") - 1
        reach = options.point_spacing_px
        low = np.maximum(at - reach, offsets[polyline])
        high = np.minimum(at + reach + 1, offsets[polyline + 1])
        lengths = high - low
        first = np.repeat(low - np.cumsum(lengths) + lengths, lengths)
        scene.covered[view][first + np.arange(len(first))] = True


def without_hidden(
    model: Model, traced: list[Traced], options: TracingOptions, num_threads: int
) -> tuple[list[Traced], int]:
    """The curves without observations of points that nearer ones hide, and how many those are."""
    if not traced or options.occlusion_radius_px == 0:
        return traced, 0
    owners = [owners_of(t.positions.indptr) for t in traced]
    points = offsets_of(np.array([len(t.points) for t in traced]))
    curves = offsets_of(np.array([len(t.offsets) - 1 for t in traced]))
    hidden = find_hidden(
        model,
        np.concatenate([t.points for t in traced]),
        np.concatenate([t.sigmas for t in traced]),
        np.concatenate([owners_of(t.offsets) + curves[i] for i, t in enumerate(traced)]),
        np.concatenate([own + points[i] for i, own in enumerate(owners)]),
        np.concatenate([t.views[t.positions.indices] for t in traced]),
        options.occlusion_radius_px,
        num_threads,
    )
    parts = np.split(~hidden, np.cumsum([len(own) for own in owners])[:-1])
    kept = [observed_at(*of) for of in zip(traced, owners, parts, strict=True)]
    return kept, int(hidden.sum())


def observed_at(traced: Traced, owners: IntArray, keep: BoolArray) -> Traced:
    """The curves with those of their (T,) observations, of (T,) points, where `keep` is true."""
    positions = traced.positions
    counts = np.bincount(owners[keep], minlength=len(traced.points))
    rest = (positions.data[keep], positions.indices[keep], offsets_of(counts))
    return replace(traced, positions=csr_array(rest, shape=positions.shape))


def gather(
    scene: Scene, traced: list[Traced], options: PipelineOptions
) -> tuple[Edges3D, dict[str, Any]]:
    """Filter points and pieces, link what is left to edges and outlines, and count."""
    limits, sure, stats = find_limits(traced, options.tracing)
    fixed, moving, start = [], [], 0
    for each in traced:
        end = start + len(each.points)
        kept, scatters = sort_pieces(each, sure[start:end], limits, options.tracing)
        fixed.append(kept)
        moving.append(scatters)
        start = end
    pieces, outlines = make_edges(scene, fixed), make_edges(scene, moving)
    edges = link_edges(pieces, options.linking)
    if outlines.num_edges:
        edges = replace(edges, outlines=link_edges(outlines, options.linking))
    stats |= {
        "points_dropped_chance": int(sure.sum()) - pieces.num_points - outlines.num_points,
        "points_of_curves": pieces.num_points + outlines.num_points,
        "points_of_outlines": outlines.num_points,
        "pieces": pieces.num_edges,
        "edges_closed": int(edges.closed.sum()),
        "nodes": int(edges.end_nodes.max(initial=-1)) + 1,
    }
    return edges, stats


def find_limits(
    traced: list[Traced], options: TracingOptions
) -> tuple[Limits, BoolArray, dict[str, Any]]:
    """What pieces may have, by the scene's own medians, and which points are good.

    Args:
        traced: the curves of all drivers, N points together.
        options: how many observations are enough, and ratios to the medians.

    Returns:
        The limits of a piece; (N,) whether a point, in the order of `traced`, has observations
        enough and is certain enough; and counts of points in and dropped by reason.
    """
    every = np.concatenate([np.zeros(0, int), *(t.num_observations for t in traced)])
    enough = every >= options.min_observations
    uncertain = np.concatenate([np.zeros(0), *(t.uncertainties for t in traced)])
    sure = enough & (uncertain <= options.max_sigma_ratio * median_of(uncertain[enough]))
    scatter = np.concatenate([np.zeros(0), *(t.residuals for t in traced)])
    tests = TESTS_PER_CURVE * sum(len(t.offsets) - 1 for t in traced)
    limits = Limits(
        residual_px=max(MIN_RESIDUAL_PX, options.max_residual_ratio * median_of(scatter[sure])),
        log_chance=np.log10(options.max_false_edges / max(tests, 1)),
    )
    stats = {
        "points_traced": len(every),
        "points_observed_enough": int(enough.sum()),
        "points_dropped_few_observations": int((~enough).sum()),
        "points_dropped_uncertain": int((enough & ~sure).sum()),
    }
    return limits, sure, stats


def median_of(values: FloatArray) -> float:
    """The median; 0 of nothing."""
    return float(np.median(values)) if len(values) else 0.0


def row_medians(values: FloatArray) -> FloatArray:
    """(N,) median of the finite values in each row of (N, K), the lower of two; 0 of none."""
    count = np.isfinite(values).sum(axis=1)
    if values.shape[1] == 0:
        return np.zeros(len(values))
    middle = np.sort(values, axis=1)[np.arange(len(values)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, middle, 0.0)


def group_medians(values: FloatArray, groups: IntArray, count: int) -> FloatArray:
    """(count,) median of the (N,) values of each group, the lower of two; groups ascend."""
    ordered = values[np.lexsort((values, groups))]
    sizes = np.bincount(groups, minlength=count)
    medians: FloatArray = ordered[np.cumsum(sizes) - sizes + np.maximum(sizes - 1, 0) // 2]
    return medians


def sort_pieces(
    traced: Traced, keep: BoolArray, limits: Limits, options: TracingOptions
) -> tuple[Traced, Traced]:
    """Split curves where points are dropped; short pieces and those that chance makes go with them.

    Returns:
        The pieces that are edges, and those that scatter around any fixed curve: what moves over a
        body from view to view, as its outline and reflections do.
    """
    ids = owners_of(traced.offsets)
    broken = np.ones(len(ids), bool)
    broken[1:] = (np.diff(ids) != 0) | (keep[1:] != keep[:-1])
    pieces = np.cumsum(broken) - 1
    sizes = np.bincount(pieces) if len(pieces) else np.zeros(0, np.int64)
    # Points nearer to each other than that are not independent evidence.
    share = min(1.0, options.point_spacing_px / INDEPENDENT_PX)
    logs = share * np.bincount(pieces, weights=traced.log_chances, minlength=len(sizes))
    good = (sizes >= options.min_curve_points) & (logs <= limits.log_chance)
    fixed = group_medians(traced.residuals, pieces, len(sizes)) <= limits.residual_px
    return (
        chosen(traced, pieces, keep & (good & fixed)[pieces]),
        chosen(traced, pieces, keep & (good & ~fixed)[pieces]),
    )


def chosen(traced: Traced, pieces: IntArray, keep: BoolArray) -> Traced:
    """The points where `keep` is true, as curves of their (N,) pieces."""
    lengths = np.unique(pieces[keep], return_counts=True)[1]
    return Traced(
        points=traced.points[keep],
        sigmas=traced.sigmas[keep],
        uncertainties=traced.uncertainties[keep],
        residuals=traced.residuals[keep],
        log_chances=traced.log_chances[keep],
        offsets=offsets_of(lengths),
        views=traced.views,
        positions=traced.positions[keep],
    )


def make_edges(scene: Scene, parts: list[Traced]) -> Edges3D:
    """Put the curves of all drivers together as 3D edges with tracks."""
    points, sigmas, lengths, track_lengths, track_views, positions = [], [], [], [], [], []
    for part in parts:
        points.append(part.points)
        sigmas.append(part.sigmas)
        lengths.append(np.diff(part.offsets))
        track_lengths.append(part.num_observations)
        track_views.append(part.views[part.positions.indices])
        positions.append(part.positions.data)
    views = np.concatenate([np.zeros(0, np.int64), *track_views]).astype(np.int32)
    num_edges = int(sum(len(length) for length in lengths))
    return Edges3D(
        points=np.concatenate([np.zeros((0, 3)), *points]),
        edge_offsets=offsets_of(np.concatenate([np.zeros(0, np.int64), *lengths])),
        closed=np.zeros(num_edges, bool),
        track_offsets=offsets_of(np.concatenate([np.zeros(0, np.int64), *track_lengths])),
        track_views=views,
        track_points2D=observed_pixels(scene, views, np.concatenate([np.zeros(0), *positions])),
        sigmas=np.concatenate([np.zeros(0), *sigmas]),
        end_nodes=np.full((num_edges, 2), -1, np.int32),
    )


def observed_pixels(
    scene: Scene, track_views: NDArray[np.int32], positions: FloatArray
) -> FloatArray:
    """(T, 2) image pixels of observations at (T,) positions on the chains of (T,) views."""
    pixels = np.zeros((len(positions), 2))
    for view, rows in enumerate(rows_by_view(track_views, len(scene.views))):
        if len(rows):
            pixels[rows] = image_points(scene.graphs[view], positions[rows])
    return pixels


def image_points(graph: EdgeGraph, positions: FloatArray) -> FloatArray:
    """(N, 2) image pixels at fractional positions on the chains of a graph."""
    low = positions.astype(np.int64)
    polyline = graph.polyline_ids[low]
    last = graph.polyline_offsets[polyline + 1] - 1
    wrapped = np.where(graph.closed[polyline], graph.polyline_offsets[polyline], last)
    high = np.where(low < last, low + 1, wrapped)
    weight = (positions - low)[:, None]
    points: FloatArray = (1 - weight) * graph.points[low] + weight * graph.points[high]
    return points
