import json
from dataclasses import replace

import numpy as np
import pymeshlab
import pytest
import trimesh

from colmap_edges.colmap.model import observation_residuals
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.export.edges import write_obj
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.glb import write_glb
from colmap_edges.export.ply import write_ply
from colmap_edges.export.upright import direction


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
    np.testing.assert_allclose(square_and_line.lengths(), [4, 5])


def test_no_edges_at_all(tmp_path):
    none = Edges3D.none()
    assert none.segments.shape == (0, 2)
    write_ply(none, tmp_path / "edges.ply")
    write_obj(none, tmp_path / "edges.obj")
    write_glb(none, tmp_path / "edges.glb")
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
    wanted = ["g edge_0", "l 1 2", "l 2 3", "l 3 4", "l 4 1", "g edge_1", "l 5 6", "l 6 7"]
    assert [line for line in lines if line[0] in "lg"] == wanted
    assert "# y is up, unit unknown" in lines
    vertices = [list(map(float, line.split()[1:])) for line in lines if line.startswith("v ")]
    np.testing.assert_array_equal(vertices, square_and_line.points[:, [0, 2, 1]] * (1, 1, -1))


def test_meshlab_reads_all_segments_of_an_obj(square_and_line, tmp_path):
    write_obj(square_and_line, tmp_path / "edges.obj", up="y")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "edges.obj"))
    mesh = meshes.current_mesh()
    np.testing.assert_allclose(mesh.vertex_matrix(), square_and_line.points)
    assert sorted(mesh.edge_matrix().tolist()) == sorted(square_and_line.segments.tolist())


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z", (0.3, -0.8, 0.2)])
def test_glb_and_obj_stand_upright_in_one_place(square_and_line, tmp_path, up):
    for suffix, write in {"glb": write_glb, "obj": write_obj}.items():
        write(square_and_line, tmp_path / f"edges.{suffix}", up=up, unit="mm")
    scene = trimesh.load(tmp_path / "edges.glb")
    (path,) = scene.dump()
    lines = (tmp_path / "edges.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    bounds = 0.001 * np.array([vertices.min(axis=0), vertices.max(axis=0)])
    np.testing.assert_allclose(path.bounds, bounds, atol=1e-9)
    heights = square_and_line.points @ direction(up)
    np.testing.assert_allclose(vertices[:, 1], heights, atol=1e-12)
    volumes = [np.linalg.det(p[1:4] - p[4]) for p in (square_and_line.points, vertices)]
    assert volumes[0] == pytest.approx(volumes[1])  # turned, not mirrored


def read_glb(path):
    """The node of a binary glTF with one primitive, its mode, and its arrays by name."""
    data = path.read_bytes()
    assert data[:4] == b"glTF" and int.from_bytes(data[8:12], "little") == len(data)
    json_end = 20 + int.from_bytes(data[12:16], "little")
    document = json.loads(data[20:json_end])
    ((primitive,),) = [mesh["primitives"] for mesh in document["meshes"]]

    def array(index):
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5121: "u1", 5125: "<u4"}[accessor["componentType"]]
        columns = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        start = json_end + 8 + view["byteOffset"]
        found = np.frombuffer(data, kind, columns * accessor["count"], start).reshape(-1, columns)
        assert found.nbytes == view["byteLength"]
        if "min" in accessor:
            assert accessor["min"] == found.min(axis=0).tolist()
            assert accessor["max"] == found.max(axis=0).tolist()
        return found

    arrays = {name: array(index) for name, index in primitive["attributes"].items()}
    root, node = document["nodes"]
    assert document["scenes"] == [{"nodes": [0]}] and root["children"] == [1]
    return node, primitive["mode"], arrays | {"indices": array(primitive["indices"])[:, 0]}


def test_glb_is_one_set_of_lines_with_colours_and_edges(square_and_line, tmp_path):
    write_glb(square_and_line, tmp_path / "edges.glb")
    node, mode, arrays = read_glb(tmp_path / "edges.glb")
    assert mode == 1 and "translation" not in node
    assert arrays["indices"].reshape(-1, 2).tolist() == square_and_line.segments.tolist()
    np.testing.assert_array_equal(arrays["POSITION"], square_and_line.points)
    wanted = 4 * [[200, 100, 50, 255]] + 3 * [[9, 9, 9, 255]]
    assert arrays["COLOR_0"].tolist() == wanted
    assert arrays["_EDGE_ID"][:, 0].tolist() == [0, 0, 0, 0, 1, 1, 1]


def test_trimesh_reads_glb_far_from_the_origin(square_and_line, tmp_path):
    offset = np.array([4358067.1, 506612.2, 4614943.3])
    points = square_and_line.points / 100 + offset
    write_glb(replace(square_and_line, points=points), tmp_path / "edges.glb")
    node, _, arrays = read_glb(tmp_path / "edges.glb")
    np.testing.assert_allclose(arrays["POSITION"] + node["translation"], points, atol=1e-8, rtol=0)
    scene = trimesh.load(tmp_path / "edges.glb")
    (path,) = scene.dump()
    np.testing.assert_allclose(np.sort(path.vertices[:, 1]), np.sort(points[:, 2]), atol=1e-8)


@pytest.mark.parametrize(("scale", "offset"), [(1e-9, 0.0), (1e7, 0.0), (1.0, 4.5e6)])
def test_text_keeps_points_at_any_scale(square_and_line, tmp_path, scale, offset):
    points = square_and_line.points / 3 * scale + offset
    edges = replace(square_and_line, points=points)
    write_obj(edges, tmp_path / "edges.obj", up="y")
    lines = (tmp_path / "edges.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    np.testing.assert_allclose(vertices, points, rtol=1e-11, atol=0)


def test_json_says_what_each_edge_is(scene_model, scene_edges, tmp_path):
    ids = 1000 + np.arange(scene_edges.num_points)
    residuals = observation_residuals(scene_model, scene_edges)
    curves = fit_curves(scene_edges)
    write_json(scene_edges, curves, scene_model, ids, residuals, tmp_path / "edges.json")
    records = json.loads((tmp_path / "edges.json").read_text())["edges"]
    assert [r["id"] for r in records] == list(range(scene_edges.num_edges))
    assert [i for r in records for i in r["point3D_ids"]] == ids.tolist()
    assert [r["closed"] for r in records] == scene_edges.closed.tolist()
    np.testing.assert_allclose([r["length"] for r in records], scene_edges.lengths())
    # Noise of 0.3 px in x and y: the mean distance is 0.3 sqrt(pi / 2) = 0.376 px.
    assert np.mean([r["residual_px"] for r in records]) == pytest.approx(0.376, abs=0.02)
    known = {view.image_id for view in scene_model.views}
    assert all(set(r["image_ids"]) <= known and r["num_views"] >= 5 for r in records)
