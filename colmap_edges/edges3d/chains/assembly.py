"""Assembly of the filtered curves of all views to 3D edges with tracks, linked at corners."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D, TracedEdges, mean_colors
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.edges2d.edge_index import look_up
from colmap_edges.edges3d.chains.filtering import FilteredCurves
from colmap_edges.edges3d.chains.merging import merge_traced
from colmap_edges.edges3d.chains.traced_curves import TracedCurves
from colmap_edges.edges3d.chains.tracing_input import TracingInput
from colmap_edges.edges3d.linking.bends import cut_at_bends
from colmap_edges.edges3d.linking.bridges import with_bridges
from colmap_edges.edges3d.linking.circles import join_circles
from colmap_edges.edges3d.linking.gaps import are_observed
from colmap_edges.edges3d.linking.joining import link_edges
from colmap_edges.edges3d.linking.nodes import meet_at_nodes
from colmap_edges.options import PipelineOptions


def link(
    given: TracingInput,
    pieces: TracedEdges,
    options: PipelineOptions,
    num_threads: int,
) -> tuple[TracedEdges, dict[str, Any]]:
    """Link pieces to edges and contours.

    Args:
        given: the views with their whole edge graphs.
        pieces: the pieces, as made by `merged_pieces`.
        options: how pieces are linked, and how they must be observed in between.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The edges and the contours, and counts.
    """

    def linked(pieces: Edges3D) -> Edges3D:
        goes_on = partial(are_observed, pieces, given, options, num_threads)
        return link_edges(pieces, options.linking, goes_on)

    # One name for all, so that no step's tables outlast the next one.
    edges = linked(pieces.edges)
    edges = linked(edges)  # again, since longer pieces have more accurate directions
    edges = join_circles(edges, given, options, num_threads)
    edges, num_bridges = with_bridges(cut_at_bends(edges), given.views, given, options, num_threads)
    edges = meet_at_nodes(edges, given, options, num_threads)
    contours = linked(pieces.contours)
    given.graphs.trim()
    return with_look_up(given, edges, contours, num_threads), {
        "pieces": pieces.edges.num_edges,
        "bridges": num_bridges,
        "edges_closed": int(edges.closed.sum()),
        "nodes": len(edges.nodes.points),
        "junctions": int((edges.nodes.through_points >= 0).sum()),
    }


def merged_pieces(
    given: TracingInput, kept: FilteredCurves, options: PipelineOptions, num_threads: int
) -> tuple[TracedEdges, dict[str, int]]:
    """The kept pieces of all reference views without duplicates, and counts."""
    once, merged = merge_traced(given, kept, options, num_threads)
    return TracedEdges(edges=make_edges(once.edges), contours=make_edges(once.contours)), merged


def make_edges(parts: list[TracedCurves]) -> Edges3D:
    """Combine the curves of all reference views to 3D edges, observed at positions on chains."""
    lengths = np.concatenate([np.zeros(0, np.int64), *(np.diff(part.offsets) for part in parts)])
    places = ChainObservations.concatenated([part.observations for part in parts])
    points = np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)])
    return Edges3D(
        points=points,
        edge_offsets=offsets_of(lengths),
        closed=np.zeros(len(lengths), bool),
        observations=Observations.of_positions(places),
        sigmas=np.concatenate([np.zeros(0), *(part.sigmas for part in parts)]),
        end_nodes=np.full((len(lengths), 2), -1, np.int32),
        colors=np.zeros(points.shape, np.uint8),
    )


def with_look_up(
    given: TracingInput, edges: Edges3D, contours: Edges3D, num_threads: int
) -> TracedEdges:
    """The edges with chains, pixels and normals of all observations, and colours of all points."""
    nodes = edges.nodes
    observed = (edges.observations, nodes.observations, contours.observations)
    (of_edges, colors), (of_nodes, node_colors), (of_contours, contour_colors) = look_up(
        given, *observed, num_threads=num_threads
    )
    nodes = replace(nodes, observations=of_nodes, colors=mean_colors(node_colors, of_nodes.offsets))
    colors_of_points = mean_colors(colors, of_edges.offsets)
    colors_of_contours = mean_colors(contour_colors, of_contours.offsets)
    return TracedEdges(
        edges=replace(edges, observations=of_edges, colors=colors_of_points, nodes=nodes),
        contours=replace(contours, observations=of_contours, colors=colors_of_contours),
    )
