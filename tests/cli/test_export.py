"""The command `export`: written files and outputs of runs are read back."""

import json
import os
import re
import shutil
import sys

import ezdxf
import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

import colmap_edges
from colmap_edges.cli.main import cli
from colmap_edges.colmap.model import observation_residuals
from colmap_edges.colmap.writing import write_model
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.formats import FORMATS, check_formats, formats_of
from colmap_edges.export.ply import read_ply
from colmap_edges.pipeline.write import export_stage
from colmap_edges.runtime.ownership import file_sizes
from colmap_edges.runtime.stages import Stages

Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def run_path(scene_model, scene_edges, tmp_path_factory):
    """What a run leaves of edges."""
    folder = tmp_path_factory.mktemp("run")
    residuals = observation_residuals(scene_model, scene_edges)
    ids = write_model(scene_model, scene_edges, folder / "sparse", "BIN", residuals)
    curves = fit_curves(scene_edges)
    write_json(scene_edges, curves, scene_model, ids, residuals, folder / "edges.json")
    return folder


def export(*arguments):
    return CliRunner().invoke(cli, ["export", *map(str, arguments)])


def test_edges_are_read_back_as_they_were_written(run_path, scene_edges):
    read = colmap_edges.read_edges(run_path)
    found = read.edges
    np.testing.assert_allclose(found.points, scene_edges.points, rtol=1e-12)
    np.testing.assert_array_equal(found.edge_offsets, scene_edges.edge_offsets)
    np.testing.assert_array_equal(found.closed, scene_edges.closed)
    np.testing.assert_array_equal(found.end_nodes, scene_edges.end_nodes)
    np.testing.assert_array_equal(found.observations.offsets, scene_edges.observations.offsets)
    known = np.isfinite(scene_edges.sigmas)
    np.testing.assert_allclose(found.sigmas[known], scene_edges.sigmas[known], rtol=0.006)
    curves = fit_curves(scene_edges)
    np.testing.assert_array_equal(read.curves.kinds, curves.kinds)
    np.testing.assert_allclose(read.curves.ends(), curves.ends(), atol=1e-9)
    np.testing.assert_array_equal(np.isin(read.point3D_ids, read.model.point3D_ids), True)


@pytest.mark.parametrize("name", ["a.dxf", "a.glb", "a.obj", "a.ply", "a.svg", "b/c.step"])
def test_every_format_is_written(run_path, scene_model, tmp_path, name):
    if name.endswith("step"):
        pytest.importorskip("OCP", reason="STEP files are written by OpenCASCADE (extra step)")
    svg = ("--svg", scene_model.views[1].name) if name.endswith("svg") else ()
    arguments = ("--run_path", run_path, "--output_path", tmp_path / name, *svg)
    done = export(*arguments)
    assert done.exit_code == 0, done.output
    assert (tmp_path / name).stat().st_size > 1000
    *notes, line = done.output.strip().split("\n")
    assert " curves of " in line and len(notes) == name.endswith("step")
    again = export(*arguments)
    assert again.exit_code == 1 and "add --overwrite" in again.output
    assert export(*arguments, "--overwrite").exit_code == 0
    if name.endswith("dxf"):
        curves = colmap_edges.read_edges(run_path).curves
        assert len(ezdxf.readfile(tmp_path / name).modelspace()) == curves.num_curves


def test_curves_that_a_step_file_cannot_hold_are_counted(run_path, tmp_path):
    """The number that is said is that of the file, and a note has the rest."""
    pytest.importorskip("OCP", reason="STEP files are written by OpenCASCADE (extra step)")
    shutil.copytree(run_path, tmp_path / "run")
    record = json.loads((tmp_path / "run" / "edges.json").read_text())
    for line in [curve for curve in record["curves"] if curve["kind"] == "line"][:2]:
        line["end"] = line["start"]
    (tmp_path / "run" / "edges.json").write_text(json.dumps(record))
    done = export("--run_path", tmp_path / "run", "--output_path", tmp_path / "a.step")
    assert done.exit_code == 0, done.output
    count = len(record["curves"])
    assert f"Note: 2 of {count} curves are left out, since they have no length" in done.output
    assert f"\n{count - 2} curves of " in done.output
    text = (tmp_path / "a.step").read_text().replace("\n", "")
    assert text.count("GEOMETRIC_CURVE_SET('edge ") == count - 2


