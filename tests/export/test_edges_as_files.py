import json
from dataclasses import replace

import ezdxf
import numpy as np
import pymeshlab
import pytest
import trimesh

from colmap_edges.colmap.model import observation_residuals
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.export.edges import (
    edge_lengths,
    write_dxf,
    write_glb,
    write_json,
    write_obj,
    write_ply,
)


@pytest.fixture
def square_and_line():
    """A closed unit square and an open line of length 5, each point seen in views 0 and 2."""
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 3], [0, 3, 3], [2, 3, 3]], float
    )
    return Edges3D(
        points=points,
        edge_offsets=np.array([0, 4, 7]),
        closed=np.array([True, False]),
        observations=Observations.of_pixels(
            offsets=np.arange(8) * 2,
            views=np.tile(np.array([0, 2], np.int32), 7),
            pixels=np.zeros((14, 2)),
        ),
        sigmas=np.full(7, np.nan),
        end_nodes=np.array([[-1, -1], [4, 5]], np.int32),
        colors=np.repeat(np.array([[200, 100, 50], [9, 9, 9]], np.uint8), [4, 3], axis=0),
    )


def test_segments_close_closed_edges_only(square_and_line):
    expected = [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6]]
    assert square_and_line.segments.tolist() == expected


def test_lengths(square_and_line):
    np.testing.assert_allclose(edge_lengths(square_and_line), [4, 5])


def test_no_edges_at_all(tmp_path):
    none = Edges3D.none()
    assert none.segments.shape == (0, 2)
    write_ply(none, tmp_path / "edges.ply")
    write_obj(none, tmp_path / "edges.obj")
    write_glb(none, tmp_path / "edges.glb")
    write_dxf(none, tmp_path / "edges.dxf")
    assert len(ezdxf.readfile(tmp_path / "edges.dxf").modelspace()) == 0
    assert b"element edge 0" in (tmp_path / "edges.ply").read_bytes()


def test_meshlab_reads_ply(square_and_line, tmp_path):
    write_ply(square_and_line, tmp_path / "edges.ply")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "edges.ply"))
    mesh = meshes.current_mesh()
    np.testing.assert_allclose(mesh.vertex_matrix(), square_and_line.points)
    assert mesh.edge_matrix().tolist() == square_and_line.segments.tolist()
    np.testing.assert_allclose(
        mesh.vertex_color_matrix()[:, :3] * 255, square_and_line.colors, atol=1e-3
    )


def test_obj_names_every_polyline(square_and_line, tmp_path):
    write_obj(square_and_line, tmp_path / "edges.obj")
    lines = (tmp_path / "edges.obj").read_text().splitlines()
    assert [line for line in lines if line.startswith("l ")] == ["l 1 2 3 4 1", "l 5 6 7"]
    vertices = [list(map(float, line.split()[1:])) for line in lines if line.startswith("v ")]
    np.testing.assert_array_equal(vertices, square_and_line.points)


def read_glb_lines(path):
    """Positions (S, 2, 3) and colours (S, 2, 4) of a binary glTF with one mesh of lines."""
    data = path.read_bytes()
    assert data[:4] == b"glTF"
    json_end = 20 + int.from_bytes(data[12:16], "little")
    document = json.loads(data[20:json_end])
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 1  # pairs of vertices are lines
    arrays = []
    for name, kind, columns in (("POSITION", "<f4", 3), ("COLOR_0", "u1", 4)):
        accessor = document["accessors"][primitive["attributes"][name]]
        start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        count = columns * accessor["count"]
        array = np.frombuffer(data, kind, count, json_end + 8 + start)
        arrays.append(array.reshape(-1, 2, columns))
    return arrays


def test_glb_has_every_segment_and_colours(square_and_line, tmp_path):
    write_glb(square_and_line, tmp_path / "edges.glb")
    lines, rgba = read_glb_lines(tmp_path / "edges.glb")
    np.testing.assert_array_equal(lines, square_and_line.points[square_and_line.segments])
    assert rgba[:, 0].tolist() == 4 * [[200, 100, 50, 255]] + 2 * [[9, 9, 9, 255]]
    scene = trimesh.load(tmp_path / "edges.glb")
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [2, 3, 3]])


@pytest.mark.parametrize(("scale", "offset"), [(1e-9, 0.0), (1e7, 0.0), (1.0, 4.5e6)])
def test_text_keeps_points_at_any_scale(square_and_line, tmp_path, scale, offset):
    points = square_and_line.points / 3 * scale + offset
    edges = replace(square_and_line, points=points)
    write_obj(edges, tmp_path / "edges.obj")
    lines = (tmp_path / "edges.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    np.testing.assert_allclose(vertices, points, rtol=1e-11, atol=0)
    write_dxf(edges, tmp_path / "edges.dxf")
    document = ezdxf.readfile(tmp_path / "edges.dxf")
    polylines = document.modelspace().query("POLYLINE")
    found = np.array([tuple(point) for polyline in polylines for point in polyline.points()])
    np.testing.assert_allclose(found, points, rtol=1e-11, atol=0)


def test_dxf_has_a_3d_polyline_an_edge(square_and_line, tmp_path):
    write_dxf(square_and_line, tmp_path / "edges.dxf")
    document = ezdxf.readfile(tmp_path / "edges.dxf")
    square, line = document.modelspace().query("POLYLINE")
    assert not document.audit().errors
    assert square.is_3d_polyline and square.is_closed and not line.is_closed
    for polyline, rows in ((square, slice(0, 4)), (line, slice(4, 7))):
        found = np.array([tuple(point) for point in polyline.points()])
        np.testing.assert_allclose(found, square_and_line.points[rows])


def test_json_says_what_each_edge_is(scene_model, scene_edges, tmp_path):
    ids = 1000 + np.arange(scene_edges.num_points)
    residuals = observation_residuals(scene_model, scene_edges)
    write_json(scene_edges, scene_model, ids, residuals, tmp_path / "edges.json")
    records = json.loads((tmp_path / "edges.json").read_text())["edges"]
    assert [r["id"] for r in records] == list(range(scene_edges.num_edges))
    assert [i for r in records for i in r["point3D_ids"]] == ids.tolist()
    assert [r["closed"] for r in records] == scene_edges.closed.tolist()
    np.testing.assert_allclose([r["length"] for r in records], edge_lengths(scene_edges))
    # Noise of 0.3 px in x and y: the mean distance is 0.3 sqrt(pi / 2) = 0.376 px.
    assert np.mean([r["residual_px"] for r in records]) == pytest.approx(0.376, abs=0.02)
    known = {view.image_id for view in scene_model.views}
    assert all(set(r["image_ids"]) <= known and r["num_views"] >= 5 for r in records)
