"""Data that the page shows for a clicked edge: figures and reprojections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, IntArray, medians_of, offsets_of
from colmap_edges.core.curves3d import KINDS, Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.report.contents import Packed

FULL = 4096  # units of an image's width or height: a quarter of a pixel of its picture


def edge_of_observation(edges: Edges3D) -> IntArray:
    """(T,) edge of each observation."""
    return edges.edge_ids[edges.observations.points]


def residual_per_edge(edges: Edges3D, residuals: FloatArray) -> FloatArray:
    """(E,) mean residual of each edge's observations, pixels."""
    owners, finite = edge_of_observation(edges), np.isfinite(residuals)
    sums = np.bincount(owners[finite], residuals[finite], edges.num_edges)
    counts = np.bincount(owners[finite], minlength=edges.num_edges)
    return np.asarray(sums / np.maximum(counts, 1))


def edge_data(
    model: Model, edges: Edges3D, residuals: FloatArray, pictured: Sequence[int]
) -> Packed:
    """The figures of every edge and its reprojections into the views that have pictures.

    Args:
        model: the model with the views.
        edges: the 3D edges.
        residuals: (T,) distances of observations from projections, pixels.
        pictured: views with a picture, in the order of the pictures.
    """
    pixels, chosen = reprojections(model, edges, pictured)
    place = np.full(len(model.views), -1, np.int64)
    place[list(pictured)] = np.arange(len(pictured))
    owners, pictures = edge_of_observation(edges)[chosen], place[edges.observations.views[chosen]]
    order = np.lexsort((chosen, pictures, owners))  # similar values are adjacent, for compression
    counts = np.bincount(owners, minlength=edges.num_edges)
    return {
        "length": edges.lengths().astype(np.float32),
        "views": edges.num_views.astype(np.int32),
        "residual": residual_per_edge(edges, residuals).astype(np.float32),
        "points": np.diff(edges.edge_offsets).astype(np.int32),
        "track_offsets": offsets_of(counts).astype(np.int32),
        "track_pictures": pictures[order].astype(np.uint16),
        **{f"track_{axis}": pixels[order, i] for i, axis in enumerate("xy")},
    }


def edge_details(edges: Edges3D, curves: Curves3D, origin: FloatArray) -> Packed:
    """Figures that the page shows of a selected edge: its ends, nodes, deviations and curves.

    Args:
        edges: the 3D edges.
        curves: the curves that they consist of.
        origin: (3,) position to which coordinates of ends are relative.

    Returns:
        Arrays by edge: `ends` (6 E,) coordinates, `nodes` (2 E,) at the ends, `sigmas`; by node:
        `through`, the edge that passes there or -1; and by curve: its edge, kind, length, larger
        radius and the deviations of its position and radius, not finite where there is none.
    """
    first, last = edges.edge_offsets[:-1], edges.edge_offsets[1:] - 1
    ends = np.concatenate([edges.points[first], edges.points[last]], axis=1) - np.tile(origin, 2)
    through = edges.nodes.through_points
    owners = np.append(edges.edge_ids, -1)[through]
    return {
        "ends": ends.astype(np.float32).ravel(),
        "nodes": edges.end_nodes.ravel(),
        "through": owners.astype(np.int32),
        "sigmas": medians_of(edges.sigmas, edges.edge_ids, edges.num_edges).astype(np.float32),
        "kind_names": list(KINDS),
        "curve_edges": curves.edges.astype(np.int32),
        "curve_kinds": curves.kinds,
        "curve_lengths": curves.lengths().astype(np.float32),
        "curve_radii": curves.radii[:, 0].astype(np.float32),
        "curve_sigmas": curves.position_sigmas[:, 0].astype(np.float32),
        "radius_sigmas": curves.radius_sigmas[:, 0].astype(np.float32),
    }


def reprojections(
    model: Model, edges: Edges3D, pictured: Sequence[int]
) -> tuple[NDArray[np.uint16], IntArray]:
    """Observations of edge points in the views with pictures.

    Returns:
        (K, 2) pixels in units of width and height over `FULL`, and their (K,) observations,
        thinned evenly to 100,000.
    """
    owners = edges.observations.points
    pixels = np.full((len(owners), 2), np.nan)
    for index in pictured:
        view, rows = model.views[index], np.flatnonzero(edges.observations.views == index)
        projected, _ = view.project(edges.points[owners[rows]])
        pixels[rows] = projected / (view.width, view.height)
    seen = np.flatnonzero(((pixels >= 0) & (pixels <= 1)).all(axis=1))
    step = max(int(np.ceil(len(seen) / 100_000)), 1)
    chosen = seen[::step]
    return np.rint(pixels[chosen] * FULL).astype(np.uint16), chosen
