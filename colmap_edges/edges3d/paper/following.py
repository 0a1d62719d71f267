"""Validation of PEPCs and following of edges through the views (paper: PEPC validation)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from colmap_edges.core.arrays import (
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    blocks,
    joined_offsets,
    owners_of,
)
from colmap_edges.core.edges3d import Edges3D, mean_colors
from colmap_edges.edges3d.paper.correspondences import Pepcs, PepcSource
from colmap_edges.edges3d.paper.observations import observations_at
from colmap_edges.edges3d.paper.places import IndexedViews, Places
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import FollowingOptions

OUTCOMES = (
    "accepted",
    "on_covered_stretch",
    "too_few_views",
    "no_valid_selection",
    "ambiguous_selection",
    "on_known_edge",
)


def follow_edges(
    chains: IndexedViews, sources: Sequence[PepcSource], options: FollowingOptions, num_threads: int
) -> tuple[Edges3D, dict[str, int]]:
    """Turn PEPCs into 3D edges.

    PEPCs are processed in order. Selections of three well-conditioned views are tried, those
    supported by most other views first. A selection is valid if it triangulates and can be
    followed. Selections of the same 3D point count as one, and those with at least two fewer
    supporting views are ignored. A PEPC with exactly one valid selection is extended to further
    views and followed in both directions in all its views. Starts on chains covered by an earlier
    3D edge are skipped.

    Returns:
        3D edges with points about `step_px` apart, and the number of starts by outcome.
    """
    covered = _kernels.CoveredChains(chains.indexes)
    found, counts = [], np.zeros(len(OUTCOMES), np.int64)
    for source in sources:
        for some in blocks(len(source), 16_384):
            rows = np.arange(some.start, some.stop)
            starts = source.starts.select(rows)
            fresh = rows[covered.covers(starts.views, starts.positions) == 0]
            *edges, outcomes = follow_pepcs(
                chains, source.pepcs(fresh), covered, options, num_threads
            )
            found.append(FollowedEdges(*edges))
            counts += np.bincount(outcomes, minlength=len(OUTCOMES))
            counts[OUTCOMES.index("on_covered_stretch")] += len(rows) - len(fresh)
    return edges_of(found, chains), dict(zip(OUTCOMES, counts.tolist(), strict=True))


class FollowedEdges(NamedTuple):
    """Result of the kernel: points, edges, and tracks as positions on chains."""

    points: FloatArray  # (N, 3)
    edge_offsets: IntArray  # (E + 1,)
    closed: ByteArray  # (E,)
    track_offsets: IntArray  # (N + 1,)
    views: Int32Array  # (T,)
    positions: FloatArray  # (T,)


def follow_pepcs(
    chains: IndexedViews,
    pepcs: Pepcs,
    covered: Any,
    options: FollowingOptions,
    num_threads: int,
) -> tuple[Any, ...]:
    """Follow PEPCs; returns the arrays of `FollowedEdges` and the outcome (S,) of each start.

    `covered` is the kernel's record of covered chains; the new edges are added to it.
    """
    found: tuple[Any, ...] = _kernels.trace_edges(
        chains.indexes,
        covered,
        pepcs.starts.views,
        pepcs.starts.positions,
        pepcs.candidate_offsets,
        pepcs.candidates.views,
        pepcs.candidates.positions,
        options.step_px,
        options.max_error_px,
        options.max_step_ratio,
        float(np.sin(np.radians(options.min_epipolar_angle_deg))),
        float(np.sin(np.radians(options.full_triangulation_angle_deg))),
        options.max_stretch,
        3,  # minimum number of observations (paper: PEPC-selection)
        options.min_steps,
        options.max_selections,
        num_threads,
    )
    return found


def edges_of(parts: Sequence[FollowedEdges], chains: IndexedViews) -> Edges3D:
    """Combine all parts to 3D edges with observations."""
    if not parts:
        return Edges3D.none()
    points = np.concatenate([part.points for part in parts])
    closed = np.concatenate([part.closed for part in parts]).astype(bool)
    track_offsets = joined_offsets([part.track_offsets for part in parts])
    places = Places(
        views=np.concatenate([part.views for part in parts]),
        positions=np.concatenate([part.positions for part in parts]),
    )
    observed = observations_at(owners_of(track_offsets), places, chains)
    return Edges3D(
        points=points,
        edge_offsets=joined_offsets([part.edge_offsets for part in parts]),
        closed=closed,
        observations=observed.by_point(len(points)),
        sigmas=np.full(len(points), np.nan),
        end_nodes=np.full((len(closed), 2), -1, np.int32),
        colors=mean_colors(observed.colors, track_offsets),
    )
