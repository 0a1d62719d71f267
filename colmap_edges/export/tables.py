"""3D edges as pandas tables: one of the edges, one of their points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from colmap_edges.core.arrays import IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import extra

if TYPE_CHECKING:
    import pandas


class EdgeTables(NamedTuple):
    """The result of `to_pandas`.

    Attributes:
        edges: one row per edge; the index `edge` is its number.
        points: one row per edge point, in order; the index `point` is its number.
    """

    edges: pandas.DataFrame
    points: pandas.DataFrame


@checked
def to_pandas(edges: Edges3D) -> EdgeTables:
    """The 3D edges as pandas tables.

    Args:
        edges: 3D edges, as returned by `reconstruct` and `read_edges`.

    Returns:
        `edges` with `num_points`, `length` (world units), `closed`, `first_node` and `last_node`
        (numbers in `edges.nodes`, missing at free ends), and `num_views`, the views that observe
        any of its points; `points` with its `edge`, `node` (missing if it is none), `x`, `y`,
        `z` and `sigma` (world units; missing where unknown), `num_views`, and `red`, `green`,
        `blue` (0 to 255).

    Raises:
        ColmapEdgesError: when pandas is not installed.
    """
    frame, column = load_pandas()
    of_points = {
        "edge": edges.edge_ids,
        "node": column(edges.node_ids),
        **dict(zip("xyz", edges.points.T, strict=True)),
        "sigma": edges.sigmas,
        "num_views": np.diff(edges.observations.offsets),
        **dict(zip(("red", "green", "blue"), edges.colors.T, strict=True)),
    }
    of_edges = {
        "num_points": np.diff(edges.edge_offsets),
        "length": edges.lengths(),
        "closed": edges.closed,
        "first_node": column(edges.end_nodes[:, 0]),
        "last_node": column(edges.end_nodes[:, 1]),
        "num_views": edges.num_views,
    }
    return EdgeTables(
        frame(of_edges).rename_axis(index="edge"), frame(of_points).rename_axis(index="point")
    )


def load_pandas() -> tuple[Any, Any]:
    """The table class, and a function that makes integer columns with negatives as missing.

    Raises:
        ColmapEdgesError: when pandas is not installed.
    """
    with extra("to_pandas", "pandas"):
        import pandas

    def column(ids: IntArray) -> Any:
        return pandas.arrays.IntegerArray(ids.astype(np.int64), ids < 0)

    return pandas.DataFrame, column
