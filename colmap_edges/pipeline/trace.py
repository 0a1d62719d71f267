"""The tracing stage."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from functools import partial
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.thinning import thinned
from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.arrays import FloatArray, flattened, unflattened
from colmap_edges.core.edges3d import Edges3D, Nodes, TracedEdges
from colmap_edges.core.view import View, track_residuals
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import Detection
from colmap_edges.runtime.cache import Arrays, key_of
from colmap_edges.runtime.executors import Workers, open_workers
from colmap_edges.runtime.stages import Stages, plain_counts


def trace_stage(
    model: Model,
    detection: Detection,
    options: PipelineOptions,
    stages: Stages,
    workers: Workers | None = None,
) -> tuple[Model, TracedEdges]:
    """Trace 3D edges from the 2D edge graphs, or load them from the cache.

    Returns:
        The model, with refined poses if held-out points fit better to these, and the edges with the
        view-dependent contours.
    """
    if workers is None:
        with open_workers(options) as workers:
            return trace_stage(model, detection, options, stages, workers)
    cache = workers.cache if detection.keys else None
    key = key_of_edges(model, detection.keys, options) if cache else ""
    passes = 2 * len(model.views) * options.tracing.num_rounds
    steps = 1 if options.tracing.method == "paper" else passes
    with stages.stage("trace", steps) as stage:
        read = partial(traced_from, model=model, options=options)
        kept = cache.load("edges", key, read) if cache else None
        if kept is None:
            workers = replace(workers, advance=stage.advance)
            traced, stats = trace(model, detection.graphs, options, workers)
            details = plain_counts(stats)
            if cache:
                text = np.array(json.dumps(details))
                cache.save("edges", key, flattened(traced) | {"details": text})
        else:
            traced, details = kept
        edges = traced.edges
        stage.counts = {"edges": edges.num_edges, "edge_points": edges.num_distinct}
        if cache:
            stage.counts["edges_reused"] = edges.num_edges if kept is not None else 0
        stage.counts["details"] = details
        return moved_model(model, traced.poses), traced


def traced_from(
    arrays: Arrays, model: Model, options: PipelineOptions
) -> tuple[TracedEdges, dict[str, Any]]:
    """The traced edges and their counts in a cache entry.

    Raises:
        KeyError, ValueError, ColmapEdgesError: if the arrays are not those of such edges, or points
            do not project to where they are observed.
    """
    traced = unflattened(TracedEdges, arrays)
    views = moved_model(model, traced.poses).views
    # In results, the largest median residual is 1.1 times the limit of observations.
    limit_px = 3 * max(options.refinement.max_residual_px, options.following.max_error_px)
    for edges in (traced.edges, traced.contours):
        edges.check("edges", len(views))
        if not all((median_residuals(views, of) <= limit_px).all() for of in (edges, edges.nodes)):
            raise ValueError("points do not project to where they are observed")
    traced.outlines.check("outlines", len(views))
    details = json.loads(str(arrays["details"]))
    if not isinstance(details, dict):
        raise ValueError("counts have no names")
    return traced, details


def median_residuals(views: Sequence[View], points: Edges3D | Nodes) -> FloatArray:
    """(M,) lower median of the reprojection errors of each observed point, pixels.

    NaN for points that are mostly behind the cameras.
    """
    seen = points.observations
    residuals = track_residuals(views, points.points[seen.points], seen.views, seen.pixels)
    order = np.lexsort((residuals, seen.points))  # NaN last
    observed = seen.counts > 0
    middle = seen.offsets[:-1] + (seen.counts - 1) // 2
    found: FloatArray = residuals[order][middle[observed]]
    return found


def trace(
    model: Model, graphs: Graphs, options: PipelineOptions, workers: Workers
) -> tuple[TracedEdges, dict[str, Any]]:
    """Trace 3D edges by the method chosen in the options."""
    if options.tracing.method == "paper":
        from colmap_edges.edges3d.paper.tracing import trace_edges_paper

        return trace_edges_paper(thinned(model, options.random_seed), graphs, options)
    from colmap_edges.edges3d.chains.tracing import trace_edges

    return trace_edges(model, graphs, options, workers)


def key_of_edges(model: Model, graph_keys: Sequence[str], options: PipelineOptions) -> str:
    """The cache key of traced edges: a digest of graphs, poses, SfM points and options."""
    traced = {entry.name for entry in fields(options) if entry.metadata["stage"] == "trace"}
    groups = {name: group for name, group in asdict(options).items() if name in traced}
    poses = np.array([[*view.rotation.ravel(), *view.translation] for view in model.views])
    tracks = (model.track_offsets, model.track_views, model.track_points2D)
    return key_of("edges", list(graph_keys), groups, poses, model.points3D_xyz, *tracks)
