import logging
import subprocess
import sys

import pytest

from colmap_edges.cli.summary import summary
from colmap_edges.report.outcome import VIEWERS

STAGES = [
    ("read", {"images_with_poses": 24, "images_without_poses": 0, "points3D": 11878}),
    ("detect", {"images_without_edges": 0, "polylines": 8018, "edge_pixels": 673074}),
    ("trace", {"edges": 270, "edge_points": 10756}),
    ("write", {"edges": 270, "edge_points": 10756, "length": 285.1, "median_residual_px": 0.06}),
    ("mesh", {"faces": 54309, "vertices": 27207}),
]


def report_of(stages=STAGES, findings=()):
    records = [{"name": name, "wall_s": 1.25, "counts": counts} for name, counts in stages]
    return {"stages": records, "findings": list(findings)}


@pytest.fixture
def output(tmp_path):
    for name in ("mesh.ply", "report.html", "edges.ply", "report.json"):
        (tmp_path / name).touch()
    return tmp_path


def test_six_lines_in_a_users_words(output):
    lines = summary(report_of(), output, 8.6, verbose=False)
    heads = [line.split(":")[0] for line in lines]
    assert heads == ["Images", "Edges", "Points", "Mesh", "Time", "Look at"]
    assert lines[4] == "Time:     8.6 s"
    assert lines[-1] == f"Look at:  {output / 'report.html'} (in any web browser)"
    assert "_" not in "".join(lines[:-1])
    assert "270 in 3D" in lines[1]


@pytest.mark.parametrize(
    ("counts", "line"),
    [
        (
            {"refined": True, "held_out_gain": 0.381},
            "Poses:    refined on edges: held-out points fit 38% better",
        ),
        (
            {"refined": False, "held_out_gain": -0.02},
            "Poses:    kept: held-out points do not fit better to poses that are refined on edges",
        ),
        ({"refined": False}, None),
    ],
)
def test_what_became_of_the_poses(output, counts, line):
    lines = summary(
        report_of([*STAGES, ("trace", {"details": {"poses": counts}})]), output, 1.0, verbose=False
    )
    assert [text for text in lines if text.startswith("Poses")] == ([line] if line else [])


def test_notes_precede_results(output):
    finding = {"text": "3 images have no pose", "remedy": "register them"}
    lines = summary(report_of(findings=[finding]), output, 1.0, verbose=False)
    assert lines[0] == "Note: 3 images have no pose. To change that: register them."
    assert len(lines) == 7


def test_verbose_lists_stages_and_files_first(output):
    lines = summary(report_of(), output, 8.6, verbose=True)
    assert lines[0].split()[:3] == ["read", "1.2", "s"]
    assert "1.2 s  270 edges, 10,756 edge points" in lines[2]
    assert f"In {output}:" in lines
    told = [
        line.split()[0] for line in lines if line.startswith("  ") and line.split()[0] in VIEWERS
    ]
    assert told == ["edges.ply", "mesh.ply", "report.html", "report.json"]
    assert lines[-6:] == summary(report_of(), output, 8.6, verbose=False)


@pytest.mark.parametrize("gone", [["report.html"], ["report.html", "mesh.ply"]])
def test_file_to_open_exists(output, gone):
    for name in gone:
        (output / name).unlink()
    shown = "edges.ply" if len(gone) == 2 else "mesh.ply"
    assert str(output / shown) in summary(report_of(), output, 1.0, verbose=False)[-1]


def test_warnings_are_sentences_without_modules():
    script = (
        "import logging; from colmap_edges.cli.terminal import start_logging\n"
        "start_logging(False)\n"
        "logging.getLogger('colmap_edges.any').warning('%s is kept', 'x')\n"
        "logging.getLogger('colmap_edges.any').info('quiet')\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stderr == "Warning: x is kept\n"


def test_verbose_logs_only_this_package():
    script = (
        "import logging; from colmap_edges.cli.terminal import start_logging\n"
        "start_logging(True)\n"
        "logging.getLogger('colmap_edges.any').debug('ours')\n"
        "logging.getLogger('matplotlib').debug('theirs')\n"
        "logging.getLogger('matplotlib').warning('warned')\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stderr == "DEBUG colmap_edges.any: ours\nWARNING matplotlib: warned\n"
    assert logging.getLogger("colmap_edges").level in (logging.NOTSET, logging.WARNING)
