"""The scripts that make tables from images, run on the miniature."""

import json
import shutil

import miniature
import numpy as np
import pytest
import trimesh
from project import run_script

from colmap_edges.colmap.model import load_model
from colmap_edges.evaluation.metrics import depth
from colmap_edges.evaluation.metrics.raycasting import RayCaster

pytestmark = pytest.mark.usefixtures("mesher")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return miniature.write(tmp_path_factory.mktemp("data"), cameras=6)


def write_line3dpp(sparse, path):
    """One side of the raised square as Line3D++ writes it."""
    ends = np.array([(-12, 12, miniature.HEIGHT), (12, 12, miniature.HEIGHT)])
    words = [1, *ends.ravel(), 3]
    for view in load_model(sparse).views[:3]:
        words += [view.image_id, 0, *view.project(ends)[0].ravel()]
    path.write_text(" ".join(map(str, words)) + "\n")


@pytest.fixture(scope="module")
def command(root, sparse, tmp_path_factory):
    """The words that make tables over three scenes, of which one has a peer and one is missing."""
    images, folder = root / "Rectified" / "scan6", tmp_path_factory.mktemp("tables")
    scene, out = folder / "toy-P7", folder / "out"
    model = ("--image_path", images, "--input_path", sparse, "--output_path", scene / "images")
    run_script("evaluate.py", "layout", "--layout", "strecha", *model)
    (scene / "gt_dense_cameras").mkdir()
    for path in (scene / "images").glob("*.camera"):
        path.rename(scene / "gt_dense_cameras" / path.name)
    reference = root / "SampleSet" / "MVS Data" / "Points" / "stl" / "stl006_total.ply"
    write_line3dpp(sparse, folder / "lines_DTU-006.txt")
    shutil.copytree(sparse, out / "toy-P7" / "sparse")  # triangulated there before
    words = ("evaluate.py", "scenes", "--strecha", scene, reference, "--dtu", root)
    words += ("--scans", 6, "--scans", 23, "--light", "3_r5000", "--positions", "1-5")
    words += ("--methods", "SfM", "--methods", "paper", "--methods", "edges")
    words += ("--peers", f"Line3D++={folder}/lines_{{scene}}.txt")
    return (*words, "--baseline", "Line3D++", "--output_path", out)


@pytest.fixture(scope="module")
def tables(command):
    """The folder of the tables, their figures, and what was printed."""
    done = run_script(*command)
    results = json.loads((command[-1] / "evaluation.json").read_text())
    return command[-1], results, done.stdout


def test_dtu_tables_with_a_peer_a_missing_scan_and_again(command, tables):
    out, results, printed = tables
    assert "- DTU-023, SfM: " in printed
    methods = results["DTU-006"]["methods"]
    for record in methods.values():
        assert record["mesh"]["median"] < 0.1
        assert record["dtu"]["overall"] < 2
    assert methods["SfM"]["mesh"]["coverage"] > 0.9
    assert methods["SfM"]["dtu"]["accuracy"] < 1.5
    assert methods["SfM"]["points"]["count"] > 300
    assert (out / "DTU-006" / "SfM" / "maps").is_dir()
    assert "| DTU-006 (mm) | SfM |" in (out / "evaluation.md").read_text()
    assert methods["Line3D++"]["points"]["mae"] < 0.3  # between samples 0.5 mm apart
    assert methods["Line3D++"]["points"]["count"] > 10
    again = run_script(*command)
    assert again.stdout.count("done before") == 3 + 4
    assert json.loads((out / "evaluation.json").read_text()) == results


def test_paper_tables_over_strecha_and_dtu_with_a_peer_of_one_scene(command, tables):
    out, results, printed = tables
    measured = {name: results[name]["methods"] for name in ("toy-P7", "DTU-006")}
    assert {name: list(methods) for name, methods in measured.items()} == {
        "toy-P7": ["SfM", "paper", "edges"],
        "DTU-006": ["SfM", "paper", "edges", "Line3D++"],
    }
    names = (out / "DTU-006" / "images.txt").read_text().split()
    assert names == [f"rect_00{position}_3_r5000.png" for position in range(1, 6)]
    for methods in measured.values():
        sfm = methods["SfM"]["points"]["count"]
        for name, record in methods.items():
            assert record["mesh"]["median"] < 0.1
            added = 0 if name == "SfM" else record["points"]["count"]
            assert record["all_points"]["count"] == sfm + added
    assert "mean change of an error against Line3D++" in printed
    change = methods["edges"]["mesh"]["mae"] / methods["Line3D++"]["mesh"]["mae"] - 1
    rows = [r.split(" | ") for r in printed.splitlines() if "average variation" in r]
    assert [row[1] for row in rows[:3]] == ["SfM", "paper", "edges"]
    assert rows[2][7] == f"{100 * change:+.1f} %"
    absent = f"Line3D++={out}/none_{{scene}}.txt"
    done = run_script(*command, "--peers", absent, code=1)
    assert "no scene has a result of Line3D++" in done.stderr


