import json
import shutil
from dataclasses import replace
from pathlib import Path

import miniature
import numpy as np
import pytest
import trimesh
import valid
from forked import call_forked
from scenes import EDGES_ALONE

from colmap_edges.colmap.model import frames_of_views, load_model, model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import benchmark, held_out, scenes, tables
from colmap_edges.evaluation import run as evaluation
from colmap_edges.evaluation.layouts.scans import scan_scenes
from colmap_edges.evaluation.mesh_errors import evaluate_mesh, measure
from colmap_edges.evaluation.metrics import clouds, depth
from colmap_edges.evaluation.metrics.raycasting import RayCaster, seen_in
from colmap_edges.evaluation.readers.curves import load_curves
from colmap_edges.export.edges_json import load_edges
from colmap_edges.options import DetectionOptions, PipelineOptions
from colmap_edges.pipeline.reconstruct import reconstruct

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return miniature.write(tmp_path_factory.mktemp("data"), cameras=9)


def test_sphere_against_its_sampling():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=10)
    generator = np.random.default_rng(0)
    directions = generator.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distances = clouds.cloud_to_mesh(directions * 12, sphere.vertices, sphere.faces)
    np.testing.assert_allclose(distances, 2, atol=0.02)  # the facets lie up to 0.02 inside
    nearest = clouds.cloud_to_cloud(directions[:50] * 12, directions * 10)
    expected = [np.linalg.norm(directions * 10 - p, axis=1).min() for p in directions[:50] * 12]
    np.testing.assert_allclose(nearest, expected)
    far, near = clouds.scores(distances, distances, [2.5, 1.5])
    assert (far["precision"], far["recall"], far["f_score"]) == (1, 1, 1)
    assert near["f_score"] == 0
    assert clouds.score(1.0, 0.5, 1.0)["f_score"] == pytest.approx(2 / 3)


def test_depth_of_a_cloud_excludes_occluded_points(sparse):
    view = depth.central_view(load_model(sparse))
    points = miniature.surface_points()
    below = points[np.abs(points[:, :2]).max(axis=1) < 9] - [0, 0, 6.0]
    seen = depth.cloud_depth(np.concatenate([points, below]), view)
    known = seen.depth > 0
    assert known.sum() > 4000
    rays = (np.column_stack([seen.pixels[known], np.ones(known.sum())])) @ np.linalg.inv(
        miniature.CALIBRATION
    ).T
    lifted = (rays * seen.depth[known][:, None] - view.translation) @ view.rotation
    heights = lifted[:, 2]
    assert (np.minimum(np.abs(heights), np.abs(heights - miniature.HEIGHT)) < 1e-3).all()
    middle = np.abs(lifted[:, :2]).max(axis=1) < 7
    np.testing.assert_allclose(heights[middle], miniature.HEIGHT, atol=1e-3)


def test_mesh_shifted_by_one_mm_against_the_cloud(sparse):
    model = load_model(sparse)
    corners = [(-200, -200, 1.0), (200, -200, 1.0), (200, 200, 1.0), (-200, 200, 1.0)]
    mesh = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)])
    points = miniature.surface_points() * [1, 1, 0]
    view = model.views[3]
    reference = scenes.Reference(depths=[depth.cloud_depth(points, view)], points=points)
    record = measure(mesh, model, reference, None)
    # Along the optical axis a millimetre of height is less, by the angle of ray and axis.
    truth = reference.depths[0]
    rays = np.linalg.inv(miniature.CALIBRATION) @ np.array([160, 120, 1.0])
    expected = 1.0 / abs((rays @ view.rotation)[2])
    assert record["mesh"]["median"] == pytest.approx(expected, rel=0.01)
    assert record["mesh"]["bias"] < 0
    assert record["mesh"]["coverage"] == 1.0
    assert record["mesh"]["count"] == np.count_nonzero(truth.depth)


def test_a_reference_mesh_judges_points_by_its_surface(sparse, tmp_path):
    model = load_model(sparse)
    corners = np.array([(-200, -200, 0.0), (200, -200, 0), (200, 200, 0), (-200, 200, 0)])
    truth = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)])
    truth.export(tmp_path / "truth.ply")
    reference = scenes.reference_of(tmp_path / "truth.ply", (), model)
    record = measure(truth, model, reference, tmp_path)
    expected = np.abs(model.points3D_xyz[:, 2])
    assert record["points"]["mae"] == pytest.approx(expected.mean(), rel=1e-5)
    assert record["mesh"]["rmse"] < 1e-4
    assert record["mesh"]["coverage"] == 1.0
    assert len(list(tmp_path.glob("depth_*.png"))) == 1


