"""Checks of arrays that come from files: types and shapes, offsets and indices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import IntArray, flattened
from colmap_edges.core.edges3d import Edges3D, Nodes
from colmap_edges.core.observations import Observations


def check_like(arrays: Mapping[str, NDArray[Any]], example: Any, prefix: str = "") -> None:
    """Check that arrays have the names, types and row shapes of a dataclass of arrays.

    Args:
        arrays: the arrays by dotted name, as of `flattened`; it may hold others, too.
        example: a record of the dataclass, with any number of rows.
        prefix: prefix of its names in `arrays`.

    Raises:
        ValueError: naming an array that does not.
    """
    for name, like in flattened(example, prefix).items():
        found = arrays.get(name)
        check(found is not None and found.dtype == like.dtype, name)
        check(found is not None and found.shape[1:] == like.shape[1:], name)
        check(found is not None and found.ndim == like.ndim, name)


def check(holds: bool, name: str) -> None:
    """Raise a ValueError that names an array unless a condition holds."""
    if not holds:
        raise ValueError(f"the array {name} is not valid")


def check_rows(record: Any, names: str, count: int) -> None:
    """Check that the named arrays of a record have `count` rows and no infinite values.

    Raises:
        ValueError: naming one that does not.
    """
    for name in names.split():
        values = getattr(record, name)
        check(len(values) == count and not np.isinf(values).any(), name)


def check_finite(record: Any, names: str) -> None:
    """Check that the named arrays of a record hold finite values.

    Raises:
        ValueError: naming one that does not.
    """
    for name in names.split():
        check(bool(np.isfinite(getattr(record, name)).all()), name)


def check_offsets(offsets: IntArray, count: int, least: int, name: str) -> None:
    """Check that offsets (CSR) divide `count` entries into rows of at least `least` entries.

    Raises:
        ValueError: naming the array if they do not.
    """
    check(len(offsets) > 0 and offsets[0] == 0 and offsets[-1] == count, name)
    check(bool((np.diff(offsets) >= least).all()), name)


def check_indices(values: NDArray[np.integer[Any]], low: int, end: int, name: str) -> None:
    """Check that indices are from `low` to below `end`.

    Raises:
        ValueError: naming the array if they are not.
    """
    check(not values.size or (int(values.min()) >= low and int(values.max()) < end), name)


def check_edges(edges: Edges3D, num_views: int) -> None:
    """Check that the offsets and indices of 3D edges lead into their arrays, and `num_views` views.

    Raises:
        ValueError: naming an array that is not valid.
    """
    count, num_nodes = edges.num_points, len(edges.nodes.points)
    check_offsets(edges.edge_offsets, count, 1, "edge_offsets")
    check(len(edges.edge_offsets) == edges.num_edges + 1, "closed")
    check_rows(edges, "points sigmas colors", count)
    check_rows(edges, "end_nodes", edges.num_edges)
    check_finite(edges, "points")
    without_points = np.iinfo(np.int32).max  # ids of nodes that have no points
    check_indices(edges.end_nodes, -1, num_nodes or without_points, "end_nodes")
    check_observations(edges.observations, count, num_views)
    check_nodes(edges.nodes, count, num_views)


def check_nodes(nodes: Nodes, num_points: int, num_views: int) -> None:
    """As `check_edges`, for the nodes of edges with `num_points` points."""
    check_rows(nodes, "points sigmas colors through_points", len(nodes.points))
    check_finite(nodes, "points")
    check_indices(nodes.through_points, -1, num_points, "through_points")
    check_observations(nodes.observations, len(nodes.points), num_views)


def check_observations(observations: Observations, num_points: int, num_views: int) -> None:
    """As `check_edges`, for the observations of `num_points` points."""
    count = len(observations.views)
    check(len(observations.offsets) == num_points + 1, "offsets")
    check_offsets(observations.offsets, count, 0, "offsets")
    check_rows(observations, "positions chains pixels normals", count)
    check_finite(observations, "pixels")
    check_indices(observations.views, 0, num_views, "views")
    check_indices(observations.chains, -1, np.iinfo(np.int32).max, "chains")
