"""Cases from outside, in `../shared/cases`: each shows that its fault is gone, or is skipped.

Cases run in a folder of their own, which looks like the project's root to them.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import zlib  # noqa: F401 - before pycolmap
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from project import ROOT

CASES = ROOT.parent / "shared" / "cases"
HOSTILE = sorted(CASES.glob("hostile/[0-9]*"))
NUMBERED = sorted(CASES.glob("[0-9]*/make.py"))
PYTHON = Path(sys.executable)
REWRITTEN = {
    "01-mesh-ply-far-from-origin.py": "it takes every PLY for 32-bit; the next test reads headers",
    "10-api-invalid-input.py": "NaN points end it once they are refused; see core/test_checks.py",
}
SLOW = {"09-sigterm-while-importing.py"}  # 25 imports; tests/cli/test_environment.py has one
# Runs a case whose programs are named relative to the folder it was started in.
RUNNER = """
import os, runpy, subprocess, sys

class Popen(subprocess.Popen):
    def __init__(self, words, *others, **how):
        super().__init__([os.path.abspath(words[0]), *words[1:]], *others, **how)

subprocess.Popen = Popen
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""

pytestmark = [
    pytest.mark.pipeline,  # runs of the whole pipeline
    pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases is not there"),
]


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """The folder in which cases run, prepared for the hostile ones."""
    folder = tmp_path_factory.mktemp("cases")
    (folder / "build").mkdir()
    (folder / "tests").symlink_to(ROOT / "tests")
    (folder / ".venv").symlink_to(PYTHON.parent.parent)
    done = call(folder, PYTHON, CASES / "hostile" / "prepare.py")
    assert done.returncode == 0, done.stderr
    return folder


def call(folder, *words, **variables):
    """The outcome of a program in a folder."""
    return subprocess.run(
        list(map(str, words)),
        cwd=folder,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=500,
    )


@pytest.mark.parametrize("case", HOSTILE, ids=[path.stem for path in HOSTILE])
def test_hostile_cases(root, case, soak):
    """Each script exits 1 while its fault is there."""
    if case.name in SLOW and not soak:
        pytest.skip("25 runs; --soak runs it")
    if case.name in REWRITTEN:
        pytest.skip(REWRITTEN[case.name])
    if "dask" in case.name:
        pytest.importorskip("distributed", reason="dask is not installed")
    start = ["bash", case] if case.suffix == ".sh" else [PYTHON, "-c", RUNNER, case]
    done = call(root, *start)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("shift", [(356_000.0, 5_712_000.0, 100.0), (1e9, 1e9, 1e9)])
def test_meshes_far_from_the_origin(root, tmp_path, shift):
    trimesh = pytest.importorskip("trimesh", reason="meshes are read with trimesh")
    scene = root / "build" / "hostile" / "w"
    model = pycolmap.Reconstruction(str(scene / "sparse" / "0"))
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(np.eye(3)), np.array(shift)))
    (tmp_path / "model").mkdir()
    model.write_binary(str(tmp_path / "model"))
    paths = "--image_path", scene / "images", "--input_path", tmp_path / "model"
    less = "--quality", "low", "--report", "0", "--output_path", tmp_path / "out"
    done = call(root, PYTHON.with_name("colmap-edges"), "mesh", *paths, *less)
    assert "Note" in done.stdout, done.stderr
    mesh = trimesh.load(tmp_path / "out" / "mesh.ply", process=False)
    assert len(mesh.faces) > 1000
    assert (mesh.area_faces == 0).mean() <= 0.02


