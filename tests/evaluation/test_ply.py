"""PLY files of other programs, damaged ones, and meshes that files turn upright."""

import numpy as np
import pytest

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.raycasting import load_mesh
from colmap_edges.evaluation.readers.curves import load_curves
from colmap_edges.export.meshes import write_mesh
from colmap_edges.export.ply import read_ply
from colmap_edges.surfaces.mesh import Mesh

VERTICES = np.array([(0, 0, 0), (1, 2, 3), (4, 5, 6)], ">f4")
HEADER = """ply
format {}
comment made by hand
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
element edge 2
property int vertex1
property int vertex2
property uchar red
end_header
"""


def big_endian() -> bytes:
    face = bytes([3]) + np.arange(3, dtype=">i4").tobytes()
    edges = b"".join(np.array(pair, ">i4").tobytes() + b"\x07" for pair in ((0, 1), (1, 2)))
    return HEADER.format("binary_big_endian 1.0").encode() + VERTICES.tobytes() + face + edges


def text() -> bytes:
    rows = ("0 0 0", "1 2 3", "4 5 6", "3 0 1 2", "0 1 7", "1 2 7", "")
    return (HEADER.format("ascii 1.0") + "\n".join(rows)).encode()


@pytest.mark.parametrize("content", [big_endian(), text()], ids=["binary", "text"])
def test_edges_are_found_behind_faces(tmp_path, content):
    (tmp_path / "edges.ply").write_bytes(content)
    found = load_curves(tmp_path / "edges.ply")
    np.testing.assert_array_equal(found.points, VERTICES)
    assert found.segments.tolist() == [[0, 1], [1, 2]]
    elements = read_ply(tmp_path / "edges.ply")
    assert elements["edge"]["red"].tolist() == [7, 7]
    assert elements["face"]["vertex_indices"][0].tolist() == [0, 1, 2]


def test_arrays_stay_valid_after_the_file_is_deleted(tmp_path):
    path = tmp_path / "edges.ply"
    path.write_bytes(big_endian())
    vertices = read_ply(path)["vertex"]
    path.write_bytes(b"")
    assert vertices["z"].tolist() == [0, 3, 6]


def test_no_edges_is_no_damage(tmp_path):
    header = HEADER.replace("edge 2", "edge 0").replace("face 1", "face 0")
    content = header.format("binary_big_endian 1.0").encode() + VERTICES.tobytes()
    (tmp_path / "edges.ply").write_bytes(content)
    found = load_curves(tmp_path / "edges.ply")
    assert found.points.shape == (3, 3)
    assert found.segments.shape == (0, 2)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"solid box",
        big_endian()[:40],
        big_endian()[:-1],
        text()[:-4],
        text().replace(b"vertex 3", b"vertex 999999999999999"),
        big_endian().replace(b"float z", b"quad z"),
        text().replace(b"1 2 3\n4", b"1 two 3\n4"),
        text().replace(b"4 5 6", b"1e999 5 6"),
        text().replace(b"1 2 7", b"1 3 7"),
        text().replace(b"vertex2", b"v2"),
    ],
)
def test_damage_is_one_line_that_names_the_file(tmp_path, content):
    (tmp_path / "edges.ply").write_bytes(content)
    with pytest.raises(ColmapEdgesError, match=r"edges\.ply") as caught:
        load_curves(tmp_path / "edges.ply")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb"])
@pytest.mark.parametrize("up", ["z", "-y", (0.1, -0.7, 0.4)])
def test_meshes_are_evaluated_in_the_frame_of_the_model(tmp_path, suffix, up):
    """Whatever way is up in their files."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], float)
    mesh = Mesh(
        vertices=corners,
        faces=np.array([[0, 1, 2], [0, 1, 3]], np.int32),
        point3D_ids=np.full(4, -1),
        colors=np.zeros((4, 3), np.uint8),
    )
    write_mesh(mesh, tmp_path / f"mesh.{suffix}", up=up, unit="mm")
    read = load_mesh(tmp_path / f"mesh.{suffix}")
    np.testing.assert_allclose(read.vertices, corners, atol=1e-6)
    np.testing.assert_array_equal(read.faces, mesh.faces)
