"""2D edge graphs -> 3D edges: depths along chains, checked, joined to curves and refined.

Views drive in turn. What a driver's curves cover in the other views is marked, so that each edge
of the scene is traced once, by the view that sees it best (paper: 3D edge reconstruction).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from colmap_edges.graph_store import GraphStore, Recent
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.linking import link_edges
from colmap_edges.model import Model, View
from colmap_edges.options import PipelineOptions, TracingOptions
from colmap_edges.refinement import Curves, refine_curves
from colmap_edges.significance import chance_of_observations
from colmap_edges.view_selection import select_views

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
        positions: (N, K + 1) positions on the views' chains; NaN where not observed.
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
    positions: FloatArray


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a piece of a curve may have at most: residual in pixels, log10 of its chance."""

    residual_px: float
    log_chance: float


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What tracing looks at: the model with its edge graphs in both forms, and who sees what."""

    model: Model
    graphs: Sequence[EdgeGraph]
    edge_views: Sequence[_kernels.EdgeView]
    neighbors: tuple[IntArray, ...]
    witnesses: tuple[IntArray, ...]
    covered: list[BoolArray] = field(default_factory=list)


def trace_edges(
    model: Model,
    graphs: Sequence[EdgeGraph],
    options: PipelineOptions,
    num_threads: int,
    advance: Callable[[], None] = lambda: None,
) -> tuple[Edges3D, dict[str, Any]]:
    """Reconstruct the 3D edges of a model from the edge graphs of its views.

    Args:
        model: posed views and, where there are any, SfM points.
        graphs: the edge graph of each view.
        options: every step's parameters.
        num_threads: threads to use; the result does not depend on it.
        advance: called twice a view, when its depths are known and when its edges are.

    Returns:
        The 3D edges and counts in, kept and dropped by reason.
    """
    near = select_views(model, options.view_selection)
    num_kept = graphs.num_kept if isinstance(graphs, GraphStore) else len(graphs)
    edge_views = Recent(lambda v: make_edge_view(graphs[v], model.views[v]), len(graphs), num_kept)
    chain_depth = options.chain_depth
    if chain_depth.max_side_difference < 0:
        learned = learn_side_difference(
            near.neighbors, edge_views, graphs, near.ranges, chain_depth, num_threads
        )
        chain_depth = replace(chain_depth, max_side_difference=learned)
    depths = [
        compute_chain_depths(
            v,
            near.neighbors[v],
            edge_views,
            graphs[v],
            near.ranges[v],
            chain_depth,
            num_threads,
        )
        for v in each_told(range(len(graphs)), advance)
    ]
    agreeing = [
        count_agreeing_views(model.views, graphs, depths, v, options.tracing.max_cross_check_px)
        for v in range(len(graphs))
    ]
    depths = [without_supports(found) for found in depths]
    scene = Scene(
        model=model,
        graphs=graphs,
        edge_views=edge_views,
        neighbors=near.neighbors,
        witnesses=near.witnesses,
        covered=[np.zeros(len(graph.points), bool) for graph in graphs],
    )
    traced, in_runs = trace_views(scene, depths, agreeing, options, num_threads, advance)
    edges, stats = gather(scene, traced, options)
    stats["max_side_difference"] = chain_depth.max_side_difference
    return edges, count_samples(scene, depths, agreeing, in_runs) | stats


def trace_views(
    scene: Scene,
    depths: list[ChainDepths],
    agreeing: list[NDArray[np.int32]],
    options: PipelineOptions,
    num_threads: int,
    advance: Callable[[], None],
) -> tuple[list[Traced], int]:
    """Curves of every view on what those before it left, the best view first.

    Returns:
        The curves of each view that has any, and how many samples are in sure runs.
    """
    traced, in_runs = [], 0
    views = scene.model.views
    worths = [worth_of(*of) for of in zip(views, depths, agreeing, strict=True)]
    order = np.argsort([-worth for worth in worths], kind="stable")
    for view in each_told(order, advance):
        driver = int(view)
        curves, indices, sure = curves_of_view(
            scene, driver, depths[driver], agreeing[driver], options.tracing
        )
        in_runs += sure
        if len(indices) == 0:
            continue
        traced.append(trace_view(scene, driver, curves, indices, options, num_threads))
        mark_covered(scene, traced[-1], options.tracing)
    return traced, in_runs


def worth_of(view: View, depths: ChainDepths, agreeing: NDArray[np.int32]) -> float:
    """How much a view sees, how near and how surely: its agreeing samples by their resolution."""
    return float(view.focal_px * (depths.inverse_depths @ agreeing))


def without_supports(depths: ChainDepths) -> ChainDepths:
    """The depths without the places that agree, most of their memory; how many remains known."""
    return replace(
        depths, support_views=np.zeros(0, np.int32), support_positions=np.zeros(0, np.float64)
    )


def each_told(items: Iterable[Any], advance: Callable[[], None]) -> Iterator[Any]:
    """The items; `advance` is called when each is done with."""
    for item in items:
        yield item
        advance()


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
    driver = scene.model.views[view]
    views = [scene.model.views[w] for w in witnesses]
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
        positions=np.column_stack([indices.astype(np.float64), refined.positions[:, seeing]]),
    )


def mark_covered(scene: Scene, traced: Traced, options: TracingOptions) -> None:
    """Mark the stretches of chains that curves are observed on, in every view.

    A point with too few observations will not last, so it covers nothing.
    """
    lasting = np.isfinite(traced.positions).sum(axis=1) >= options.min_observations
    for column, view in enumerate(traced.views):
        positions = traced.positions[lasting, column]
        at = positions[np.isfinite(positions)].astype(np.int64)
        graph = scene.graphs[view]
        polyline = graph.polyline_ids[at]
        reach = options.point_spacing_px
        low = np.maximum(at - reach, graph.polyline_offsets[polyline])
        high = np.minimum(at + reach + 1, graph.polyline_offsets[polyline + 1])
        lengths = high - low
        first = np.repeat(low - np.cumsum(lengths) + lengths, lengths)
        scene.covered[view][first + np.arange(len(first))] = True


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
    counts = [np.isfinite(t.positions).sum(axis=1) for t in traced]
    every = np.concatenate([np.zeros(0, int), *counts])
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
    points, sigmas, lengths, track_lengths, track_views, track_points = [], [], [], [], [], []
    for part in parts:
        seen = np.isfinite(part.positions)
        rows, columns = np.nonzero(seen)
        pixels = np.zeros((len(rows), 2))
        for column, view in enumerate(part.views):
            chosen = columns == column
            pixels[chosen] = image_points(scene.graphs[view], part.positions[rows[chosen], column])
        points.append(part.points)
        sigmas.append(part.sigmas)
        lengths.append(np.diff(part.offsets))
        track_lengths.append(seen.sum(axis=1))
        track_views.append(part.views[columns])
        track_points.append(pixels)
    num_edges = int(sum(len(length) for length in lengths))
    return Edges3D(
        points=np.concatenate([np.zeros((0, 3)), *points]),
        edge_offsets=offsets_of(np.concatenate([np.zeros(0, np.int64), *lengths])),
        closed=np.zeros(num_edges, bool),
        track_offsets=offsets_of(np.concatenate([np.zeros(0, np.int64), *track_lengths])),
        track_views=np.concatenate([np.zeros(0, np.int64), *track_views]).astype(np.int32),
        track_points2D=np.concatenate([np.zeros((0, 2)), *track_points]),
        sigmas=np.concatenate([np.zeros(0), *sigmas]),
        end_nodes=np.full((num_edges, 2), -1, np.int32),
    )


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
