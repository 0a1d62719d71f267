"""Where known points of one scene land when other programs open its files.

Blender, FreeCAD and CloudCompare are run if they are on the PATH.
"""

import json
import os
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pymeshlab
import pytest

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.similarity import to_z_up
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.export.alignment import Wanted, aligned, alignment_of, moved_mesh
from colmap_edges.export.formats import FORMATS
from colmap_edges.export.meshes import write_mesh
from colmap_edges.export.written import WrittenEdges
from colmap_edges.surfaces.mesh import Mesh

# Ends of three edges in a scene that is upright and in metres.
POINTS = {"east": (2.0, 0.0, 0.0), "north": (0.0, 3.0, 0.0), "top": (0.0, 0.0, 5.0)}
SEGMENTS = 19  # of each edge
UP = np.array([0.1, -0.9, 0.3])  # in the frame in which the scene is given
TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def folder(scene_model, tmp_path_factory):
    """The scene in all formats, given in another frame at half the size and aligned."""
    folder = tmp_path_factory.mktemp("files")
    turn = to_z_up(UP).T / 2
    steps = np.linspace(0, 1, SEGMENTS + 1)[:, None]
    lines = [(steps * point) @ turn.T for point in POINTS.values()]
    edges = Edges3D.of_polylines(np.concatenate(lines), np.full(3, SEGMENTS + 1))
    ids = np.full(edges.num_points, -1)
    curves = fit_curves(edges)
    given = WrittenEdges(
        edges=edges, curves=curves, point3D_ids=ids, model=scene_model, faces=[], round_faces=[]
    )
    views = [replace_rotation(view, turn) for view in scene_model.views]
    given = replace(given, model=replace(scene_model, views=tuple(views)))
    alignment = alignment_of(given, Wanted(up="auto", edge_length=(2, 5.0), unit="m"))
    up, unit = alignment.up, alignment.unit
    for name in ("ply", "obj", "glb", "dxf", "step"):
        if name == "step":
            pytest.importorskip("OCP", reason="STEP files are written by OpenCASCADE (extra step)")
        place, write = FORMATS[name]
        write(aligned(given, alignment.aligned_from_model), folder / place, True, up, unit)
    corners = np.array([(0, 0, 0), *POINTS.values()]) @ turn.T
    mesh = Mesh(
        vertices=corners,
        faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32),
        point3D_ids=np.full(4, -1),
        colors=np.full((4, 3), 200, np.uint8),
    )
    for suffix in ("ply", "obj", "glb"):
        moved = moved_mesh(mesh, alignment.aligned_from_model)
        write_mesh(moved, folder / f"mesh.{suffix}", up=up, unit=unit)
    return folder


def replace_rotation(view, turn):
    """A view whose upward direction is that of the given frame."""

    class Turned:
        rotation = np.stack([2 * turn[:, 0], -2 * turn[:, 2], 2 * turn[:, 1]])

    return Turned()


def program(name):
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def told(command, **environment):
    """The lines of JSON that a program prints."""
    given = {name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ}
    done = subprocess.run(
        list(map(str, command)),
        env=given | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    assert lines, done.stdout + done.stderr
    return [json.loads(line) for line in lines]


def check_points(found):
    """The named points are among the (N, 3) found ones."""
    for name, point in POINTS.items():
        gap = np.linalg.norm(np.array(found) - point, axis=1).min()
        assert gap < TOLERANCE, (name, gap)


BLENDER = """
import bpy, json, sys
from pathlib import Path
folder = Path(sys.argv[-1])
def new(importer, old):  # importers of other versions have other names
    group, _, name = importer.partition(".")
    found = getattr(getattr(bpy.ops, group), name)
    try:
        found.get_rna_type()
        return found
    except KeyError:
        group, _, name = old.partition(".")
        return getattr(getattr(bpy.ops, group), name)
READERS = {"obj": ("wm.obj_import", "import_scene.obj"),
           "ply": ("wm.ply_import", "import_mesh.ply"),
           "glb": ("import_scene.gltf", "import_scene.gltf")}
for name in ("edges", "mesh"):
    for suffix, names in READERS.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        new(*names)(filepath=str(folder / f"{name}.{suffix}"))
        bpy.context.view_layer.update()
        objects = [o for o in bpy.data.objects if o.type == "MESH"]
        points = [list(o.matrix_world @ v.co) for o in objects for v in o.data.vertices]
        print(json.dumps({"file": f"{name}.{suffix}", "points": points,
                          "segments": sum(len(o.data.edges) for o in objects),
                          "faces": sum(len(o.data.polygons) for o in objects)}))
"""


def test_blender_has_all_files_upright_in_one_place(folder, tmp_path):
    (tmp_path / "open.py").write_text(BLENDER)
    command = [program("blender"), "-b", "--factory-startup", "-P", tmp_path / "open.py"]
    opened = told([*command, "--", folder])
    assert len(opened) == 6
    for file in opened:
        check_points(file["points"])
        is_mesh = file["file"].startswith("mesh")
        wanted = (6, 4) if is_mesh else (3 * SEGMENTS, 0)
        assert (file["segments"], file["faces"]) == wanted, file["file"]


FREECAD = """
import json, os
import FreeCAD, Import
document = FreeCAD.newDocument("opened")
Import.insert(os.environ["STEP_FILE"], document.Name)
edges = [e for o in document.Objects if hasattr(o, "Shape") for e in o.Shape.Edges]
points = [[p.X, p.Y, p.Z] for e in edges for p in e.Vertexes]
print()
print(json.dumps({"points": points, "lengths": [e.Length for e in edges]}), flush=True)
"""


def test_freecad_has_millimetres(folder, tmp_path):
    (tmp_path / "open.py").write_text(FREECAD)
    command = [program("freecadcmd"), tmp_path / "open.py"]
    (opened,) = told(command, STEP_FILE=str(folder / "edges.step"))
    check_points(np.array(opened["points"]) / 1000)
    np.testing.assert_allclose(sorted(opened["lengths"]), [2000, 3000, 5000], rtol=1e-6)


@pytest.mark.parametrize("name", ["edges.obj", "edges.ply", "mesh.obj", "mesh.ply"])
def test_cloudcompare_takes_files_as_they_are(folder, tmp_path, name):
    """It knows no upward axis: y is up in OBJ files, z in PLY files."""
    target = tmp_path / "cloud.asc"
    command = [program("CloudCompare"), "-SILENT", "-AUTO_SAVE", "OFF", "-C_EXPORT_FMT", "ASC"]
    command += ["-O", folder / name]
    command += ["-EXTRACT_VERTICES"] if name.startswith("mesh") else []
    command += ["-SAVE_CLOUDS", "FILE", target]
    environment = os.environ | {"QT_QPA_PLATFORM": "offscreen"}
    subprocess.run(command, env=environment, check=False, capture_output=True, timeout=120)
    points = np.loadtxt(target)[:, :3]
    check_points(points if name.endswith("ply") else points[:, [0, 2, 1]] * (1, -1, 1))


@pytest.mark.parametrize("name", ["edges.obj", "edges.ply", "mesh.obj", "mesh.ply"])
def test_meshlab_has_all_segments(folder, name):
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(folder / name))
    mesh = meshes.current_mesh()
    points = mesh.vertex_matrix()
    check_points(points if name.endswith("ply") else points[:, [0, 2, 1]] * (1, -1, 1))
    if name.startswith("edges"):
        assert mesh.edge_number() == 3 * SEGMENTS
    else:
        assert mesh.face_number() == 4
