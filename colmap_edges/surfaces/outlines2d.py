"""What may be outlines of round bodies in the images: pieces and samples of all views' chains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, joined_tables
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.surfaces.cylinders.lines import Lines, lines_of
from colmap_edges.surfaces.revolution.samples import Samples, samples_of

REACH = 4  # chain points on each side of an observation that belong to the observed edge


class Outlines2D(NamedTuple):
    """What may be outlines of round bodies in the images.

    Attributes:
        lines: straight pieces of the chains of all views.
        samples: samples of these chains.
    """

    lines: Lines
    samples: Samples


def find_outlines(views: Sequence[View], graphs: Graphs, edges: Edges3D) -> Outlines2D:
    """The straight pieces and the samples of the chains of all views.

    Args:
        views: all views.
        graphs: their edge graphs.
        edges: fixed 3D edges that observe the graphs.
    """
    observed = edges.observations
    lines, samples = [], []
    for index, rows in enumerate(rows_by_view(observed.views, len(views))):
        graph = graphs.load(index)
        is_fixed = are_observed(len(graph.undistorted), observed.positions[rows])
        lines.append(lines_of(views[index], index, graph, is_fixed))
        samples.append(samples_of(views[index], index, graph, is_fixed))
    return Outlines2D(joined_tables(lines), joined_tables(samples))


def are_observed(count: int, positions: FloatArray) -> BoolArray:
    """(count,) whether chain points are within `REACH` of observed (n,) positions."""
    near = np.zeros(count + 2 * REACH + 1, np.int64)
    at = np.clip(np.nan_to_num(positions, nan=-1.0), -1, count - 1).astype(np.int64)
    at = at[at >= 0]
    np.add.at(near, at, 1)
    np.add.at(near, at + 2 * REACH + 1, -1)
    return np.asarray(np.cumsum(near)[REACH : REACH + count] > 0)
