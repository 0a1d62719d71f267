"""Filtered curves of all views -> 3D edges with tracks, linked and led to corners."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D, mean_colors
from colmap_edges.edges2d.edge_index import look_up
from colmap_edges.edges3d.chains.filtering import Sorted, Traced
from colmap_edges.edges3d.chains.tracing_input import TracingInput
from colmap_edges.edges3d.linking.corners3d import meet_at_corners
from colmap_edges.edges3d.linking.gaps import are_observed
from colmap_edges.edges3d.linking.joining import link_edges
from colmap_edges.options import PipelineOptions


def link(
    given: TracingInput,
    kept: Sorted,
    options: PipelineOptions,
    num_threads: int,
) -> tuple[Edges3D, dict[str, Any]]:
    """Link what is kept to edges and outlines.

    Args:
        given: the views with their whole edge graphs.
        kept: the pieces, at positions on these graphs.
        options: how pieces are linked, and how they must be observed in between.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The edges with their outlines, and counts of them.
    """

    def linked(pieces: Edges3D) -> Edges3D:
        goes_on = partial(are_observed, pieces, given, options, num_threads)
        return link_edges(pieces, options.linking, goes_on)

    pieces, outlines = make_edges(given, kept.edges), make_edges(given, kept.outlines)
    edges = meet_at_corners(linked(pieces), given, options, num_threads)
    if outlines.num_edges:
        edges = replace(edges, outlines=linked(outlines))
    return edges, {
        "pieces": pieces.num_edges,
        "edges_closed": int(edges.closed.sum()),
        "nodes": int(edges.end_nodes.max(initial=-1)) + 1,
    }


def make_edges(given: TracingInput, parts: list[Traced]) -> Edges3D:
    """Put the curves of all drivers together as 3D edges with tracks."""
    points, sigmas, lengths, track_lengths, track_views, track_positions = [], [], [], [], [], []
    for part in parts:
        points.append(part.points)
        sigmas.append(part.sigmas)
        lengths.append(np.diff(part.offsets))
        track_lengths.append(part.num_observations)
        track_views.append(part.views[part.positions.indices])
        track_positions.append(part.positions.data)
    views = np.concatenate([np.zeros(0, np.int64), *track_views]).astype(np.int32)
    positions = np.concatenate([np.zeros(0), *track_positions])
    pixels, colors = look_up(given, views, positions)
    track_offsets = offsets_of(np.concatenate([np.zeros(0, np.int64), *track_lengths]))
    num_edges = int(sum(len(length) for length in lengths))
    return Edges3D(
        points=np.concatenate([np.zeros((0, 3)), *points]),
        edge_offsets=offsets_of(np.concatenate([np.zeros(0, np.int64), *lengths])),
        closed=np.zeros(num_edges, bool),
        track_offsets=track_offsets,
        track_views=views,
        track_points2D=pixels,
        sigmas=np.concatenate([np.zeros(0), *sigmas]),
        end_nodes=np.full((num_edges, 2), -1, np.int32),
        colors=mean_colors(colors, track_offsets),
    )