def test_a_run_writes_the_same_files(run_path, scene_model, tmp_path, hash_folder):
    names = formats_of("obj,GLB, dxf,svg,limap,dxf")
    assert names == ["obj", "glb", "dxf", "svg", "limap"]
    run = tmp_path / "run"
    shutil.copytree(run_path, run)
    box = trimesh.creation.box()
    mesh = colmap_edges.Mesh(
        vertices=np.array(box.vertices),
        faces=np.array(box.faces, np.int32),
        point3D_ids=np.full(8, -1),
        colors=np.zeros((8, 3), np.uint8),
    )
    export_stage(run, mesh, names, Stages(), Z)
    places = {"edges.obj", "edges.glb", "edges.dxf", "svg", "structures"}
    made = {path.name for path in run.iterdir()} - {path.name for path in run_path.iterdir()}
    assert made == places | {"mesh.obj", "mesh.glb"}
    assert trimesh.load(run / "mesh.glb", force="mesh").volume == pytest.approx(1)
    pictures = {f"svg/{view.name}.svg" for view in scene_model.views}
    ours, theirs = hash_folder(run), tmp_path / "theirs"
    assert pictures <= set(ours)
    for place in (*places - {"svg"}, min(pictures)):
        more = ("--svg", scene_model.views[0].name) if place in pictures else ()
        done = export("--run_path", run, "--output_path", theirs / place, *more)
        assert done.exit_code == 0, done.output
    written = hash_folder(theirs)
    assert len(written) == 9 and written.items() <= ours.items()


def test_help_names_every_format():
    shown = CliRunner().invoke(cli, ["mesh", "--help"], terminal_width=200).output
    text = " ".join(shown.partition("--export")[2].partition("--config")[0].split())
    offered = {"ply", *re.findall(r"(\w+)(?:, | \(|$)", text.partition(": ")[2])}
    assert set(FORMATS) <= offered, offered


def test_a_run_without_edges_exports_its_mesh_alone(tmp_path):
    export_stage(tmp_path, None, ["dxf"], Stages(), Z)
    assert not any(tmp_path.iterdir())
    check_formats(["obj", "glb"], has_edges=False)
    with pytest.raises(OptionError, match="export is 'svg' and use_edges 0"):
        check_formats(["obj", "svg"], has_edges=False)


def test_a_missing_cad_kernel_is_said_before_a_run(monkeypatch):
    monkeypatch.setitem(sys.modules, "OCP", None)
    check_formats(["dxf"], has_edges=True)
    with pytest.raises(ColmapEdgesError, match=r"pip install 'colmap-edges\[step\]'"):
        check_formats(["dxf", "step"], has_edges=True)


@pytest.mark.parametrize("name", ["edges.dxf", "cad/part.dxf", "structures"])
def test_exports_may_lie_in_the_folder_of_their_run(run_path, tmp_path, hash_folder, name):
    run = tmp_path / "run"
    shutil.copytree(run_path, run)
    record = {"versions": {"colmap-edges": "1"}, "files": file_sizes(run)}
    (run / "report.json").write_text(json.dumps(record))
    before = hash_folder(run)
    done = export("--run_path", run, "--output_path", run / name)
    assert done.exit_code == 0, done.output
    assert before.items() <= hash_folder(run).items() and (run / name).exists()
    (run / "edges.ply").write_bytes(b"of the run")
    record["files"]["edges.ply"] = 10
    (run / "report.json").write_text(json.dumps(record))
    for own in ("edges.ply", "sparse/part.dxf"):
        done = export("--run_path", run, "--output_path", run / own, "--overwrite")
        assert done.exit_code == 1 and "is a file of the run itself" in done.output
    assert (run / "edges.ply").read_bytes() == b"of the run"


