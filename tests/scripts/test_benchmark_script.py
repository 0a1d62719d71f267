"""The benchmark script: a tiny made-up city, two settings in turns."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from project import ROOT

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "scripts" / "benchmark.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_two_settings_on_a_city(tmp_path):
    output = tmp_path / "result.json"
    setting = "--ChainDepth.sample_step_px 4"
    done = run(
        *("--synthetic", "6", "--points_per_view", "100", "--runs", "1"),
        *("--setting", setting, "--output_path", str(output)),
    )
    assert done.returncode == 0, done.stderr
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


def test_scene_that_is_not_there(tmp_path):
    done = run("--data_path", str(tmp_path), "--scene", "none")
    assert done.returncode == 1
    assert done.stderr.strip().splitlines()[-1].startswith("error: ")


def test_flag_that_is_none():
    done = run("--synthetic", "4", "--runs", "1", "--flags", "--no_such_flag 1")
    assert done.returncode == 1
    assert "no_such_flag" in done.stderr