def test_splitting_leaves_no_point_out(sparse):
    model = load_model(sparse)
    used, left = held_out.split_points(model)
    ids = np.sort(np.concatenate([used.point3D_ids, left.point3D_ids]))
    np.testing.assert_array_equal(ids, model.point3D_ids)
    assert abs(len(used.point3D_ids) - len(left.point3D_ids)) <= 1
    assert used.track_offsets[-1] + left.track_offsets[-1] == model.track_offsets[-1]
    assert len(held_out.left_out_views(model.views, 3)) == 3


def test_reprojected_edges_in_an_unused_view(sparse):
    view = load_model(sparse).views[2]
    half = 12 * np.linspace(-1, 1, 50)
    border = np.column_stack([half, np.full(50, 12.0), np.full(50, miniature.HEIGHT)])
    hidden = border * [0.7, 1, 1] - [0, 3, 4]
    corners = [(x, y, miniature.HEIGHT) for x, y in ((-12, -12), (12, -12), (12, 12), (-12, 12))]
    caster = RayCaster(np.array(corners), np.array([(0, 1, 2), (0, 2, 3)]))
    chains = view.project(np.repeat(border, 4, axis=0))[0] + [0, 1.5]
    pixels, _, seen = seen_in(view, np.concatenate([border, hidden]), caster)
    pixels = pixels[seen]
    np.testing.assert_allclose(pixels, view.project(border)[0])
    errors = held_out.view_errors(pixels, view, chains)
    assert errors["points"] == 50
    assert errors["median_px"] == pytest.approx(1.5, abs=0.2)
    assert (errors["within_1_px"], errors["within_2_px"]) == (0, 1)
    assert errors["chance_2_px"] < 0.05


def fake_scene(tmp_path, name, problem=""):
    return scenes.Scene(name=name, image_path=tmp_path, problem=problem)


def unprepared(scene, folder):
    folder.mkdir(parents=True, exist_ok=True)
    return scene


def test_reference_is_read_once_for_all_methods(sparse, tmp_path, monkeypatch):
    read = []

    def evaluate(inputs, method, run_path, peer):
        assert inputs.reference is read[0]
        return {"faces": 7, "points": {"count": 3}}

    def load(model):
        read.append(scenes.Reference())
        return read[-1]

    monkeypatch.setattr(benchmark, "evaluate_method", evaluate)
    (tmp_path / "a").mkdir()
    scene = replace(fake_scene(tmp_path, "a"), sparse_path=sparse, load_reference=load)
    results = benchmark.run([scene], tmp_path, ("SfM", "edges"))
    assert [row["faces"] for row in results["a"]["methods"].values()] == [7, 7]
    assert len(read) == 1


def test_finished_scans_are_not_redone_and_failures_stay_alone(tmp_path, monkeypatch):
    calls = []

    def evaluate(scene, method, run_path, peer):
        calls.append((scene.name, method))
        if scene.name == "b":
            raise RuntimeError("broken\nscan")
        size = 2.0 if method == "SfM" else 1.0
        errors = {name: size for name in ("mae", "rmse", "sigma", "median", "p90")}
        mesh = errors | {"coverage": 0.9, "right_1_percent": 0.7}
        return {"faces": 7, "points": {"count": 3} | errors, "mesh": mesh}

    monkeypatch.setattr(benchmark, "prepared", unprepared)
    monkeypatch.setattr(benchmark, "evaluate_method", evaluate)
    listed = [fake_scene(tmp_path, name) for name in "abc"]
    lines = []
    results = benchmark.run(listed, tmp_path / "out", progress=lines.append)
    assert results["b"]["methods"]["SfM"] == {"error": "broken scan"}
    assert results["c"]["methods"]["edges"]["mesh"]["mae"] == 1.0
    again = benchmark.run(listed, tmp_path / "out", progress=lines.append)
    assert len(calls) == 6 + 2  # only the failed scan again
    assert again["a"] == results["a"]
    assert lines[0] == "[1/3] a"
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text()) == again
    table = (tmp_path / "out" / "evaluation.md").read_text()
    assert "| **average variation** | edges |  | -50.0 % |" in table
    rows = [line.split(" | ") for line in table.splitlines()]
    heads = next(row for row in rows if row[0] == "| scene")
    shares = dict(zip(heads, next(row for row in rows if row[0].startswith("| a (")), strict=True))
    assert [shares[f"right at {share} %"] for share in ("0.5", "1", "2")] == ["-", "0.7", "-"]
    assert "- b, SfM: broken scan" in table