def test_a_measured_edge_scales_all_formats(run_path, scene_edges, tmp_path):
    length = scene_edges.lengths()[3]
    flags = ("--edge_length", "3=2.4", "--unit", "m", "--up", "-z")
    for name in ("a.ply", "a.obj", "a.glb", "a.dxf", "b.dxf"):
        more = ("--polylines",) if name == "b.dxf" else ()
        done = export("--run_path", run_path, "--output_path", tmp_path / name, *flags, *more)
        assert done.exit_code == 0, done.output
    points = scene_edges.points * (1, -1, -1) * 2.4 / length
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply")["vertex"]["z"], points[:, 2])
    (path,) = trimesh.load(tmp_path / "a.glb").dump()
    bounds = np.array([points.min(axis=0), points.max(axis=0)])
    np.testing.assert_allclose(np.sort(path.bounds[:, 1]), bounds[:, 2], atol=1e-6)
    drawing = ezdxf.readfile(tmp_path / "b.dxf")
    assert drawing.header["$INSUNITS"] == 6  # metres
    np.testing.assert_allclose([drawing.header["$EXTMIN"], drawing.header["$EXTMAX"]], bounds)
    polyline = drawing.modelspace()[3]
    assert list(polyline.get_xdata("COLMAP_EDGES"))[1] == (1071, 3)
    at = np.array([tuple(vertex) for vertex in polyline.points()])
    assert np.linalg.norm(np.diff(at, axis=0), axis=1).sum() == pytest.approx(2.4)


def test_lines_go_to_limap_and_come_back(run_path, tmp_path):
    shutil.copytree(run_path / "sparse", tmp_path / "sparse")
    done = export("--run_path", run_path, "--output_path", tmp_path / "structures")
    assert done.exit_code == 0 and " lines in " in done.output
    back = colmap_edges.read_edges(tmp_path)  # as LIMAP leaves it: structures beside a model
    assert (back.point3D_ids == -1).all()
    written = colmap_edges.read_edges(run_path)
    lengths = [found.curves.lengths().sum() for found in (back, written)]
    assert lengths[0] == pytest.approx(lengths[1], rel=0.1)
    named = colmap_edges.read_edges(tmp_path / "structures", run_path / "sparse")
    assert named.edges.num_edges == back.edges.num_edges


def test_bad_requests_are_one_line(run_path, tmp_path):
    asked = {
        ("a.iges",): "cannot write edges as 'a.iges'",
        ("a.svg",): "--svg IMAGE",
        ("a.svg", "--svg", "no.jpg"): "no posed image is named 'no.jpg'",
        ("a.dxf", "--svg", "no.jpg"): "--svg IMAGE",
    }
    for (name, *more), message in asked.items():
        done = export("--run_path", run_path, "--output_path", tmp_path / name, *more)
        assert done.exit_code == 1 and message in done.output, done.output
        assert done.output.strip().count("\n") == 0
    done = export("--run_path", run_path, "--output_path", run_path / "a.dxf")
    assert done.exit_code == 1 and "is inside" in done.output
    (tmp_path / "empty").mkdir()
    done = export("--run_path", tmp_path / "empty", "--output_path", tmp_path / "a.dxf")
    assert done.exit_code == 1 and "give the output folder of a run" in done.output
    for flags, message in {
        ("--edge_length", "99=1"): "edge_length names edge 99, but there are edges 0 to",
        ("--ground",): "ground needs a horizontal face",
    }.items():
        done = export("--run_path", run_path, "--output_path", tmp_path / "a.obj", *flags)
        assert done.exit_code == 1 and message in done.output, done.output
        assert done.output.strip().count("\n") == 0
    given = ("--edge_length", "0=1", "--scale", "2")
    done = export("--run_path", run_path, "--output_path", tmp_path / "a.obj", *given)
    assert done.exit_code == 2 and "--scale and --edge_length are both given" in done.output
    for text in ("1", "1=0", "-1=2", "1=x"):
        done = export("--run_path", run_path, "--edge_length", text, "--output_path", "a.obj")
        assert done.exit_code == 2 and "such as 12=2.40" in done.output
    done = export("--run_path", run_path, "--scale", 2, "--output_path", tmp_path / "structures")
    assert done.exit_code == 2 and "must stay in the frame of its cameras" in done.output


