"""The command `export`: written files and outputs of runs are read back."""

import shutil

import ezdxf
import numpy as np
import pytest
from click.testing import CliRunner

import colmap_edges
from colmap_edges.cli.main import cli
from colmap_edges.colmap.model import observation_residuals
from colmap_edges.colmap.writing import write_model
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.export.edges import write_json


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
    assert " curves of " in done.output and "\n" not in done.output.strip()
    again = export(*arguments)
    assert again.exit_code == 1 and "add --overwrite" in again.output
    assert export(*arguments, "--overwrite").exit_code == 0
    if name.endswith("dxf"):
        curves = colmap_edges.read_edges(run_path).curves
        assert len(ezdxf.readfile(tmp_path / name).modelspace()) == curves.num_curves


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
    assert done.exit_code == 1 and "outside" in done.output
    (tmp_path / "empty").mkdir()
    done = export("--run_path", tmp_path / "empty", "--output_path", tmp_path / "a.dxf")
    assert done.exit_code == 1 and "no edges.json" in done.output
