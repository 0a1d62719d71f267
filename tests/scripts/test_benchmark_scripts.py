"""The scripts that measure speed, run on tiny synthetic scenes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from project import run_script
from scipy.spatial import cKDTree
from synthetic_city import curve_at, make_city

from colmap_edges.colmap.model import load_model
from colmap_edges.evaluation.readers.curves import load_curves

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


def test_two_settings_on_a_city(tmp_path):
    output = tmp_path / "result.json"
    setting = "--ChainDepth.sample_step_points 4"
    done = run_script(
        *("benchmark.py", "run", "--synthetic", "6", "--points_per_view", "100", "--runs", "1"),
        *("--setting", setting, "--output_path", output),
    )
    records = json.loads(output.read_text())["scenes"]
    assert [record["variant"] for record in records] == ["this tree", setting]
    for record in records:
        assert list(record["stages"]) == [
            *("read", "make edge graphs", "trace", "write", "whole process")
        ]
        whole = record["stages"]["whole process"]
        parts = [stage for name, stage in record["stages"].items() if name != "whole process"]
        assert 0 < sum(stage["cpu_s"] for stage in parts) <= whole["cpu_s"]
        assert max(stage["peak_mb"] for stage in parts) > 0
        assert record["counts"]["trace"]["edges"] > 0
    fine, coarse = (records[i]["counts"]["trace"]["details"]["samples"] for i in (1, 0))
    assert fine > 2 * coarse
    rows = done.stdout.strip().splitlines()
    assert len(rows) == 2 + 2 * 5
    assert all(row.count("|") == 10 for row in rows)


def test_missing_scene_is_an_error(tmp_path):
    done = run_script("benchmark.py", "run", "--data_path", tmp_path, "--scene", "none", code=1)
    assert done.stderr.strip().splitlines()[-1].startswith("error: ")


def test_unknown_flag_is_an_error(small):
    folder = small[0].parent
    flags = ("--data_path", folder.parent, "--scene", folder.name, "--flags", "--no_such_flag 1")
    done = run_script("benchmark.py", "run", "--runs", "1", *flags, code=1)
    assert "no_such_flag" in done.stderr


def test_mesher_on_a_made_up_scene():
    """On one thread and on two, with the rays of every point counted."""
    arguments = ("--num_points", 2000, "--num_cameras", 16, "--rays_per_point", 3)
    printed = []
    for threads in (1, 2):
        done = run_script("benchmark.py", "mesher", *arguments, "--num_threads", threads)
        printed.append(dict(line.split() for line in done.stdout.splitlines()[1:-2]))
    one, two = printed
    assert one["rays"] == "6000"
    assert int(one["boundary_facets"]) > 1000
    same = {name for name in one if not name.startswith("seconds")}
    assert {name: one[name] for name in same} == {name: two[name] for name in same}


def test_neighbours_of_views_without_points():
    done = run_script("benchmark.py", "neighbors", "--num_views", 60)
    found = float(done.stdout.splitlines()[-1].split()[0])
    assert 3 < found < 40


def test_city_is_reconstructed(tmp_path):
    """Edges of a tiny city lie on its curves: within a hundredth of a block."""
    arguments = ("--num_views", 9, "--points_per_view", 100, "--folder", tmp_path)
    run_script("synthetic_city.py", *arguments, "--report", tmp_path / "report.json")
    stages = json.loads((tmp_path / "report.json").read_text())["stages"]
    assert [s["name"] for s in stages] == ["read", "make edge graphs", "trace", "write"]
    found = load_curves(tmp_path / "edges.ply")
    assert found.lengths().sum() > 10
    city = make_city(9, 0, (800, 600), 2)
    steps = np.linspace(0, 1, 201)
    truth = np.concatenate([curve_at(city.curves, t) for t in steps])
    distances, _ = cKDTree(truth).query(found.points)
    assert np.quantile(distances, 0.9) < 0.01
    assert len(load_model(tmp_path / "sparse").views) == 9


def test_a_city_on_a_cluster():
    pytest.importorskip("distributed")
    done = run_script("benchmark.py", "cluster", "--num_views", 5, "--workers", 1)
    head, _, alone, one = done.stdout.strip().splitlines()[-4:]
    names, alone, one = (
        [cell.strip() for cell in row.split("|")[1:-1]] for row in (head, alone, one)
    )
    alone, one = dict(zip(names, alone, strict=True)), dict(zip(names, one, strict=True))
    assert alone["edges"] == one["edges"] != "0"
    assert (alone["tasks"], one["tasks"]) == ("0", str(5 * (2 * 2 + 1)))
    assert float(one["in tasks"]) > 0
    assert 0 <= int(one["no work"].rstrip("%")) < 100