def records_of(**sizes):
    errors = {name: dict.fromkeys(("mae", "rmse", "sigma", "median", "p90"), size)
              for name, size in sizes.items()}  # fmt: skip
    return {
        "unit": "m",
        "methods": {
            name: {
                "faces": 7,
                "points": {"count": 3} | values,
                "all_points": {"count": 5} | values,
                "mesh": values | {"coverage": 0.9},
            }
            for name, values in errors.items()
        },
    }


def test_average_variation_is_over_all_scenes_that_have_the_baseline():
    found = {
        "fountain": records_of(SfM=4.0, edges=1.0, Line3D=2.0),
        "DTU-006": records_of(SfM=40.0, edges=30.0, Line3D=20.0),
        "DTU-023": records_of(SfM=1.0, edges=100.0),
    }
    table = tables.paper_tables(found, "Line3D")
    rows = [r.split(" | ") for r in table.splitlines() if r.startswith("| **average variation")]
    variations = {(row[1], *row[3:6]) for row in rows}
    assert variations == {("SfM", *["+100.0 %"] * 3), ("edges", *["+0.0 %"] * 3)}
    assert "mean change of an error against Line3D" in table
    main, counted = table.split("## Points counted as the paper's authors do")
    assert "| fountain (m) | edges | 3 | 1 |" in main
    assert "| fountain (m) | edges | 5 | 1 |" in counted


def test_unknown_baselines_and_methods_are_named(tmp_path):
    listed = [fake_scene(tmp_path, "x")]
    with pytest.raises(ColmapEdgesError, match="unknown baseline LIMAP; choose from SfM, edges"):
        benchmark.run(listed, tmp_path / "out", baseline="LIMAP")
    with pytest.raises(ColmapEdgesError, match="unknown method smf; choose from SfM, "):
        benchmark.run(listed, tmp_path / "out", ("smf",))
    assert not (tmp_path / "out").exists()


def test_results_from_other_images_are_not_read_again(root, tmp_path, monkeypatch):
    def evaluate(scene, method, run_path, peer):
        return {"faces": len(scene.posed), "points": {"count": 3}}

    monkeypatch.setattr(benchmark, "prepared", unprepared)
    monkeypatch.setattr(benchmark, "evaluate_method", evaluate)
    benchmark.run(scan_scenes(root, [6]), tmp_path, ("SfM",))
    before = (tmp_path / "evaluation.json").read_text()
    benchmark.run(scan_scenes(root, [6]), tmp_path, ("SfM",))
    for choice in ({"light": "3_r5000"}, {"positions": frozenset([1, 2, 3])}):
        others = scan_scenes(root, [6], **choice)
        with pytest.raises(ColmapEdgesError, match="holds results of other images"):
            benchmark.run(others, tmp_path, ("SfM",))
    assert (tmp_path / "evaluation.json").read_text() == before


def test_the_papers_way_is_a_method():
    options = benchmark.methods()
    assert (options["paper"].tracing.method, options["paper"].meshing.method) == (
        *("paper", "manifold"),
    )
    assert options["paper"].use_edges
    assert options["patches"] == PipelineOptions()
    assert options["faces"] == PipelineOptions(use_patches=False)
    assert options["edges"] == PipelineOptions(use_faces=False, use_patches=False)
    assert not options["SfM-paper"].use_edges
    assert options["SfM-paper"].meshing == options["paper"].meshing
    assert options["COLMAP-like"].meshing.quality_weight == 1