SUFFIXES = ("ply", "obj", "glb", "dxf", "step", "svg")


def files_of(tmp_path, suffix, view):
    """A file to write, and the arguments for its format."""
    if suffix == "step":
        pytest.importorskip("OCP", reason="STEP files are written by OpenCASCADE (extra step)")
    return tmp_path / f"a.{suffix}", ("--svg", view.name) if suffix == "svg" else ()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_links_are_not_written_through(run_path, scene_model, tmp_path, suffix):
    path, more = files_of(tmp_path, suffix, scene_model.views[0])
    victim = tmp_path / "victim"
    path.symlink_to(victim)
    for content in (None, "precious"):
        if content:
            victim.write_text(content)
        for flags in ((), ("--overwrite",)):
            done = export("--run_path", run_path, "--output_path", path, *more, *flags)
            assert done.exit_code == 1 and "it is a link to" in done.output
        assert victim.exists() == bool(content) and path.is_symlink()
    assert victim.read_text() == "precious"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_failed_export_leaves_the_earlier_file(run_path, scene_model, tmp_path, suffix):
    resource = pytest.importorskip("resource", reason="limits of file sizes are POSIX")
    path, more = files_of(tmp_path, suffix, scene_model.views[0])
    path.write_bytes(b"earlier")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
    try:
        done = export("--run_path", run_path, "--output_path", path, *more, "--overwrite")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done.exit_code == 1 and done.output.count("\n") == 1
    assert f"to {path}: File too large" in done.output
    assert path.read_bytes() == b"earlier" and list(tmp_path.iterdir()) == [path]


def test_pipes_and_folders_are_refused(run_path, tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "structures").write_text("precious")
    named = {"pipe.ply": "a pipe", "folder.ply": "a folder", "structures": "a file of that name"}
    for name, what in named.items():
        done = export("--run_path", run_path, "--output_path", tmp_path / name, "--overwrite")
        assert done.exit_code == 1 and what in done.output
    assert (tmp_path / "structures").read_text() == "precious"


@pytest.mark.parametrize("name", ["alltracks.txt", "track_0.txt"])
def test_lines_of_limap_1_are_exported(run_path, scene_model, scene_edges, tmp_path, name):
    shutil.copytree(run_path / "sparse", tmp_path / "limap" / "sparse")
    (tmp_path / "limap" / name).write_text(tracks_of_limap_1(name, scene_model, scene_edges))
    given = [tmp_path / "limap", *([tmp_path / "limap" / name] if name == "alltracks.txt" else [])]
    for number, path in enumerate(given):
        output = tmp_path / f"{number}.dxf"
        done = export("--run_path", path, "--output_path", output)
        assert done.exit_code == 0, done.output
        (line,) = ezdxf.readfile(output).modelspace()
        np.testing.assert_allclose(line.dxf.start, scene_edges.points[0], atol=1e-6)


def tracks_of_limap_1(name, model, edges):
    """The first segment of the edges as a track of LIMAP 1.x, seen twice in the first image."""
    ids = [model.views[0].image_id, model.views[0].image_id, model.views[1].image_id]
    rows = [" ".join(map(str, point)) for point in edges.points[:2].tolist()]
    seen = " ".join(map(str, ids))
    if name == "alltracks.txt":
        return f"1\n0 3 2\n{rows[0]}\n{rows[1]}\n{seen} \n4 5 6 \n"
    return f"{rows[0]} {rows[1]} \n3 2\nimage_id_list {seen} \nline_id_list 4 5 6 \nEND\n"


def test_an_output_without_edges_is_an_error(run_path, tmp_path):
    shutil.copytree(run_path, tmp_path / "run")
    (tmp_path / "run" / "edges.json").write_text('{"edges": [], "nodes": [], "curves": []}')
    done = export("--run_path", tmp_path / "run", "--output_path", tmp_path / "a.glb")
    assert done.exit_code == 1 and "holds no edges" in done.output
