"""Shell scripts: syntax, and errors for bad arguments.

What installs packages or runs for minutes is not run here; continuous integration does that.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from project import ROOT, SCRIPTS, run_script

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


NAMES = (
    *(
        "build",
        "build_viewer",
        "build_wheels",
        "demo",
        "fetch_cgal",
        "memcheck",
        "reproduce_results",
        "sanitize",
    ),
    *("setup", "soak", "test", "test_lower_bounds"),
)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.mark.parametrize("name", NAMES)
def test_scripts_parse(name):
    done = subprocess.run(["bash", "-n", SCRIPTS / name], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_lowest_versions_are_those_of_the_project():
    (program,) = re.findall(
        r"<<'PYTHON'\n(.*?)\nPYTHON\n", (SCRIPTS / "test_lower_bounds").read_text(), re.DOTALL
    )
    library = "tomllib" if sys.version_info >= (3, 11) else "tomli"
    done = subprocess.run(
        [sys.executable, "-c", program.replace("import tomli", f"import {library} as tomli")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lowest = done.stdout.split()
    extras = PROJECT["optional-dependencies"]
    wanted = [*PROJECT["dependencies"], *extras["evaluation"], *extras["graph"]]
    assert len(lowest) == len(wanted) + 1  # nanobind builds
    assert {"numpy==1.26.*", "rich==13.0.*", "nanobind==2.2.*"} <= set(lowest)


def test_the_viewer_is_of_the_version_that_its_packages_name():
    wanted = json.loads((SCRIPTS / "viewer" / "package.json").read_text())["devDependencies"]
    locked = json.loads((SCRIPTS / "viewer" / "package-lock.json").read_text())["packages"]
    for name, version in wanted.items():
        assert locked[f"node_modules/{name}"]["version"] == version
    bundle = (ROOT / "colmap_edges" / "report" / "three.min.js").read_text()
    assert f"three.js {wanted['three']}" in bundle[:200]
    assert "The MIT License" in bundle[:400]
    assert not re.search(r"\beval\(|new Function", bundle)


def test_unknown_sanitizer_is_an_error():
    done = run_script("sanitize", sys.executable, "none", code=2)
    assert done.stderr == "no such kind: none\n"


def test_memcheck_asks_for_valgrind(tmp_path):
    for program in ("bash", "dirname"):
        (tmp_path / program).symlink_to(Path(shutil.which(program)).resolve())
    done = subprocess.run(
        [tmp_path / "bash", SCRIPTS / "memcheck"],
        env=os.environ | {"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (1, "run: apt-get install valgrind\n")


def test_reproduce_results_prints_its_usage():
    done = run_script("reproduce_results", code=2)
    assert "scripts/reproduce_results DATA OUT [PYTHON]" in done.stderr
    assert "#" not in done.stderr


def test_fetch_cgal_prints_its_usage():
    done = run_script("fetch_cgal", code=2)
    assert done.stderr == "give the folder: scripts/fetch_cgal FOLDER\n"


def test_build_wheels_needs_a_python(tmp_path):
    done = subprocess.run(
        ["bash", SCRIPTS / "build_wheels", tmp_path / "none", tmp_path / "dist"],
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0
    assert "none" in done.stderr
    assert list((tmp_path / "dist").iterdir()) == []