def test_points_are_counted_alone_and_with_the_sfm_points(sparse):
    model = load_model(sparse)
    used, left = held_out.split_points(model)
    cloud = miniature.surface_points()
    reference = scenes.Reference(points=cloud)
    mesh = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    record = measure(mesh, left, reference, None, sfm_points=used)
    errors = clouds.cloud_to_cloud(left.points3D_xyz, cloud)
    assert record["points"]["count"] == len(left.points3D_xyz)
    assert record["points"]["mae"] == pytest.approx(errors.mean())
    errors = clouds.cloud_to_cloud(model.points3D_xyz, cloud)
    assert record["all_points"]["count"] == len(model.points3D_xyz)
    assert record["all_points"]["mae"] == pytest.approx(errors.mean())
    record = measure(mesh, model, reference, None)
    assert record["all_points"] == record["points"]


def test_a_scene_with_a_problem_names_it(tmp_path):
    scene = fake_scene(tmp_path, "x", problem="no such scan")
    results = benchmark.run([scene], tmp_path / "out", ("SfM",))
    assert results["x"]["methods"]["SfM"] == {"error": "no such scan"}
    missing = scan_scenes(tmp_path, [6])
    assert "Calibration" in missing[0].problem


def test_paths_of_peers_name_the_scene(tmp_path):
    scene = replace(fake_scene(tmp_path, "DTU-006"), scan="6")
    assert scene.peers({"LIMAP": "/a/{scan}"}) == {"LIMAP": Path("/a/6")}
    assert scene.peers({"LIMAP": "/a/{scene}"}) == {"LIMAP": Path("/a/DTU-006")}
    with pytest.raises(ColmapEdgesError, match=r"unknown placeholder; use \{scene\}"):
        fake_scene(tmp_path, "fountain").peers({"LIMAP": "/a/{scan}"})


def test_numbers_in_tables():
    assert tables.markdown(("a", "b"), [(1234567, 0.123456), ("x", float("nan"))]).splitlines() == [
        "| a | b |", "|---|---|", "| 1,234,567 | 0.1235 |", "| x | - |",
    ]  # fmt: skip


@pytest.mark.usefixtures("mesher")
@pytest.mark.parametrize(
    ("missing", "measured", "note"),
    [
        ("Plane", {"accuracy", "accuracy_median", "points"}, "No Plane of this scan"),
        ("ObsMask", set(), "No ObsMask of this scan"),
    ],
)
def test_figures_without_plane_or_mask_are_computed(
    root, sparse, tmp_path, missing, measured, note
):
    shutil.copytree(root, tmp_path / "data", ignore=shutil.ignore_patterns(f"{missing}*.mat"))
    (scene,) = scan_scenes(tmp_path / "data", [6])
    scene = replace(scene, sparse_path=sparse)
    results = benchmark.run([scene], tmp_path / "out", ("SfM",))
    record = results["DTU-006"]["methods"]["SfM"]
    assert record["mesh"]["median"] < 0.1
    assert record["points"]["mae"] < 1
    assert {name for name, value in record["dtu"].items() if value is not None} == measured
    table = (tmp_path / "out" / "evaluation.md").read_text()
    assert f"- DTU-006: {note}" in table.split("## Left empty")[1]
    row = next(r for r in table.split("own distances")[1].splitlines() if "| SfM |" in r)
    assert row.split(" | ")[3:5] == ["", ""]  # completeness and overall


@pytest.mark.usefixtures("mesher")
def test_missing_reference_is_an_error_before_meshing(root, sparse, tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "mesh_own", lambda *_: pytest.fail("meshed"))
    shutil.copytree(root, tmp_path / "data", ignore=shutil.ignore_patterns("Points"))
    (scene,) = scan_scenes(tmp_path / "data", [6])
    results = benchmark.run([replace(scene, sparse_path=sparse)], tmp_path / "out", ("SfM",))
    assert "stl006_total.ply" in results["DTU-006"]["methods"]["SfM"]["error"]


@pytest.mark.usefixtures("mesher")
def test_half_of_the_points_judges_the_mesh_of_the_other(sparse):
    errors = held_out.split_half_errors(load_model(sparse))
    assert errors["absolute"]["median"] < 0.15
    assert errors["absolute"]["coverage"] > 0.9


