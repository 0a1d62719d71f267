"""Straight pieces of the 2D chains of all views, whose viewing rays may touch a cylinder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, Table
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.straight_pieces import straight_pieces

STRAIGHT_PX = 0.7  # maximum distance of a piece's points from its chord


@dataclass(frozen=True, kw_only=True)
class Lines(Table):
    """Straight pieces of chains.

    Attributes:
        views: (L,) int32 views, ascending.
        centers: (L, 3) their centres.
        rays: (L, 2, 3) unit directions to both ends.
        focals: (L,) focal lengths of the views, pixels.
        lengths: (L,) lengths in pixels.
        fixed: (L,) shares of their points that fixed 3D edges observe.
    """

    views: Int32Array
    centers: FloatArray
    rays: FloatArray
    focals: FloatArray
    lengths: FloatArray
    fixed: FloatArray


def lines_of(view: View, index: int, graph: EdgeGraph, is_fixed: BoolArray) -> Lines:
    """The straight pieces of a view's chains; fixed 3D edges observe (n,) of their points."""
    pieces = straight_pieces(graph, is_fixed, STRAIGHT_PX)
    count = len(pieces.lengths)
    return Lines(
        views=np.full(count, index, np.int32),
        centers=np.tile(view.center, (count, 1)),
        rays=unit(view.rays_of_undistorted(pieces.ends)),
        focals=np.full(count, view.focal_px),
        lengths=pieces.lengths,
        fixed=pieces.observed,
    )
