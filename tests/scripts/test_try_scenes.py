"""Random scenes are made, run, judged by known figures, and held against the rules."""

import copy
import json
import shutil

import cv2
import numpy as np
import pytest
from project import DEMO, ROOT, run_script
from trials import judging, pictures, rules, running, summary
from trials.running import Store, Version

from colmap_edges.evaluation.metrics.raycasting import load_mesh
from colmap_edges.evaluation.readers.curves import load_curves

TINY = {"size": (240, 180), "num_views": 8}


def record_of(family="cad", seed=0, *, right=(0.5, 0.8, 0.9, 0.9), f_score=0.99, normals=0.9):
    """A result of which only the figures that rules look at are given."""
    meshes = {
        mesh: {"right_1_percent": share, "coverage": 1.0, "normals_10_deg": normals}
        for mesh, share in zip(judging.MESHES, right, strict=True)
    }
    edges = {"precision": f_score, "recall": f_score, "f_score": f_score, "times": 1.0}
    return {"family": family, "seed": seed, "meshes": meshes, "edges": edges, "seconds": 3.0}


def shift(record, by):
    """Change how much is right with faces, and with patches, too."""
    for mesh in ("faces", "patches"):
        record["meshes"][mesh]["right_1_percent"] += by


@pytest.fixture
def good():
    """Results that break no rule."""
    return [record_of(family, seed) for family in ("cad", "rooms") for seed in range(100)]


def test_good_results_break_no_rule(good):
    assert rules.broken_rules(good, copy.deepcopy(good)) == []


def test_a_failure_breaks_a_rule(good):
    good[7] = {"family": "cad", "seed": 7, "failure": "ended by SIGSEGV"}
    assert rules.broken_rules(good) == ["cad 7 failed: ended by SIGSEGV"]


@pytest.mark.parametrize(
    ("right", "words"),
    [
        ((0.5, 0.48, 0.9, 0.9), "edges lose"),
        ((0.5, 0.8, 0.78, 0.9), "faces lose"),
        ((0.5, 0.8, 0.9, 0.88), "patches lose"),
    ],
)
def test_one_scene_in_a_hundred_may_lose_to_a_simpler_mesh(good, right, words):
    good[3] = record_of("cad", 3, right=right)
    assert rules.broken_rules(good) == []
    good[4] = record_of("cad", 4, right=right)
    (broken,) = rules.broken_rules(good)
    assert broken.startswith(f"cad: {words}")
    assert "in 2 of 100 scenes; most in seed 3: -0.02" in broken


def test_edges_of_cad_parts_have_a_least_score(good):
    for seed in range(7):
        good[seed] = record_of("cad", seed, f_score=0.85)
    (broken,) = rules.broken_rules(good)
    assert broken.startswith("cad: 5th percentile of F of edges is 0.850")
    good[:100] = [record_of("cad", seed, f_score=0.96) for seed in range(100)]
    assert rules.broken_rules(good) == ["cad: mean F of edges is 0.960, below 0.97"]
    good[100:] = [record_of("rooms", seed, f_score=0.5) for seed in range(100)]
    assert len(rules.broken_rules(good)) == 1  # of the family cad only


def test_small_losses_everywhere_are_worse_than_the_baseline(good):
    baseline = copy.deepcopy(good)
    random = np.random.default_rng(0)
    for record in good:
        shift(record, random.normal(0, 0.01))
    assert rules.broken_rules(good, baseline) == []  # scatter without a trend
    for record in good[:100]:
        record["meshes"]["patches"]["normals_10_deg"] -= 0.004
    (broken,) = rules.broken_rules(good, baseline)
    assert broken.startswith(
        "cad: normals within 10° of meshes is worse than the baseline's by 0.0"
    )


def test_large_losses_of_some_scenes_are_worse_than_the_baseline(good):
    baseline = copy.deepcopy(good)
    for record in good[:5]:
        shift(record, -0.06)
    for record in good[5:8]:
        shift(record, 0.09)
    assert rules.broken_rules(good, baseline) == []
    for record in good[5:8]:
        shift(record, -0.09)
    (broken,) = rules.broken_rules(good, baseline)
    assert "by more than 0.05 in 5 scenes and better in 0; worst is seed 0: -0.060" in broken


def test_tables_show_medians_worst_scenes_and_failures(good):
    for record in good:
        for mesh in record["meshes"].values():
            mesh |= dict.fromkeys(("mae", "normals_median_deg", "normals_30_deg"), 0.25)
            mesh["sky_covered"] = None
    baseline = copy.deepcopy(good)
    good[2]["meshes"]["patches"]["right_1_percent"] = 0.4
    good[5] = {"family": "cad", "seed": 5, "failure": "ended by SIGABRT", "trace": "a\nb"}
    text = summary.report(good, baseline, "v1")
    assert "| cad | edges and faces | 0.9 (0.9) | 0.25 (0.25) |" in text
    assert "| cad | 100 | 1 | 0.99 (0.99) |" in text
    assert "+0.0000, -0.0051, -0.500 (2)" in text
    assert text.endswith("## Failed\n\n- cad 5: ended by SIGABRT\n\n```\na\nb\n```")