@pytest.fixture(scope="module")
def run_path(root, sparse, tmp_path_factory):
    """Output of `colmap-edges mesh` on the miniature, without faces."""
    from colmap_edges.pipeline.paths import Paths
    from colmap_edges.pipeline.run import run

    out = tmp_path_factory.mktemp("run") / "out"
    images = root / "Rectified" / "scan6"
    paths = Paths(image_path=images, input_path=sparse, output_path=out)
    run("mesh", paths, replace(EDGES_ALONE, report=False))
    return out


@pytest.mark.usefixtures("mesher")
def test_an_output_folder_is_judged(root, sparse, run_path):
    images = root / "Rectified" / "scan6"
    record = evaluation.run(run_path, sparse, image_path=images, held_out_views=9)
    for kind in ("SfM only", "with edges"):
        assert record["held_out_points"][kind]["absolute"]["median"] < 0.15
    (view,) = record["held_out_views"]
    assert view["view"] == "rect_005_max.png"
    assert view["points"] > 30
    assert (run_path / "evaluation" / "held_out_rect_005_max.png").is_file()
    assert view["within_2_px"] > 0.8 > 0.5 > view["chance_2_px"]
    assert "left-out points" in (run_path / "evaluation" / "evaluation.md").read_text()
    with pytest.raises(ColmapEdgesError, match="exists already"):
        evaluation.run(run_path, sparse)


@pytest.mark.usefixtures("mesher")
def test_edges_are_found_in_an_image_left_out(root, sparse, monkeypatch):
    options = PipelineOptions(detection=DetectionOptions(min_blur_px=0.0))
    images, model = root / "Rectified" / "scan6", load_model(sparse)
    before = numbers_of(model.reconstruction)
    monkeypatch.setattr(held_out, "load_model", lambda _: model)
    [view] = held_out.left_out_view_errors(sparse, images, 9, options=options)
    assert view["within_2_px"] > 0.8 > 2 * view["chance_2_px"]
    assert numbers_of(model.reconstruction) == before


def numbers_of(reconstruction):
    counts = (reconstruction.num_reg_images(), reconstruction.num_points3D())
    return *counts, reconstruction.compute_num_observations()


def test_images_of_one_frame_are_left_out_together():
    whole = valid.rigged()
    before, model = numbers_of(whole), model_from_reconstruction(whole)
    frames = frames_of_views(model)
    chosen = [view for view, frame in zip(model.views, frames, strict=True) if frame == frames[0]]
    assert len(chosen) == 2
    left = model_from_reconstruction(held_out.without_poses(model, chosen))
    assert {view.name for view in left.views} == {
        view.name for view, frame in zip(model.views, frames, strict=True) if frame != frames[0]
    }
    assert numbers_of(whole) == before


def test_upsampled_images_give_more_edges(root, sparse):
    """Its faint texture is not detected in each image, so a left-out one shows less of it."""
    counts = []
    for min_blur_px in (0.0, 0.8):
        detection = DetectionOptions(min_blur_px=min_blur_px)
        options = replace(EDGES_ALONE, detection=detection)
        found = reconstruct(
            load_model(sparse).reconstruction, root / "Rectified" / "scan6", options
        )
        heights = found.edges.points[:, 2]
        errors = np.minimum(np.abs(heights), np.abs(heights - miniature.HEIGHT))
        assert np.mean(errors < 0.25) > 0.9  # a pixel
        counts.append(len(errors))
    assert counts[1] > 1.8 * counts[0]


@pytest.mark.usefixtures("mesher")
def test_edges_are_read_back(sparse, run_path):
    model = load_model(sparse)
    found = load_edges(run_path, model)
    observed = found.observations
    written = load_curves(run_path / "edges.ply")
    np.testing.assert_allclose(found.points, written.points)
    errors = [
        np.linalg.norm(model.views[v].project(found.points[p][None])[0] - observed.pixels[t])
        for p in range(0, found.num_points, 7)
        for t in range(*observed.offsets[p : p + 2])
        for v in [observed.views[t]]
    ]
    assert len(errors) > 20
    assert np.median(errors) < 1
    records = json.loads((run_path / "edges.json").read_text())["edges"]
    assert found.num_edges == len(records)