def test_other_layouts_give_the_same_mesh_errors(root, sparse, tmp_path):
    images = root / "Rectified" / "scan6"
    for layout in ("neus", "strecha"):
        paths = ("--image_path", images, "--input_path", sparse, "--output_path", tmp_path / layout)
        run_script("evaluate.py", "layout", "--layout", layout, *paths)
    reference = root / "SampleSet" / "MVS Data" / "Points" / "stl" / "stl006_total.ply"
    command = ("evaluate.py", "scenes", "--dtu", tmp_path / "neus", "--dtu_reference", reference)
    command += ("--strecha", tmp_path / "strecha", reference, "--methods", "SfM")
    run_script(*command, "--output_path", tmp_path / "out")
    results = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert set(results) == {"neus", "strecha"}
    for name, entry in results.items():
        assert entry["methods"]["SfM"]["mesh"]["median"] < 0.1
        assert entry["methods"]["SfM"]["mesh"]["coverage"] > 0.9
        assert list((tmp_path / "out" / name).rglob("depth_*.png"))
    done = run_script(*command, "--positions", "odd", "--output_path", tmp_path, code=2)
    assert "a NeuS/IDR folder has no --light and no --positions" in done.stderr


def test_mvsnets_layout_is_measured_by_its_depth_maps(tmp_path):
    root = miniature.write_mvsnet(tmp_path / "dtu")
    command = ("evaluate.py", "scenes", "--dtu", root, "--output_path", tmp_path / "out")
    run_script(*command, "--methods", "SfM", "--positions", "1-5")
    (entry,) = json.loads((tmp_path / "out" / "evaluation.json").read_text()).values()
    record = entry["methods"]["SfM"]
    # A pixel of the depth maps is a millimetre.
    assert record["mesh"]["median"] < 0.2
    assert record["mesh"]["coverage"] > 0.9
    assert record["points"]["of"] == "depth in observing views"
    assert record["points"]["median"] < 0.2
    assert "dtu" not in record


def test_poses_of_a_model_against_its_own_cameras(root, sparse, tmp_path):
    """The start is true; whatever adjusts it moves it by little."""
    images = root / "Rectified" / "scan6"
    model = ("--image_path", images, "--input_path", sparse)
    run_script("evaluate.py", "layout", "--layout", "strecha", *model, "--output_path", tmp_path)
    done = run_script("evaluate.py", "poses", "--camera_path", tmp_path, *model)
    rows = [line.split(" | ") for line in done.stdout.splitlines()[2:]]
    assert [row[3] for row in rows] == [
        *("start", "SfM points (COLMAP)", "SfM points (COLMAP, Cauchy)", "SfM and edge points")
    ]
    centres = [float(row[4]) for row in rows]
    assert centres[0] < 1e-9
    assert max(centres) < 0.5
    done = run_script(
        "evaluate.py", "poses", "--camera_path", tmp_path, "--image_path", images, code=2
    )
    assert "--camera_path needs --image_path and --input_path" in done.stderr


def test_lines_of_a_peer_against_curves_surface_and_depth(sparse, tmp_path):
    write_line3dpp(sparse, tmp_path / "lines.txt")
    top = miniature.HEIGHT
    # The peer has one of the square's two sides.
    ends = np.array([(-12, 12, top), (12, 12, top), (-12, -12, top), (12, -12, top)])
    np.savez(tmp_path / "curves.npz", points=ends, edges=np.array([(0, 1), (2, 3)]))
    corners = [(x * h, y * h, z) for h, z in ((60, 0.0), (12, top))
               for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip
    surface = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)], process=False)
    surface.export(tmp_path / "surface.ply")
    view = load_model(sparse).views[0]
    truth = depth.render_reference(RayCaster(surface.vertices, surface.faces), view).depth
    (tmp_path / "depths").mkdir()
    np.savez(tmp_path / "depths" / "a.npz", depth=truth, scale=1.0, image_name=view.name)
    command = (
        "evaluate.py",
        "edges",
        "--edges_path",
        tmp_path / "lines.txt",
        "--sparse_path",
        sparse,
    )
    command += ("--input_path", sparse, "--reference_path", tmp_path / "curves.npz")
    command += ("--surface_path", tmp_path / "surface.ply")
    command += ("--reference_depth_path", tmp_path / "depths", "--output_path", tmp_path / "e.json")
    assert "SfM points on the true surface" in run_script(*command).stdout
    record = json.loads((tmp_path / "e.json").read_text())
    assert "reprojection" not in record
    (row, _) = record["curves"]["scores"]
    assert row["precision"] == 1
    assert row["recall"] == pytest.approx(0.5, abs=0.02)
    assert record["curves"]["on_surface"] == [1, 1]
    assert 0.5 < record["curves"]["sfm_points_on_surface"][0] <= 1
    assert record["depth"]["edge_points"]["relative"]["p90"] < 1e-3  # a pixel of a slanted surface
    assert record["depth"]["sfm_points"]["relative"]["count"] > 100


def test_bad_input_is_one_line(tmp_path):
    output = ("--output_path", tmp_path / "out")
    for command in (
        ("--dtu", tmp_path),
        ("--strecha", tmp_path, tmp_path),
    ):
        done = run_script("evaluate.py", "scenes", *command, *output, code=1)
        assert done.stderr.startswith("error: ")
        assert done.stderr.count("\n") == 1
    command = ("evaluate.py", "scenes", *output)
    assert "NAME=PATH" in run_script(*command, "--peers", "/a", code=2).stderr
    done = run_script(*command, code=2)
    assert "give --scene, --strecha or --dtu" in done.stderr
    assert not (tmp_path / "out").exists()
