"""The paper's tracing in its order: PECs, PEPCs, validation and following, visibility, sampling."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.edges3d import Edges3D, TracedEdges
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.paper.correspondences import (
    PepcSource,
    pepcs_from_pecs,
    pepcs_from_sfm_points,
)
from colmap_edges.edges3d.paper.following import follow_edges
from colmap_edges.edges3d.paper.matching import match_polylines
from colmap_edges.edges3d.paper.places import IndexedViews, index_views
from colmap_edges.edges3d.paper.sampling import sample_edges
from colmap_edges.edges3d.paper.visibility import (
    drop_doubtful_views,
    expand_visibility,
    filter_outliers,
)
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.executors import thread_count

logger = logging.getLogger(__name__)


def trace_edges_paper(
    model: Model, graphs: Graphs, options: PipelineOptions
) -> tuple[TracedEdges, dict[str, Any]]:
    """Reconstruct 3D edges by the paper's method.

    Args:
        model: posed views and SfM points.
        graphs: the edge graph of each view.
        options: the settings, as `resolved` for the model's scale; the groups matching,
            correspondence, following, visibility and sampling hold every parameter of the paper.

    Returns:
        3D edges sampled to edge points with tracks, no contours, and counts in, kept and dropped
        by reason.
    """
    whole = [graphs.load(view) for view in range(len(model.views))]
    chains, num_threads = index_views(model.views, whole), thread_count(options)
    sources, stats = pepc_sources(model, chains, options, num_threads)
    edges, stats["starts"] = follow_edges(chains, sources, options.following, num_threads)
    stats["followed"] = {"edges": edges.num_edges, "points": edges.num_points}
    edges, stats["visibility"] = expand_visibility(edges, chains, options.visibility, num_threads)
    edges, stats["doubtful_views"] = drop_doubtful_views(
        edges, chains, options.visibility, num_threads
    )
    edges, stats["outliers"] = filter_outliers(edges, options.visibility)
    edges = sample_edges(
        edges, chains, options.sampling, options.following.max_error_px, num_threads
    )
    stats["sampled"] = {"edges": edges.num_edges, "points": edges.num_points}
    logger.info("%d 3D edges of %d edge points", edges.num_edges, edges.num_points)
    return TracedEdges(edges=edges, contours=Edges3D.none()), stats


def pepc_sources(
    model: Model, chains: IndexedViews, options: PipelineOptions, num_threads: int
) -> tuple[list[PepcSource], dict[str, Any]]:
    """PEPCs of the selected strategies, those from SfM points first, each in random order."""
    seed, strategy = options.random_seed, options.correspondence.strategy
    sources, stats = [], {}
    if strategy in ("sfm_points", "both"):
        found = pepcs_from_sfm_points(model, chains, options.correspondence, num_threads)
        sources.append(found.shuffled(seed))
        stats["pepcs_from_sfm_points"] = len(found)
    if strategy in ("pecs", "both"):
        pecs = match_polylines(model, chains, options.matching, seed, num_threads)
        stats["polylines"] = len(pecs)
        stats["matched_polylines"] = int(np.count_nonzero(pecs >= 0))
        stats["pecs"] = int(pecs.max(initial=-1)) + 1
        found = pepcs_from_pecs(model, chains, pecs, options.correspondence, num_threads)
        sources.append(found.shuffled(seed))
        stats["pepcs_from_pecs"] = len(found)
    return sources, {"pepcs": stats}