@pytest.fixture
def outcomes(tmp_path_factory):
    """A function that makes a case and gives its text and, of each run, text and exit code."""

    def make(name):
        folder = tmp_path_factory.mktemp("made")  # whose name has no word that is looked for
        done = call(
            folder,
            PYTHON,
            CASES / name / "make.py",
            DEMO=str(ROOT / "tests" / "data" / "demo"),
            COLMAP_EDGES=str(PYTHON.with_name("colmap-edges")),
            TMPDIR=str(folder),
        )
        runs = re.findall(r"^\$ colmap-edges (.*?)^exit code (-?\d+)", done.stdout, re.M | re.S)
        assert runs, done.stderr
        assert not any("Traceback" in text for text, _ in runs), done.stdout
        assert all(code in ("0", "1") for _, code in runs), done.stdout
        assert all(text.count("Error: ") == int(code) for text, code in runs), done.stdout
        return done.stdout, [(text, int(code)) for text, code in runs]

    return make


def read_or_named(runs, pattern):
    """Each run reads all, or says what its files lack."""
    return all(code == 0 or re.search(pattern, text) for text, code in runs)


def without_last_line(text, runs):
    images = [re.search(r"Images: +9 with poses", text) for text, code in runs if code == 0]
    return read_or_named(runs, r"images\.txt") and all(images)


def stale_frames(text, runs):
    error = re.search(r"median error of SfM points, px: ([\d.]+)", text)
    return "frames" in "".join(runs[0][0].splitlines()[1:]) or (error and float(error[1]) < 2)


def deleted_images(text, runs):
    return read_or_named(runs, r"frames\.bin lists image")


def far_from_origin(text, runs):
    found = re.findall(r"(\d+) vertices, (\d+) distinct; ([\d.e-]+) of triangles", text)
    assert len(found) == len(runs) == 3, text
    # Meshes with a texture repeat vertices at the borders of its charts.
    count = min(int(n) for n, _, _ in found)
    exact = [int(d) > 0.99 * count and float(share) < 0.01 for _, d, share in found]
    noted = [re.search(r"offset|precision", words) for words, _ in runs]
    return all(map(any, zip(exact, noted, strict=True)))


def spaces_in_names(text, runs):
    return read_or_named(runs, r"space")


def inconsistent_text(text, runs):
    named = read_or_named(runs, r"(cameras|images|points3D)\.txt")
    return len(runs) == 5 and named and "_M_range_check" not in text


def smaller_model(text, runs):
    return all(re.search(word, text) for word in (r"sparse/1", r"\b3\b", r"\b9\b"))


def small_unit(text, runs):
    said = re.search(r"([\d,]+) curves", runs[-1][0])
    read = re.search(r"(\d+) edges read back", text)
    noted = re.search(r"left out|missing|too (small|short)", runs[-1][0])
    return noted or int(said[1].replace(",", "")) == int(read[1])


def transparent_pixels(text, runs):
    edges = re.search(r"Edges: +(\d+)", text)
    return re.search(r"alpha|transparen", text) or (edges and int(edges[1]) < 130)


RIGHT = {
    "01-last-blank-line": without_last_line,
    "02-stale-frames": stale_frames,
    "03-frames-of-deleted-images": deleted_images,
    "05-mesh-in-ecef": far_from_origin,
    "08-space-in-text-name": spaces_in_names,
    "10-inconsistent-text": inconsistent_text,
    "11-smaller-model-in-0": smaller_model,
    "12-step-of-a-small-unit": small_unit,
    "13-transparent-pixels": transparent_pixels,
}
NEEDS = {"05-mesh-in-ecef": "trimesh", "12-step-of-a-small-unit": "OCP"}


@pytest.mark.parametrize("name", RIGHT)
def test_numbered_cases(outcomes, name):
    """What each case's README calls right."""
    if not (CASES / name).is_dir():
        pytest.skip(f"there is no case {name}")
    if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None:
        pytest.skip(f"{NEEDS[name]} is not installed")
    if name in ("02-stale-frames", "03-frames-of-deleted-images") and not shutil.which("colmap"):
        pytest.skip("COLMAP's command is not installed")
    text, runs = outcomes(name)
    assert RIGHT[name](text, runs), text


def test_no_case_is_forgotten():
    assert {path.parent.name for path in NUMBERED} <= RIGHT.keys()
