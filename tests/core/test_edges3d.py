"""3D edges as a person at a prompt uses them."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import colmap_edges
from colmap_edges.core.edges3d import Edges3D, Nodes
from colmap_edges.core.observations import Observations


@pytest.fixture
def edges():
    """A closed square, and two lines that meet at a node, through which the first passes."""
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5], [5, 5, 8], [5, 5, 8], [5, 9, 8]],
        float,
    )
    observations = Observations.of_pixels(
        offsets=np.arange(9) * 2,
        views=np.tile(np.array([0, 2], np.int32), 8),
        pixels=np.arange(32.0).reshape(16, 2),
    )
    nodes = Nodes(
        points=np.array([[9.0, 9, 9], [5, 5, 8]]),
        sigmas=np.array([0.5, 0.1]),
        observations=Observations.of_pixels(
            np.array([0, 0, 1]), np.array([2], np.int32), np.ones((1, 2))
        ),
        colors=np.zeros((2, 3), np.uint8),
        through_points=np.array([-1, 2]),
    )
    edges = Edges3D.of_polylines(points, np.array([4, 2, 2]), observations)
    ends = np.array([[-1, -1], [-1, 1], [1, -1]], np.int32)
    edges = replace(edges, closed=np.array([True, False, False]), nodes=nodes, end_nodes=ends)
    edges.check()
    return edges


def test_repr_is_one_line(edges):
    assert repr(edges) == "<Edges3D: 3 edges of 8 points, total length 11, 2 nodes>"
    assert repr(colmap_edges.Curves3D.none()) == "<Curves3D: none>"
    assert repr(Edges3D.none()) == "<Edges3D: 0 edges of 0 points, total length 0, 0 nodes>"


def test_lengths_and_polylines(edges):
    assert edges.lengths().tolist() == [4, 3, 4]
    lines = edges.polylines()
    assert [len(line) for line in lines] == [5, 2, 2]
    assert lines[0][-1].tolist() == [0, 0, 0]
    steps = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines]
    assert steps == edges.lengths().tolist()
    assert Edges3D.none().polylines() == [] and Edges3D.none().lengths().shape == (0,)


def test_observations_of_an_edge(edges):
    found = edges.observations_of(1)
    assert found.pixels.tolist() == edges.observations.pixels[8:12].tolist()
    assert found.offsets.tolist() == [0, 2, 4]
    with pytest.raises(colmap_edges.ColmapEdgesError, match="edge"):
        edges.observations_of(3)


@pytest.mark.parametrize(
    "chosen", [1, -2, slice(1, 2), [1], np.array([False, True, False]), np.int64(1)]
)
def test_edges_are_chosen_as_rows_of_numpy(edges, chosen):
    found = edges[chosen]
    found.check()
    assert found.points.tolist() == [[5, 5, 5], [5, 5, 8]]
    assert found.end_nodes.tolist() == [[-1, 0]]
    assert found.nodes.points.tolist() == [[5, 5, 8]]
    assert found.nodes.through_points.tolist() == [-1]  # on an edge that is not chosen
    assert found.nodes.observations.offsets.tolist() == [0, 1]
    np.testing.assert_array_equal(found.observations.pixels, edges.observations_of(1).pixels)


def test_chosen_edges_keep_what_joins_them(edges):
    both = edges[[2, 0, 1]]
    both.check()
    assert both.end_nodes.tolist() == [[0, -1], [-1, -1], [-1, 0]]
    assert both.nodes.through_points.tolist() == [4]  # the third point of the square
    assert both.closed.tolist() == [False, True, False]
    assert [len(edge) for edge in edges] == [1, 1, 1]
    assert len(edges) == 3 and not Edges3D.none()
    assert len(edges[[]]) == 0
    with pytest.raises(IndexError):
        edges[3]


def test_public_names_are_listed():
    command = "import colmap_edges; print(*dir(colmap_edges))"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True)
    assert done.stdout.split() == sorted(colmap_edges.__all__)
    writers = {name for name in colmap_edges.__all__ if name.startswith("write_")}
    wanted = {"dxf", "dxf_polylines", "glb", "json", "mesh", "obj", "ply", "step", "structures"}
    assert writers == {f"write_{name}" for name in wanted | {"svg"}}
    assert all(hasattr(colmap_edges, name) for name in colmap_edges.__all__)


def test_writers_take_strings(edges, tmp_path):
    for name in ("write_ply", "write_obj", "write_glb"):
        getattr(colmap_edges, name)(edges, str(tmp_path / name))
    colmap_edges.write_dxf(colmap_edges.Curves3D.none(), str(tmp_path / "write_dxf"))
    colmap_edges.write_dxf_polylines(edges, str(tmp_path / "write_dxf_polylines"), unit="m")
    assert len(list(tmp_path.iterdir())) == 5
