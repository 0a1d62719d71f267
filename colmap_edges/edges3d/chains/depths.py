"""Depths along the chains of each view, from the agreement of many views.

Every intersection of a sample's epipolar line with a chain of a neighbour is a depth hypothesis (a
PEPC of the paper, but from all views and not restricted to the vicinity of SfM points). Hypotheses
that agree form clusters, and dynamic programming along the chain selects among them (instead of
the paper's three-view selection).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    owners_of,
    ranks_of,
)
from colmap_edges.declared_options import derived
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges3d.chains.side_similarity import estimate
from colmap_edges.edges3d.chains.tracing_input import TracingInput
from colmap_edges.edges3d.chains.view_selection import DepthRange
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import ChainDepthOptions

SURE_SCORE = 8.0  # minimum log likelihood ratio of the depths from which side similarity is learned
END_PX = 6  # length at the ends of polylines that is displaced by blur and neighbouring edges
# minimum distance of two samples on a short polyline, whose ends are then shortened
MIN_INNER_PX = 8


@dataclass(frozen=True, kw_only=True)
class ChainDepths:
    """Samples along the chains of one view with their depths and supporting views.

    Attributes:
        samples: (S,) int64 indices into the graph's points.
        sample_offsets: (P + 1,) int64 CSR of the samples by polyline.
        inverse_depths: (S,) float64 1 / depth; 0 where no depth was found.
        sigmas: (S,) float64 change of inverse depth for 1 px.
        scores: (S,) float64 log likelihood ratio against chance.
        support_offsets: (S + 1,) int64 CSR of the agreeing intersections by sample.
        support_views: (T,) int32 views of the intersections, indices into the model's views.
        support_positions: (T,) float64 fractional indices into those views' graph points.
    """

    samples: IntArray
    sample_offsets: IntArray
    inverse_depths: FloatArray
    sigmas: FloatArray
    scores: FloatArray
    support_offsets: IntArray
    support_views: Int32Array
    support_positions: FloatArray

    @property
    def found(self) -> BoolArray:
        """(S,) whether a sample has a depth."""
        return np.diff(self.support_offsets) > 0


def sample_chains(graph: EdgeGraph, step: int) -> tuple[IntArray, IntArray]:
    """Place samples evenly along each polyline, at most `step` points apart.

    The first and last sample are `END_PX` from its ends, but nearer to them if they were otherwise
    within `MIN_INNER_PX` of each other, since a run needs two. Shorter polylines have one sample.

    Returns:
        (S,) indices of points, (P + 1,) offsets of the polylines' samples.
    """
    lengths = np.diff(graph.polyline_offsets)
    ends = np.minimum((lengths - 1 - MIN_INNER_PX) // 2, END_PX)
    ends = np.where(ends >= 0, ends, lengths // 2)
    inner = np.maximum(lengths - 1 - 2 * ends, 0)
    intervals = -(-inner // step)
    ids = np.repeat(np.arange(len(lengths)), intervals + 1)
    ranks = ranks_of(intervals + 1)
    along = np.round(ranks * inner[ids] / np.maximum(intervals[ids], 1)).astype(np.int64)
    return graph.polyline_offsets[ids] + ends[ids] + along, offsets_of(intervals + 1)


def compute_chain_depths(
    given: TracingInput,
    view: int,
    depth_range: DepthRange,
    options: ChainDepthOptions,
    num_threads: int,
) -> ChainDepths:
    """Estimate the depths along the chains of a view from its neighbours.

    Args:
        given: the views with their graphs and neighbours, and the side likelihoods.
        view: index of the view.
        depth_range: the inverse depths visible in it.
        options: sampling, agreement and continuity.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The S samples on the view's chains, with depths and agreeing intersections.
    """
    graph, neighbors = given.graph(view), given.neighbors[view]
    samples, offsets = sample_chains(graph, options.sample_step_points)
    matched = matching(given, view, samples, offsets, depth_range, options)
    found = _kernels.chain_depths(
        **matched, steps=float(options.sample_step_points), num_threads=num_threads
    )
    depths, sigmas, scores, support_offsets, support_neighbors, positions = found
    return ChainDepths(
        samples=samples,
        sample_offsets=offsets,
        inverse_depths=depths,
        sigmas=sigmas,
        scores=scores,
        support_offsets=support_offsets,
        support_views=np.asarray(neighbors, np.int32)[support_neighbors],
        support_positions=positions,
    )


def matching(
    given: TracingInput,
    view: int,
    samples: IntArray,
    offsets: IntArray,
    depth_range: DepthRange,
    options: ChainDepthOptions,
) -> dict[str, Any]:
    """The arguments of the kernels that match a view's samples with its neighbours, by name.

    Args:
        given: the edge graphs of the view and its neighbours.
        view: index of the view.
        samples: (S,) int64 points of its graph.
        offsets: (C + 1,) int64 offsets of the samples by chain.
        depth_range: the inverse depths visible in it.
        options: agreement and continuity.
    """
    return {
        "source": given.index(view),
        "neighbors": [given.index(neighbor) for neighbor in given.neighbors[view].tolist()],
        "samples": samples,
        "sample_offsets": offsets,
        "inverse_depths": depth_range.at(given.graph(view).undistorted[samples].astype(np.float64)),
        "max_disagreement_px": options.max_disagreement_px,
        "side_likelihoods": given.sides,
        "min_angle_sin": float(np.sin(np.radians(options.min_epipolar_angle_deg))),
        "visibility_rate": options.visibility_rate,
        "detection_rate": options.detection_rate,
        "min_log_likelihood_ratio": options.min_log_likelihood_ratio,
        "break_penalty": options.break_penalty,
        "max_clusters": options.max_clusters,
    }


def learn_side_likelihoods(
    given: TracingInput,
    ranges: Sequence[DepthRange],
    options: ChainDepthOptions,
    random_seed: int,
    num_threads: int,
) -> Float32Array:
    """Learn how side intensities differ between views, for one edge and for different edges.

    Learned from depths that are reliable by geometry alone, for some samples of some views.

    Args:
        given: the V views with their graphs and neighbours.
        ranges: (V,) the inverse depths visible in each.
        options: as for `compute_chain_depths`.
        random_seed: seed of the random pairs.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        (256, 256) likelihood ratios by the differences of the dark and the bright sides.
    """
    few = derived(options, sample_step_points=4 * options.sample_step_points)
    random = np.random.default_rng(random_seed)
    same, chance = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2), np.int64)]
    count = len(given.views)
    for view in np.linspace(0, count - 1, np.clip(count // 8, 2, 6)).astype(int).tolist():
        depths = compute_chain_depths(given, view, ranges[view], few, num_threads)
        owners = owners_of(depths.support_offsets)
        sure = depths.scores[owners] >= sure_score(depths)
        sides = given.graph(view).sides[depths.samples].astype(int)
        for other in given.neighbors[view].tolist():
            rows, theirs = sure & (depths.support_views == other), given.graph(other).sides
            positions = depths.support_positions[rows].astype(int)
            same.append(np.abs(sides[owners[rows]] - theirs[positions]))
            if len(theirs):
                chance.append(np.abs(sides - theirs[random.integers(0, len(theirs), len(sides))]))
    return estimate(np.concatenate(same), np.concatenate(chance))


def sure_score(depths: ChainDepths) -> float:
    """The minimum score of depths that are used for learning."""
    scores = depths.scores[depths.found]
    if len(scores) == 0:
        return SURE_SCORE
    # The most reliable depths are used if fewer exceed SURE_SCORE.
    return min(SURE_SCORE, float(np.quantile(scores, 1 - 0.3)))