@pytest.mark.parametrize(
    ("code", "failure"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended by SIGSEGV"),
        ("raise ValueError('no luck')", "ValueError: no luck"),
        ("import sys; sys.exit(3)", "exit code 3"),
        ("import time; time.sleep(60)", "no result after 2 s"),
    ],
)
def test_a_run_that_ends_badly_is_one_failed_scene(tmp_path, monkeypatch, code, failure):
    package = tmp_path / "version" / "colmap_edges"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(code + "\n")
    monkeypatch.setattr(running, "make", lambda store, family, seed: tmp_path / "scene")
    store, version = Store(path=tmp_path / "out"), Version(name="v", root=package.parent)
    record = running.try_scene(store, version, "cad", 4, timeout=2)
    assert (record["family"], record["seed"], record["failure"]) == ("cad", 4, failure)
    assert list(tmp_path.glob("out/results/**/*.json")) == []  # it is tried again
    if failure.startswith("ended"):
        assert "Fatal Python error" in record["trace"]
    assert "1 | 1 |" in summary.edge_table([record])


def test_the_true_surface_and_curves_have_perfect_figures(tmp_path, monkeypatch):
    surface, curves = load_mesh(DEMO / "surface.ply"), load_curves(DEMO / "curves.npz")
    mesh = {"vertices": surface.vertices, "faces": surface.faces}
    none = {"vertices": np.empty((0, 3)), "faces": np.empty((0, 3), int)}
    meshes = zip(judging.MESHES, (none, mesh, mesh, mesh), strict=True)
    found = {f"{name}_{key}": value for name, of in meshes for key, value in of.items()}
    found |= {"edge_points": curves.points, "edge_segments": curves.segments}
    run = tmp_path / "run.npz"
    np.savez(run, **found, seconds=np.array([1.0, 2, 4, 8, 16]))
    record = judging.judge(DEMO, run)
    perfect, nothing = record["meshes"]["patches"], record["meshes"]["sfm"]
    assert perfect["mae"] < 0.003  # where the poses are wrong, at the outlines of bodies
    assert min(perfect[k] for k in ("coverage", "right_1_percent", "normals_10_deg")) > 0.98
    assert 0 < perfect["sky_covered"] < 0.02
    assert (nothing["coverage"], nothing["normals_30_deg"], nothing["sky_covered"]) == (0, 0, 0)
    assert record["edges"]["f_score"] == pytest.approx(1)
    assert record["edges"]["times"] == pytest.approx(1)
    assert record["seconds"] == 18
    monkeypatch.setattr(pictures, "STRIDE", 8)
    drawn = pictures.draw(DEMO, run)
    assert drawn.shape == (192, 256, 3)
    assert drawn[96:].std() > 20  # the mesh, from both places


def test_curves_that_too_few_views_see_need_not_be_found(tmp_path):
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], float)
    visible = np.array([[True, True, True], [True, True, False]])
    path = tmp_path / "curves.npz"
    np.savez(path, points=points, edges=[(0, 1), (2, 3)], visible=visible)
    both = load_curves(path)
    for number, recall in ((1, 1.0), (2, 1.0)):
        found = judging.Curves(points=points, segments=both.segments[:number])
        figures = judging.edge_figures(found, path)
        assert (figures["precision"], figures["recall"]) == (1.0, recall)
    hidden = judging.Curves(points=points, segments=both.segments[1:])
    assert judging.edge_figures(hidden, path)["recall"] == 0
    np.savez(path, points=np.empty((0, 3)), edges=np.empty((0, 2), int))
    assert judging.edge_figures(hidden, path) is None


def test_a_version_is_taken_from_the_repository(tmp_path, monkeypatch):
    if not (ROOT / ".git").exists():
        pytest.skip("the tests do not run in a repository")
    monkeypatch.setattr(running, "COMPILED", ("LICENSE",))  # do not compile
    store = Store(path=tmp_path)
    version = running.version_at("HEAD", store)
    assert (version.root / "colmap_edges" / "__init__.py").is_file()
    here, there = (
        {path.relative_to(root) for path in (root / "colmap_edges").rglob("*.so")}
        for root in (ROOT, version.root)
    )
    assert here == there
    monkeypatch.setattr(running.shutil, "copy2", None)
    assert running.version_at("HEAD", store) == version  # it is there already
    with pytest.raises(running.TrialError, match="git rev-parse"):
        running.version_at("no-such-commit", store)


@pytest.mark.pipeline
def test_a_small_scene_of_the_zoo(tmp_path):
    pytest.importorskip("colmap_edges._mesher", reason="the CGAL mesher is not built")
    pytest.importorskip("manifold3d", reason="the scenes are made with manifold3d")
    from zoo.make import make_scene

    store = Store(path=tmp_path)
    make_scene("cad", 2, store.scene("cad", 2), **TINY)
    common = ("--seeds", "2..2", "--families", "cad", "--output_path")
    done = run_script("try_scenes.py", *common, tmp_path)
    table = (tmp_path / "summary.md").read_text()
    assert table in done.stdout
    assert "| cad | 1 | 0 |" in table
    (drawn,) = tmp_path.glob("worst_*.png")
    assert cv2.imread(str(drawn)).shape == (180, 240, 3)
    (result,) = tmp_path.glob("results/*/*/*.json")
    shutil.rmtree(tmp_path / "runs")  # results are kept without
    record = json.loads(result.read_text())
    record["meshes"]["patches"]["right_1_percent"] = 0.001
    result.write_text(json.dumps(record))
    done = run_script("try_scenes.py", *common, tmp_path, "--check", code=1)
    assert done.stdout.splitlines()[-1].startswith("Broken: ")
    assert "patches lose more than 0.01" in done.stdout.splitlines()[-1]


def test_arguments_are_checked(tmp_path):
    pytest.importorskip("manifold3d", reason="the scenes are made with manifold3d")
    done = run_script("try_scenes.py", "--seeds", "5..2", "--output_path", tmp_path, code=2)
    assert "give one such as 0..99" in done.stderr
    assert not any(tmp_path.iterdir())
