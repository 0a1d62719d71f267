"""Cases from outside, in `../shared/cases`: each shows that its fault is gone, or is skipped.

Cases run in a folder of their own, which looks like the project's root to them. Those whose fault
a test of the project guards against, too, run in the long version alone.
"""

import importlib.util
import itertools
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from project import ROOT

CASES = ROOT.parent / "shared" / "cases"
HOSTILE = sorted(CASES.glob("hostile/[0-9]*"))
NUMBERED = sorted(CASES.glob("[0-9]*/make.py"))
PYTHON = Path(sys.executable)
REWRITTEN = {
    "01-mesh-ply-far-from-origin": "it takes every PLY for 32-bit; "
    "see pipeline/test_far_from_origin.py",
    "10-api-invalid-input": "NaN points end it once they are refused; see core/test_checks.py",
}
# The project's own tests of the same faults, by the name of the case.
COVERED = {
    "01-last-blank-line": ("colmap/test_text_files.py::test_empty_lines_may_be_missing",),
    "02-stale-frames": ("colmap/test_pose_check.py::test_frames_older_than_images_are_named",),
    "03-frames-of-deleted-images": (
        "colmap/test_pose_check.py::test_frames_of_other_images_are_named",
    ),
    "05-mesh-in-ecef": (
        "pipeline/test_far_from_origin.py::test_meshes_of_all_formats_keep_their_triangles",
    ),
    "08-space-in-text-name": ("colmap/test_text_files.py::test_names_may_have_spaces",),
    "10-inconsistent-text": (
        "colmap/test_text_files.py::test_a_model_is_read_as_it_stands",
        "colmap/test_text_files.py::test_faults_name_file_and_line",
    ),
    "11-smaller-model-in-0": (
        "colmap/test_workspace.py::test_the_model_of_most_images_is_used",
        "colmap/test_workspace.py::test_other_models_are_said_with_their_sizes",
    ),
    "12-step-of-a-small-unit": (
        "export/test_curves_as_files.py::test_the_cad_kernel_reads_curves_of_scenes_in_any_unit",
        "cli/test_export.py::test_curves_that_a_step_file_cannot_hold_are_counted",
    ),
    "13-transparent-pixels": (
        "images/test_masks.py::test_transparent_pixels_are_masked_as_by_a_mask",
    ),
    "02-export-overwrites": (
        "cli/test_export.py::test_links_are_not_written_through",
        "cli/test_export.py::test_a_failed_export_leaves_the_earlier_file",
        "cli/test_export.py::test_pipes_and_folders_are_refused",
    ),
    "03-dask-waits-forever": ("runtime/test_cluster.py::test_clusters_without_workers",),
    "04-cache-entry-traceback": (
        "runtime/test_cache.py::test_forged_entries_are_made_again",
        "runtime/test_cache.py::test_entries_of_other_content_are_not_found",
    ),
    "05-svg-invalid-xml": (
        "export/test_curves_as_files.py::test_svg_is_xml_whatever_the_image_is_called",
    ),
    "06-odd-timezone": ("cli/test_environment.py::test_odd_variables_change_nothing",),
    "07-nul-in-text-model": ("colmap/test_text_files.py::test_faults_name_file_and_line",),
    "08-segfault-tiny-coordinates": (
        "surfaces/test_mesher.py::test_cameras_at_infinity_are_an_error",
    ),
    "09-sigterm-while-importing": ("cli/test_environment.py::test_signals_while_libraries_load",),
    "11-dask-silent-port": (
        "runtime/test_cluster.py::test_a_silent_scheduler_is_given_up",
        "runtime/test_cluster.py::test_waiting_for_a_scheduler_ends_at_once",
    ),
    "12-fov-camera-traceback": (
        "colmap/test_plausibility.py::test_lenses_that_cannot_be_undone_are_refused",
    ),
}
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


def skip_covered(name, soak):
    if name in COVERED and not soak:
        pytest.skip(f"--soak runs it; the same fault is that of {' and '.join(COVERED[name])}")


@pytest.mark.parametrize("case", HOSTILE, ids=[path.stem for path in HOSTILE])
def test_hostile_cases(request, case, soak):
    """Each script exits 1 while its fault is there."""
    skip_covered(case.stem, soak)
    if case.stem in REWRITTEN:
        pytest.skip(REWRITTEN[case.stem])
    if "dask" in case.name:
        pytest.importorskip("distributed", reason="dask is not installed")
    root = request.getfixturevalue("root")  # a run of the program, which skipped cases do not need
    start = ["bash", case] if case.suffix == ".sh" else [PYTHON, "-c", RUNNER, case]
    done = call(root, *start)
    assert done.returncode == 0, done.stdout + done.stderr


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
def test_numbered_cases(outcomes, name, soak):
    """What each case's README calls right."""
    skip_covered(name, soak)
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


def test_tests_that_cover_cases_are_there():
    for name in itertools.chain(*COVERED.values()):
        path, _, function = name.partition("::")
        assert f"\ndef {function}(" in (ROOT / "tests" / path).read_text(encoding="utf-8"), name
