"""Validate PEPCs and follow edges through the views (paper: PEPC validation)."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import owners_of
from colmap_edges.core.edges3d import Edges3D, mean_colors
from colmap_edges.edges3d.paper.correspondences import Pepcs
from colmap_edges.edges3d.paper.observations import observations_at
from colmap_edges.edges3d.paper.places import IndexedViews, Places
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import FollowingOptions

MIN_SELECTION_VIEWS = 3  # fewest observations that give evidence (paper: PEPC-selection)
OUTCOMES = (
    "accepted",
    "on_covered_stretch",
    "too_few_views",
    "no_valid_selection",
    "ambiguous_selection",
    "on_known_edge",
)


def follow_edges(
    chains: IndexedViews, pepcs: Pepcs, options: FollowingOptions, num_threads: int
) -> tuple[Edges3D, dict[str, int]]:
    """Turn PEPCs into 3D edges.

    PEPCs are taken in order. Of each, selections on three well-conditioned views are tried, those
    first that candidates of most other views agree with: valid is one that triangulates and can be
    followed. A PEPC with exactly one valid selection (those that are one 3D point count as one, and
    those do not count that two views fewer agree with) is extended to further views and followed
    both ways in all its views at once. Starts on stretches that an earlier 3D edge covers are
    skipped.

    Returns:
        3D edges with points about `step_px` apart, and the number of starts by outcome.
    """
    points, edge_offsets, closed, track_offsets, views, positions, outcomes = _kernels.trace_edges(
        chains.indexes,
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
        MIN_SELECTION_VIEWS,
        options.min_steps,
        options.max_selections,
        num_threads,
    )
    places = Places(views=views, positions=positions)
    observed = observations_at(owners_of(track_offsets), places, chains)
    edges = Edges3D(
        points=points,
        edge_offsets=edge_offsets,
        closed=closed.astype(bool),
        observations=observed.by_point(len(points)),
        sigmas=np.full(len(points), np.nan),
        end_nodes=np.full((len(closed), 2), -1, np.int32),
        colors=mean_colors(observed.colors, track_offsets),
    )
    counts = np.bincount(outcomes, minlength=len(OUTCOMES))
    return edges, dict(zip(OUTCOMES, counts.tolist(), strict=True))
