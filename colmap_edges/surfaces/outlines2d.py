"""What may be outlines of round bodies in the images: pieces and samples of all views' chains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from colmap_edges.core.arrays import joined_tables
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges2d.straight_pieces import near_observations
from colmap_edges.runtime.executors import in_threads
from colmap_edges.surfaces.cylinders.lines import Lines, lines_of
from colmap_edges.surfaces.revolution.samples import Samples, samples_of


class Outlines2D(NamedTuple):
    """What may be outlines of round bodies in the images.

    Attributes:
        lines: straight pieces of the chains of all views.
        samples: samples of these chains.
    """

    lines: Lines
    samples: Samples


def find_outlines(
    views: Sequence[View], graphs: Graphs, edges: Edges3D, num_threads: int
) -> Outlines2D:
    """The straight pieces and the samples of the chains of all views.

    Args:
        views: all views.
        graphs: their edge graphs.
        edges: fixed 3D edges that observe the graphs.
        num_threads: threads to use; the result does not depend on it.
    """
    observed = edges.observations
    rows_of = rows_by_view(observed.views, len(views))

    def outlines_of(index: int) -> tuple[Lines, Samples]:
        graph = graphs.load(index)
        is_fixed = near_observations(len(graph.undistorted), observed.positions[rows_of[index]])
        given = (views[index], index, graph, is_fixed)
        return lines_of(*given), samples_of(*given)

    lines, samples = zip(*in_threads(outlines_of, range(len(views)), num_threads), strict=True)
    return Outlines2D(joined_tables(lines), joined_tables(samples))
