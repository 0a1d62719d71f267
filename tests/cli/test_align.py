"""The command `align`: a run in another frame, read back by pycolmap and other libraries."""

import json
import shutil
from dataclasses import replace

import cv2
import ezdxf
import numpy as np
import pycolmap
import pytest
import trimesh
from click.testing import CliRunner

import colmap_edges
from colmap_edges.cli.main import cli
from colmap_edges.colmap.model import load_model, observation_residuals
from colmap_edges.colmap.writing import write_model
from colmap_edges.core.similarity import Similarity, to_z_up
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.alignment import ground_of
from colmap_edges.export.dxf import write_dxf
from colmap_edges.export.edges import write_obj
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.faces import write_faces
from colmap_edges.export.meshes import read_mesh, write_mesh
from colmap_edges.export.ply import read_ply, write_ply
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.mesh import Texture

# The frame of the run: an upright scene turned over, as that of a first camera, and far away.
GIVEN = Similarity(
    scale=1.0,
    rotation=to_z_up(np.array([0.1, -0.9, 0.3])).T,
    translation=np.array([4358067.1, 506612.2, 4614943.3]),
)


@pytest.fixture(scope="module")
def ground():
    """The ground: a square at a height of -0.3 in the upright scene, and a ceiling."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    return [
        Face(
            normal=np.array([0.0, 0.0, sign]),
            offset=sign * height,
            area=area,
            outline=square + np.array([0, 0, height]),
            holes=(),
            views=np.array([0, 1]),
            plane=plane,
        )
        for plane, (sign, height, area) in enumerate([(1.0, -0.3, 4.0), (-1.0, 2.0, 9.0)])
    ]


@pytest.fixture(scope="module")
def run(scene_model, scene_edges, ground, tmp_path_factory):
    """An output folder in a frame that is neither upright nor near the origin."""
    from colmap_edges.colmap.writing import write_moved
    from colmap_edges.export.alignment import moved_face, moved_mesh

    folder = tmp_path_factory.mktemp("run")
    frame = (GIVEN.scale, GIVEN.rotation, GIVEN.translation)
    write_moved(scene_model.reconstruction, *frame, folder / "given")
    model, edges = load_model(folder / "given"), GIVEN.edges(scene_edges)
    shutil.rmtree(folder / "given")
    residuals = observation_residuals(model, edges)
    ids = write_model(model, edges, folder / "sparse", "BIN", residuals)
    curves = fit_curves(edges)
    write_json(edges, curves, model, ids, residuals, folder / "edges.json")
    write_ply(edges, folder / "edges.ply")
    write_obj(edges, folder / "edges.obj")
    write_dxf(curves, folder / "edges.dxf")
    write_faces([moved_face(face, GIVEN) for face in ground], model, folder / "faces.json")
    box = trimesh.creation.box()
    mesh = colmap_edges.Mesh(
        vertices=np.array(box.vertices),
        faces=np.array(box.faces, np.int32),
        point3D_ids=np.full(8, -1),
        colors=np.full((8, 3), 77, np.uint8),
    )
    for name in ("mesh.ply", "mesh.glb"):
        write_mesh(moved_mesh(mesh, GIVEN), folder / name)
    return folder


def align(run, output, *flags):
    arguments = ["align", "--run_path", run, "--output_path", output, *flags]
    return CliRunner().invoke(cli, list(map(str, arguments)))


def test_everything_gets_upright_to_scale_and_onto_the_ground(
    run, scene_edges, tmp_path, hash_folder
):
    before = hash_folder(run)
    length = scene_edges.lengths()[2]
    flags = ("--edge_length", f"2={5 * length}", "--unit", "cm", "--ground")
    done = align(run, tmp_path / "out", *flags)
    assert done.exit_code == 0, done.output
    assert hash_folder(run) == before
    written = colmap_edges.read_edges(tmp_path / "out")
    # Heights above the ground are those of the upright scene, five times as large.
    heights = 5 * (scene_edges.points[:, 2] + 0.3)
    np.testing.assert_allclose(written.edges.points[:, 2], heights, atol=1e-7)
    np.testing.assert_allclose(written.edges.lengths(), 5 * scene_edges.lengths())
    np.testing.assert_allclose(written.edges.sigmas, 5 * scene_edges.sigmas, rtol=0.01)
    np.testing.assert_allclose(written.curves.lengths().sum(), fivefold_length(scene_edges))
    floor = max(written.faces, key=lambda face: face.normal[2])
    np.testing.assert_allclose([*floor.normal, floor.offset], [0, 0, 1, 0], atol=1e-6)
    assert floor.area == pytest.approx(100)
    # The model is moved with the edges: each point is observed where it was.
    residuals = observation_residuals(written.model, written.edges)
    assert np.sqrt((residuals**2).mean()) < 0.6
    reconstruction = pycolmap.Reconstruction(tmp_path / "out" / "sparse")
    point = reconstruction.points3D[int(written.point3D_ids[7])].xyz
    np.testing.assert_allclose(point, written.edges.points[7], atol=1e-9)
    check_files(tmp_path / "out", written.edges)


def fivefold_length(edges):
    """Five times the total length of the curves of the upright scene."""
    return 5 * fit_curves(edges).lengths().sum()


def check_files(out, edges):
    """The further files are those of the run, in the same frame."""
    names = {path.name for path in out.iterdir()}
    expected = {"edges.ply", "edges.obj", "edges.dxf", "mesh.ply", "mesh.glb", "sparse"}
    assert names == expected | {"edges.json", "faces.json", "report.json", "alignment.json"}
    vertices = read_ply(out / "edges.ply")["vertex"]
    np.testing.assert_allclose(vertices["z"], edges.points[:, 2])
    assert ezdxf.readfile(out / "edges.dxf").header["$INSUNITS"] == 5  # centimetres
    meshes = [read_mesh(out / name).vertices for name in ("mesh.ply", "mesh.glb")]
    np.testing.assert_allclose(*meshes, atol=1e-4)
    assert np.ptp(meshes[0][:, 2]) == pytest.approx(5, rel=1e-5)
    scene = trimesh.load(out / "mesh.glb")  # in metres
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0)[1], 0.05, rtol=1e-4)


def test_textures_are_kept(run, tmp_path):
    shutil.copytree(run, tmp_path / "run")
    mesh = read_mesh(run / "mesh.ply")
    jpeg = cv2.imencode(".jpg", np.full((8, 8, 3), 90, np.uint8))[1].tobytes()
    corners = np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3)
    points = np.random.default_rng(0).uniform(0, 1, (corners.size, 2))
    texture = Texture(jpeg=jpeg, points=points, corners=corners)
    for name in ("mesh.glb", "mesh.obj"):
        write_mesh(replace(mesh, texture=texture), tmp_path / "run" / name)
    done = align(tmp_path / "run", tmp_path / "out", "--scale", "2")
    assert done.exit_code == 0, done.output
    for name in ("mesh.glb", "mesh.obj"):
        found = read_mesh(tmp_path / "out" / name)
        assert found.texture.jpeg == jpeg
        at = found.texture.points[found.texture.corners]
        np.testing.assert_allclose(at, points[corners], atol=1e-6)
    assert read_mesh(tmp_path / "out" / "mesh.ply").texture is None


def test_the_ground_is_the_plane_with_most_area(ground):
    up = np.array([0.0, 0.0, 1.0])
    floor, ceiling = ground
    table = replace(floor, plane=7, area=5.0, offset=1.0)
    assert ground_of([ceiling, floor, table], up) is table
    pieces = [replace(floor, area=area) for area in (1.0, 3.0, 2.0)]
    assert ground_of([table, *pieces], up) is pieces[1]
    with pytest.raises(ColmapEdgesError, match="run mesh with --use_faces 1"):
        ground_of([ceiling], up)


def test_an_aligned_run_is_aligned_again_and_converted(run, tmp_path):
    first = align(run, tmp_path / "m", "--up", "auto", "--scale", "2", "--unit", "m")
    assert first.exit_code == 0, first.output
    second = align(tmp_path / "m", tmp_path / "mm", "--unit", "mm")
    assert second.exit_code == 0 and "Scale:    1000, unit mm" in second.output
    record = json.loads((tmp_path / "mm" / "alignment.json").read_text())
    assert record["scale"] == pytest.approx(2000)
    moved = Similarity(
        scale=record["scale"],
        rotation=np.array(record["rotation"]),
        translation=np.array(record["translation"]),
    )
    original = colmap_edges.read_edges(run).edges.points
    found = colmap_edges.read_edges(tmp_path / "mm").edges.points
    np.testing.assert_allclose(found, moved.points(original), rtol=1e-12)
    again = align(tmp_path / "m", tmp_path / "mm", "--scale", "3")
    assert again.exit_code == 1 and "add --overwrite" in again.output
    again = align(tmp_path / "m", tmp_path / "mm", "--scale", "3", "--overwrite")
    assert again.exit_code == 0 and "unit unknown" in again.output


def test_bad_requests_are_one_line(run, tmp_path):
    for flags, message in {
        (): "nothing to do; give --up, --ground, --scale, --edge_length or --unit",
        ("--edge_length", "999=1"): "edge_length names edge 999, but there are edges 0 to",
    }.items():
        done = align(run, tmp_path / "out", *flags)
        assert done.exit_code in (1, 2) and message in done.output, done.output
        assert not (tmp_path / "out").exists()
    done = align(run, run / "out", "--up", "z")
    assert done.exit_code == 1 and "inside or around" in done.output
    done = align(run / "sparse", tmp_path / "out", "--up", "z")
    assert done.exit_code == 1 and "holds no edges.json" in done.output
    shutil.copytree(run, tmp_path / "run")
    (tmp_path / "run" / "alignment.json").write_text('{"unit": "m"}')
    done = align(tmp_path / "run", tmp_path / "out", "--up", "z")
    assert done.exit_code == 1 and "alignment.json is damaged" in done.output
