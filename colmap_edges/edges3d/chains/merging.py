"""Merging of curves traced in several reference views, with refinement on all observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.arrays import (
    FloatArray,
    IntArray,
    offsets_of,
)
from colmap_edges.core.observations import ChainObservations
from colmap_edges.core.view import lift
from colmap_edges.edges3d.chains.curves import Curves, replace_depths
from colmap_edges.edges3d.chains.filtering import (
    FilteredCurves,
    chosen,
    filter_remains,
    find_pieces,
)
from colmap_edges.edges3d.chains.observing import Observers, drop_lone, placed
from colmap_edges.edges3d.chains.refinement import (
    are_weak,
    joint_step,
    rounding_drifts,
    with_reference,
)
from colmap_edges.edges3d.chains.traced_curves import TracedCurves, TracedObservations
from colmap_edges.edges3d.chains.tracing_input import TracingInput
from colmap_edges.edges3d.linking.duplicates import Pieces, merge_pieces
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.executors import in_threads


def merge_traced(
    given: TracingInput, kept: FilteredCurves, options: PipelineOptions, num_threads: int
) -> tuple[FilteredCurves, dict[str, int]]:
    """Merge duplicates: the kept piece takes over the observations of the removed ones.

    Args:
        given: the views with their whole edge graphs.
        kept: the pieces of every reference view, at positions on these graphs.
        options: noise, search radius of observations, and probability of observing an edge.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The kept pieces, refined where observations were added, and counts. Remainders of removed
        pieces are tested for view-dependence again.
    """
    traced = [each for each in kept.edges if len(each.points)]
    if not traced:
        return kept, {"points_merged": 0}
    pieces = Pieces(
        points=np.concatenate([t.points for t in traced]),
        offsets=offsets_of(np.concatenate([np.diff(t.offsets) for t in traced])),
        sigmas=np.concatenate([t.sigmas for t in traced]),
        observations=ChainObservations.concatenated([t.observations for t in traced]),
        views=[given.views[view] for view in range(given.num_views)],
    )
    merging = merge_pieces(pieces, given, options, num_threads)
    given.graphs.trim()
    starts = offsets_of(np.array([len(t.points) for t in traced]))
    owners = np.searchsorted(starts, merging.takers, "right") - 1

    def left_of(place: int) -> tuple[TracedCurves, TracedCurves]:
        each = traced[place]
        rows = np.flatnonzero(owners == place)
        stays = merging.kept[starts[place] : starts[place + 1]]
        left = chosen(each, find_pieces(each, stays, np.inf, options.tracing)[0], stays)
        takers = np.cumsum(stays)[merging.takers[rows] - starts[place]] - 1
        if len(rows):
            taken = pieces.observations.select(merging.givers[rows])
            left = refined_with(given, left, takers, taken, options)
        return filter_remains(left, kept.limits, options.tracing)

    found = in_threads(left_of, range(len(traced)), num_threads)
    edges, contours = [fixed for fixed, _ in found], [moving for _, moving in found]
    count = {"points_merged": int((~merging.kept).sum())}
    return replace(kept, edges=edges, contours=[*kept.contours, *contours]), count


def refined_with(
    given: TracingInput,
    traced: TracedCurves,
    takers: IntArray,
    taken: ChainObservations,
    options: PipelineOptions,
) -> TracedCurves:
    """Refine curves of one reference view on their own observations and those (R,) points take."""
    reference = given.views[traced.reference]
    others, table = observation_table(traced, takers, taken)
    at_reference, table = table[:, 0], np.ascontiguousarray(table[:, 1:])
    undistorted, depths = reference.project_undistorted(traced.points)
    curves = Curves(
        undistorted=undistorted,
        inverse_depths=1 / depths,
        indices=np.zeros(len(undistorted), np.int64),
        offsets=traced.offsets,
        sides=np.zeros(len(undistorted), np.int8),
    )
    observers = Observers(
        reference=reference,
        own=given.index(traced.reference),
        others=[given.index(view) for view in others.tolist()],
        options=options.refinement,
        num_threads=1,
    )
    curves, table, residuals, information = refit(curves, table, observers)
    drifts = rounding_drifts(curves, table, observers)
    positions = np.column_stack([at_reference, table])
    with np.errstate(divide="ignore"):
        sigmas = options.refinement.noise_px / np.sqrt(information)
    return replace(
        traced,
        points=lift(reference, curves.undistorted, curves.inverse_depths),
        sigmas=np.minimum(traced.sigmas, sigmas / curves.inverse_depths**2),
        uncertainties=np.minimum(
            traced.uncertainties, sigmas / curves.inverse_depths * reference.focal_px
        ),
        observations=TracedObservations.of_table(
            np.append(traced.reference, others),
            positions,
            residuals=with_reference(residuals),
            drifts=with_reference(drifts),
        ),
    )


def observation_table(
    traced: TracedCurves, takers: IntArray, taken: ChainObservations
) -> tuple[IntArray, FloatArray]:
    """The K other views that observe curves, and (N, 1 + K) positions on their chains.

    The first column is the reference view. Own observations have priority over those taken over.
    """
    own = traced.observations
    views = np.unique(np.concatenate([own.views, taken.views, [traced.reference]]))
    table = np.full((len(traced.points), len(views)), np.nan)
    table[takers[taken.points], np.searchsorted(views, taken.views)] = taken.positions
    table[own.points, np.searchsorted(views, own.views)] = own.positions
    at = int(np.searchsorted(views, traced.reference))
    others = np.delete(np.arange(len(views)), at)
    return views[others], table[:, np.append(at, others)]


def refit(
    curves: Curves, positions: FloatArray, observers: Observers
) -> tuple[Curves, FloatArray, FloatArray, FloatArray]:
    """Refine curves on given observations, and drop observations that do not fit.

    Returns:
        The curves, (N, K) positions, (N, K) residuals in pixels and (N,) information on inverse
        depth in units of the noise.
    """
    positions, _, _ = slid(curves, positions, observers)
    normals = curves.normals
    sums = observers.sums(curves, positions, normals)
    changes, shifts = joint_step(curves, sums, observers.options)
    movable = ~are_weak(curves, sums)[curves.curve_ids]
    shifts, changes = np.where(movable, (shifts, changes), 0)
    curves = replace(curves, undistorted=curves.undistorted + shifts[:, None] * normals)
    curves = replace_depths(curves, curves.inverse_depths + changes)
    return curves, *slid(curves, positions, observers)


def slid(
    curves: Curves, positions: FloatArray, observers: Observers
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move observations to the nearest positions on the same chains, if these are near enough.

    Returns:
        (N, K) positions, (N, K) residuals in pixels, both NaN without observation, and (N,)
        information on inverse depth in units of the noise.
    """
    at, others = placed(observers.reference, curves), observers.others
    positions = _kernels.slide_positions(*at, positions, others, observers.num_threads)
    residuals, information = _kernels.observation_residuals(
        *at, positions, others, observers.num_threads
    )
    near = np.abs(residuals) <= observers.options.max_residual_px
    positions = drop_lone(np.where(near, positions, np.nan), curves.offsets)
    return positions, np.where(np.isfinite(positions), residuals, np.nan), information