@pytest.mark.usefixtures("mesher")
def test_the_command_prints_tables_and_one_line_errors(root, sparse, run_path):
    reference = root / "SampleSet" / "MVS Data" / "Points" / "stl" / "stl006_total.ply"
    command = ["evaluate", "--run_path", run_path, "--input_path", sparse]
    command += ["--reference_path", reference]
    done = call_forked([*command, "--overwrite"])
    assert done.returncode == 0, done.stderr
    assert "| accuracy |" in done.stdout
    assert "| reprojection median px |" in done.stdout
    again = call_forked(command)
    assert again.returncode == 1
    assert again.stderr.startswith("Error: ")
    assert again.stderr.count("\n") == 1


@pytest.mark.usefixtures("mesher")
@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_meshes_of_all_formats_are_judged_alike(root, sparse, run_path, tmp_path, suffix):
    from colmap_edges.evaluation.metrics.raycasting import load_mesh

    (tmp_path / "run").mkdir()
    load_mesh(run_path / "mesh.ply").export(tmp_path / "run" / f"mesh{suffix}")
    reference = root / "SampleSet" / "MVS Data" / "Points" / "stl" / "stl006_total.ply"
    found = evaluation.run(tmp_path / "run", sparse, reference)["mesh"]
    expected = evaluate_mesh(run_path / "mesh.ply", sparse, reference)
    assert found["faces"] == expected["faces"]
    assert found["accuracy"]["mae"] == pytest.approx(expected["accuracy"]["mae"], rel=0.05)
    assert found["completeness"]["mae"] == pytest.approx(expected["completeness"]["mae"], rel=1e-4)


@pytest.mark.usefixtures("mesher")
def test_edges_are_drawn_over_images_that_have_a_depth(root, sparse, run_path, tmp_path):
    import cv2

    shutil.copytree(run_path, tmp_path / "run", ignore=shutil.ignore_patterns("evaluation"))
    (tmp_path / "depths").mkdir()
    corners = [(x * h, y * h, z) for h, z in ((60, 0.0), (12, miniature.HEIGHT))
               for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip
    faces = [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)]
    view = load_model(sparse).views[4]
    truth = depth.render_reference(RayCaster(np.array(corners), np.array(faces)), view).depth
    np.savez(tmp_path / "depths" / "a.npz", depth=truth, scale=1.0, image_name=view.name)
    images = root / "Rectified" / "scan6"
    record = evaluation.run(tmp_path / "run", sparse, tmp_path / "depths", image_path=images)
    assert record["edges"]["depth"]["edge_points"]["relative"]["median"] < 0.002
    picture = cv2.imread(str(tmp_path / "run" / "evaluation" / "edges_rect_005_max.png"))
    plain = cv2.imread(str(images / view.name))
    assert picture.shape == plain.shape
    coloured = np.ptp(picture.astype(int), axis=2) > 60
    assert 30 < coloured.sum() < picture[..., 0].size / 4
    (tmp_path / "depths" / "a.npz").unlink()
    truth[truth > 0] *= 1.02  # now all edges are 2 % off: the colours' far end, red
    np.savez(tmp_path / "depths" / "a.npz", depth=truth, scale=1.0, image_name=view.name)
    notes = tmp_path / "run" / "evaluation" / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(ColmapEdgesError, match=r"notes\.txt was not written by colmap-edges"):
        evaluation.run(tmp_path / "run", sparse, tmp_path / "depths", overwrite=True)
    notes.unlink()
    evaluation.run(tmp_path / "run", sparse, tmp_path / "depths", image_path=images, overwrite=True)
    wrong = cv2.imread(str(tmp_path / "run" / "evaluation" / "edges_rect_005_max.png"))
    blue, _, red = wrong[coloured].reshape(-1, 3).mean(axis=0)
    assert red > 100 > 50 > blue


@pytest.mark.usefixtures("mesher")
def test_failed_evaluation_leaves_no_files(sparse, run_path, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mesh.ply").write_bytes((run_path / "mesh.ply").read_bytes())
    with pytest.raises(ColmapEdgesError, match="does not exist"):
        evaluation.run(tmp_path / "run", sparse, tmp_path / "none.ply")
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["mesh.ply"]


def test_a_folder_without_mesh_is_refused(tmp_path, sparse):
    with pytest.raises(ColmapEdgesError, match=r"mesh\.ply"):
        evaluation.run(tmp_path, sparse)
