"""3D edges as tables of pandas."""

import sys

import numpy as np
import pytest

from colmap_edges import ColmapEdgesError, Edges3D, to_pandas
from colmap_edges.core.edges3d import Nodes
from colmap_edges.core.observations import Observations


def tracks(*views):
    """Observations of points, each by the views that are listed."""
    flat = np.array([view for row in views for view in row], np.int32)
    offsets = np.cumsum([0, *map(len, views)])
    return Observations.of_pixels(offsets=offsets, views=flat, pixels=np.zeros((len(flat), 2)))


@pytest.fixture
def edges():
    """An edge from a corner, and a loop."""
    points = np.array([[0, 0, 0], [3, 4, 0], [5, 0, 0], [6, 0, 0], [6, 1, 0], [5, 1, 0]], float)
    return Edges3D(
        points=points,
        edge_offsets=np.array([0, 2, 6]),
        closed=np.array([False, True]),
        observations=tracks((0, 1, 2), (1, 2), (0, 3), (3,), (3, 0), (0, 3, 5, 7)),
        sigmas=np.array([0.1, np.nan, 0.1, 0.1, 0.1, 0.2]),
        end_nodes=np.array([[0, -1], [-1, -1]], np.int32),
        colors=np.arange(18, dtype=np.uint8).reshape(6, 3),
        nodes=Nodes(
            points=points[:1],
            sigmas=np.array([0.01]),
            observations=tracks((0, 1, 2)),
            colors=np.zeros((1, 3), np.uint8),
            through_points=np.array([-1]),
        ),
    )


def test_tables_hold_edges_and_points(edges):
    pytest.importorskip("pandas", reason="tables are made by pandas (extra pandas)")
    tables = to_pandas(edges)
    assert tables.edges.index.name == "edge"
    assert tables.edges.fillna({"first_node": -1, "last_node": -1}).to_dict("list") == {
        "num_points": [2, 4],
        "length": [5.0, 4.0],
        "closed": [False, True],
        "first_node": [0, -1],
        "last_node": [-1, -1],
        "num_views": [3, 4],
    }
    points = tables.points
    assert points.index.name == "point"
    assert np.array_equal(points[["x", "y", "z"]].to_numpy(), edges.points)
    assert points.edge.tolist() == [0, 0, 1, 1, 1, 1]
    assert points.node.isna().tolist() == [False, True, True, True, True, True]
    assert points.num_views.tolist() == [3, 2, 2, 1, 2, 4]
    assert np.array_equal(points[["red", "green", "blue"]].to_numpy(), edges.colors)
    assert points.sigma.isna().sum() == 1
    means = points.groupby("edge").z.mean()
    assert tables.edges.join(means).z.tolist() == [0, 0]


def test_no_edges_are_empty_tables():
    pytest.importorskip("pandas", reason="tables are made by pandas (extra pandas)")
    tables = to_pandas(Edges3D.none())
    assert len(tables.edges) == len(tables.points) == 0
    assert "length" in tables.edges and "x" in tables.points


def test_without_pandas_the_remedy_is_named(edges, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ColmapEdgesError, match=r"run: pip install 'colmap-edges\[pandas\]'"):
        to_pandas(edges)
