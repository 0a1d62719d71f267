"""Tracing of 3D edges: depths along chains, cross-checked, joined to curves and refined.

Each view in turn is the reference view. Stretches of chains in other views that observe its curves
are marked, so that each edge is traced once, in the view that sees it best (paper: 3D edge
reconstruction). Poses are refined on the edges; if they move, the rounds of tracing are repeated
along the depths of the first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.thinning import thinned
from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.arrays import BoolArray, Int32Array
from colmap_edges.core.edges3d import AS_GIVEN, Edges3D, TracedEdges
from colmap_edges.core.view import View, lift
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.chains.a_contrario import chance_of_observations
from colmap_edges.edges3d.chains.assembly import link, make_edges, merged_pieces, with_look_up
from colmap_edges.edges3d.chains.coverage import (
    in_whole_graphs,
    mark_covered,
    nothing_covered,
    what_remains,
    without_repeats,
)
from colmap_edges.edges3d.chains.curve_extraction import find_curves
from colmap_edges.edges3d.chains.curves import Curves
from colmap_edges.edges3d.chains.depth_consistency import count_agreeing_views
from colmap_edges.edges3d.chains.depths import (
    ChainDepths,
    compute_chain_depths,
    learn_side_likelihoods,
)
from colmap_edges.edges3d.chains.envelopes import Envelopes, find_envelopes, seen_outlines
from colmap_edges.edges3d.chains.filtering import (
    FilteredCurves,
    Limits,
    filter_curves,
    lasting_points,
)
from colmap_edges.edges3d.chains.refinement import refine_curves, with_reference
from colmap_edges.edges3d.chains.traced_curves import TracedCurves, TracedObservations
from colmap_edges.edges3d.chains.tracing_input import TracingInput, make_input
from colmap_edges.edges3d.chains.view_selection import Neighborhood, select_views
from colmap_edges.options import BundleAdjustmentOptions, PipelineOptions, of_later_rounds
from colmap_edges.poses.refine import refine_poses
from colmap_edges.runtime.executors import (
    Call,
    Workers,
    in_threads,
    open_workers,
    run_all,
    run_scheduled,
    thread_count,
)
from colmap_edges.runtime.scheduling import Schedule, local_order


def trace_edges(
    model: Model,
    graphs: Graphs,
    options: PipelineOptions,
    workers: Workers | None = None,
) -> tuple[TracedEdges, dict[str, Any]]:
    """Reconstruct the 3D edges of a model from the edge graphs of its views.

    Args:
        model: posed views and optional SfM points.
        graphs: the edge graph of each view.
        options: settings of every step, as `resolved` for the model's scale.
        workers: executor of the work on views, which advances twice per view and round: after its
            depths and after its edges; by default threads of this process.

    Returns:
        The 3D edges with the view-dependent contours, and counts in, kept and dropped by reason.
    """
    if workers is None:
        with open_workers(options) as workers:
            return trace_edges(model, graphs, options, workers)
    few = thinned(model, options.random_seed)
    near = select_views(few, options.view_selection)
    whole = with_side_likelihoods(make_input(few, graphs, near), near, options)
    num_threads = thread_count(options)
    pieces, outlines, few, whole, stats = trace_pieces(model, few, whole, near, options, workers)
    graphs.trim()
    result, linked = link(whole, pieces, options, num_threads)
    seen = seen_outlines(outlines, result.edges, few, near.observing_views, options, num_threads)
    about = {
        "views": len(model.views),
        "views_without_neighbors": sum(len(n) == 0 for n in near.neighbors),
    }
    return replace(result, outlines=seen, poses=pieces.poses), about | stats | linked


def with_side_likelihoods(
    given: TracingInput, near: Neighborhood, options: PipelineOptions
) -> TracingInput:
    """The same input with side likelihoods learned from its views."""
    learned = learn_side_likelihoods(
        given, near.ranges, options.chain_depth, options.random_seed, thread_count(options)
    )
    return replace(given, sides=learned)


def trace_pieces(
    model: Model,
    few: Model,
    whole: TracingInput,
    near: Neighborhood,
    options: PipelineOptions,
    workers: Workers,
) -> tuple[TracedEdges, Envelopes, Model, TracingInput, dict[str, Any]]:
    """The pieces of all rounds without duplicates, and the outlines of smooth bodies.

    Poses are refined on the edges as soon as these are enough. If they move, the rounds are
    repeated; the depths of the first one remain, since curves are refined along them. Tables are
    released on return.

    Args:
        model: the views and all SfM points, which are refined with the poses.
        few: the same with the SfM points that tracing uses.
        whole: the views with their whole edge graphs.
        near: the selected views.
        options: settings of every step.
        workers: executor of the work on views.

    Returns:
        The pieces, the outlines, `few` and `whole` with refined poses, and counts.
    """
    num_threads, adjustment = thread_count(options), options.bundle_adjustment
    depths = find_depths(whole, near, options, workers)
    rounds = trace_rounds(few, whole, depths, near, options, workers)
    for last in rounds:
        if options.refine_poses and are_enough(last[0], len(model.views), adjustment):
            break
    poses = AS_GIVEN
    refined: dict[str, Any] = {}
    if options.refine_poses:
        edges = make_edges(last[0].edges)
        edges = with_look_up(whole, edges, Edges3D.none(), num_threads).edges
        whole.indexes.clear()
        whole.graphs.trim()
        poses, refined = refine_poses(model, edges, adjustment, num_threads, options.random_seed)
        if len(poses.motions):
            few = thinned(moved_model(model, poses), options.random_seed)
            whole = replace(whole, views=few.views)
            whole.graphs.trim()
            rounds = trace_rounds(few, whole, depths, near, options, workers)
    for last in rounds:  # noqa: B007, one by one: no tables of a round outlast the next one
        pass
    kept, stats = last
    rest = replace(what_remains(whole, kept, options.tracing), neighbors=near.later_neighbors)
    outlines = find_envelopes(rest, near, options.chain_depth, workers)
    kept, repeated = without_repeats(whole, kept, options.tracing)
    whole.graphs.trim()
    pieces, merged = merged_pieces(whole, kept, options, num_threads)
    pieces = replace(pieces, poses=poses)
    counts = {"points_of_outlines": len(outlines.points)}
    return pieces, outlines, few, whole, stats | {"poses": refined} | counts | repeated | merged


def trace_rounds(
    model: Model,
    whole: TracingInput,
    depths: Depths,
    near: Neighborhood,
    options: PipelineOptions,
    workers: Workers,
) -> Iterator[tuple[FilteredCurves, dict[str, Any]]]:
    """After each round the filtered curves of all so far, and counts; the first has `depths`."""
    traced, stats = trace_views(whole, depths, options, None, workers)
    # Made again at the end in a hundredth of a round's time, they take half of its memory.
    whole.indexes.clear()
    whole.graphs.trim()
    num_threads = thread_count(options)
    kept, filter_stats = filter_curves(model, traced, options.tracing, num_threads)
    yield kept, stats | filter_stats
    # Limits come from the first round, whose curves are the most reliable.
    limits = kept.limits if traced else None
    whole = replace(whole, neighbors=near.later_neighbors)
    later = of_later_rounds(options)
    for _ in range(1, options.tracing.num_rounds):
        rest = what_remains(whole, kept, options.tracing)
        depths = find_depths(rest, near, later, workers)
        found, more = trace_views(rest, depths, later, limits, workers)
        traced += in_whole_graphs(rest, found)
        stats = {name: stats[name] + more[name] for name in stats}
        kept, filter_stats = filter_curves(model, traced, options.tracing, num_threads, limits)
        yield kept, stats | filter_stats


def are_enough(kept: FilteredCurves, num_views: int, options: BundleAdjustmentOptions) -> bool:
    """Whether most views observe as many edge points as poses are adjusted to."""
    counts = np.zeros(num_views)
    for each in kept.edges:
        counts += np.bincount(each.observations.views, minlength=num_views)
    return bool(np.median(counts) >= options.adjusted_observations)


@dataclass(frozen=True, kw_only=True)
class Depths:
    """What matching finds along the chains of every view.

    Attributes:
        samples: depths of the samples of each view, without their supports to save memory.
        agreeing: per view (S,) number of other views that agree with each depth.
    """

    samples: list[ChainDepths]
    agreeing: list[Int32Array]


def find_depths(
    given: TracingInput, near: Neighborhood, options: PipelineOptions, workers: Workers
) -> Depths:
    """Depths along the chains of every view."""
    order = local_order([given.neighbors[view] for view in range(len(given.views))])
    given.graphs.trim()

    def calls() -> Iterator[Call]:
        for view in order.tolist():
            part = given.part(view, given.neighbors[view], workers)
            depth_range = near.ranges[view]
            yield compute_chain_depths, (part, view, depth_range, options.chain_depth, 1)

    found = run_all(workers.images, calls(), workers.advance, workers.check)
    places = np.argsort(order)
    depths = [found[place] for place in places]
    agreeing = in_threads(
        lambda view: count_agreeing_views(
            given, depths, view, options.tracing.max_inconsistency_px
        ),
        order.tolist(),
        thread_count(options),
    )
    given.graphs.put_aside()  # from here on each is needed once or twice, the indexes often
    return Depths(
        samples=[without_supports(of) for of in depths],
        agreeing=[agreeing[place] for place in places],
    )


def trace_views(
    given: TracingInput,
    depths: Depths,
    options: PipelineOptions,
    limits: Limits | None,
    workers: Workers,
) -> tuple[list[TracedCurves], dict[str, int]]:
    """Trace curves on the chains of every view that earlier ones do not cover, the best view first.

    Views without a common observing view are processed in parallel.

    Returns:
        The curves of each view that has any, and the numbers of samples after each check.
    """
    samples, agreeing = depths.samples, depths.agreeing
    views = [given.views[view] for view in range(len(samples))]
    scores = [score_of(*of) for of in zip(views, samples, agreeing, strict=True)]
    order = np.argsort([-score for score in scores], kind="stable")
    traced: dict[int, TracedCurves] = {}
    covered = nothing_covered(given.polyline_offsets)
    in_runs = np.zeros(len(order), np.int64)

    def call(view: int) -> Call:
        part = given.part(view, given.observing_views[view], workers)
        found, threads = (covered[view], samples[view], agreeing[view]), workers.threads_per_view
        return curves_traced, (part, view, *found, options, threads)

    def finish(view: int, result: tuple[TracedCurves | None, int]) -> None:
        found, in_runs[view] = result
        if found is not None:
            traced[view] = found
            # Curves that filters would drop cover nothing: other views can trace these chains.
            lasting = lasting_points(found, options.tracing, limits)
            mark_covered(
                covered,
                given.polyline_offsets,
                found.observations.select(np.flatnonzero(lasting)),
                options.tracing.curve_step_points,
            )
        workers.advance()

    needed = [given.observing_views[view] for view in range(len(order))]
    schedule = Schedule(order, needed, given.num_kept(workers))
    run_scheduled(workers, schedule, call, finish)
    curves = [traced[view] for view in order.tolist() if view in traced]
    return curves, count_samples(depths, int(in_runs.sum()))


def curves_traced(
    given: TracingInput,
    view: int,
    covered: BoolArray,
    depths: ChainDepths,
    agreeing: Int32Array,
    options: PipelineOptions,
    num_threads: int,
) -> tuple[TracedCurves | None, int]:
    """Curves on the uncovered ones of a view's (N,) points, refined, with observations.

    Returns:
        The curves, None without any, and the number of samples in kept runs.
    """
    curves, in_runs = find_curves(
        given.graph(view),
        given.index(view),
        covered,
        depths,
        agreeing,
        options.tracing,
    )
    if len(curves.indices) == 0:
        return None, in_runs
    return trace_view(given, view, curves, options, num_threads), in_runs


def score_of(view: View, depths: ChainDepths, agreeing: Int32Array) -> float:
    """Quality of a view: sum over its samples of agreeing views times pixels per world unit."""
    return float(view.focal_px * (depths.inverse_depths @ agreeing))


def without_supports(depths: ChainDepths) -> ChainDepths:
    """The depths without their supports, to save memory; only the numbers of supports remain."""
    return replace(
        depths, support_views=np.zeros(0, np.int32), support_positions=np.zeros(0, np.float64)
    )


def count_samples(depths: Depths, in_runs: int) -> dict[str, int]:
    """Count the samples on chains after each check."""
    return {
        "samples": sum(len(d.samples) for d in depths.samples),
        "samples_with_depth": int(sum(d.found.sum() for d in depths.samples)),
        "samples_confirmed": int(sum((a >= 1).sum() for a in depths.agreeing)),
        "samples_in_runs": in_runs,
    }


def trace_view(
    given: TracingInput,
    view: int,
    curves: Curves,
    options: PipelineOptions,
    num_threads: int,
) -> TracedCurves:
    """Refine the curves of one reference view and find their observations."""
    observing_views = given.observing_views[view]
    reference = given.views[view]
    views = [given.views[other] for other in observing_views.tolist()]
    edge_indexes = [given.index(other) for other in observing_views.tolist()]
    refined = refine_curves(
        reference, given.index(view), curves, edge_indexes, options.refinement, num_threads
    )
    observed = np.isfinite(refined.positions).sum(axis=1)
    shift = np.where(observed > 0, refined.sigmas, 0) * np.sqrt(observed)
    log_chances = chance_of_observations(
        reference,
        refined.curves,
        refined.residuals,
        shift / options.refinement.noise_px,
        views,
        edge_indexes,
        options.refinement,
        num_threads,
    )
    inverse_depths = refined.curves.inverse_depths
    positions = np.column_stack([curves.indices, refined.positions])
    return TracedCurves(
        points=lift(reference, refined.curves.undistorted, inverse_depths),
        sigmas=refined.sigmas / inverse_depths**2,
        uncertainties=refined.sigmas / inverse_depths * reference.focal_px,
        log_chances=log_chances,
        offsets=refined.curves.offsets,
        reference=view,
        observations=TracedObservations.of_table(
            np.concatenate([[view], observing_views]),
            positions,
            residuals=with_reference(refined.residuals),
            drifts=with_reference(refined.drifts),
        ),
    )
