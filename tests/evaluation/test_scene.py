import json
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
import trimesh
from project import run_script

from colmap_edges.colmap.model import load_model
from colmap_edges.evaluation import tables
from colmap_edges.evaluation.mesh_errors import evaluate_mesh
from colmap_edges.evaluation.metrics import curves, depth, edges
from colmap_edges.evaluation.metrics.raycasting import RayCaster
from colmap_edges.evaluation.readers.curves import Curves, load_curves

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


@pytest.fixture(scope="module")
def model_path(tmp_path_factory):
    """Five cameras in a row, 100 mm before the plane z = 0, that see a grid of points on it."""
    path = tmp_path_factory.mktemp("model")
    reconstruction = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 100.0, 80, 60)
    reconstruction.add_camera_with_trivial_rig(camera)
    grid = np.array([(x, y, 0.0) for x in range(-15, 16, 5) for y in range(-10, 11, 5)])
    tracks = [pycolmap.Track() for _ in grid]
    for number in range(5):
        image = pycolmap.Image(name=f"view{number}.jpg", camera_id=1, image_id=number + 1)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), [-2.0 * (number - 2), 0, 100])
        in_camera = grid + pose.translation
        pixels = camera.img_from_cam(in_camera)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel) for pixel in pixels])
        reconstruction.add_image_with_trivial_frame(image, pose)
        for index, track in enumerate(tracks):
            track.add_element(number + 1, index)
    for point, track in zip(grid, tracks, strict=True):
        reconstruction.add_point3D(point, track)
    reconstruction.write(path)
    return path


def plane(z, size=80.0):
    corners = np.array([(-size, -size, z), (size, -size, z), (size, size, z), (-size, size, z)])
    return trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)


def test_plane_shifted_by_one_mm_has_mae_of_one_mm(model_path, tmp_path):
    plane(1.0).export(tmp_path / "mesh.ply")
    plane(0.0).export(tmp_path / "reference.ply")
    record = evaluate_mesh(
        tmp_path / "mesh.ply",
        model_path,
        tmp_path / "reference.ply",
        view_names=["all"],
        pictures_path=tmp_path / "maps",
    )
    pooled = record["depth"]["pooled"]
    for name in ("mae", "rmse", "bias", "median", "p90"):
        assert pooled[name] == pytest.approx(1.0, abs=1e-5)
    assert pooled["sigma"] == pytest.approx(0.0, abs=1e-5)
    assert pooled["coverage"] == 1.0
    assert pooled["count"] == 5 * 80 * 60
    assert record["completeness"]["mae"] == pytest.approx(1.0, abs=1e-6)
    assert len(list((tmp_path / "maps").glob("*.png"))) == 5


def test_tilted_plane_is_hit_through_the_centres_of_a_scaled_map(model_path):
    view = load_model(model_path).views[2]
    corners = np.array([(-80, -80, -40.0), (80, -80, 40.0), (80, 80, 40.0), (-80, 80, -40.0)])
    caster = RayCaster(corners, np.array([(0, 1, 2), (0, 2, 3)]))
    found = depth.render_reference(caster, view, scale=0.5).depth
    assert found.shape == (30, 40)
    slope = (np.arange(40) + 0.5) / 0.5 / 100 - 0.4  # x / z of the pixel centres
    expected = 100 / (1 - 0.5 * slope)  # z = 100 + x / 2 in the camera's frame
    np.testing.assert_allclose(found, np.tile(expected, (30, 1)), rtol=1e-6)


def test_coverage_counts_only_pixels_with_a_reference_depth(model_path):
    view = load_model(model_path).views[2]
    half = trimesh.Trimesh(
        [(0, -80, 2), (80, -80, 2), (80, 80, 2), (0, 80, 2)], [(0, 1, 2), (0, 2, 3)]
    )
    truth = np.full((60, 80), 100, dtype=np.float32)
    truth[:30] = 0
    reference = depth.ReferenceDepth(view=view, depth=truth, scale=1.0)
    result = depth.depth_errors(RayCaster(half.vertices, half.faces), reference)
    assert result.record()["coverage"] == 0.5
    assert np.isnan(result.errors[:30]).all()
    np.testing.assert_allclose(result.errors[30:, 40:], 2, atol=1e-5)


def test_holes_are_wrong_pixels(model_path):
    """Half of the pixels are answered, half of those 0.8 % and half 1.5 % of their depth off."""
    view = load_model(model_path).views[2]
    half = trimesh.Trimesh(
        [(0, -80, 0), (80, -80, 0), (80, 80, 0), (0, 80, 0)], [(0, 1, 2), (0, 2, 3)]
    )
    truth = np.full((60, 80), 100 / 1.008, dtype=np.float32)
    truth[:30] = 100 / 1.015
    truth[20:40] = 0  # unknown: in no share
    reference = depth.ReferenceDepth(view=view, depth=truth, scale=1.0)
    result = depth.depth_errors(RayCaster(half.vertices, half.faces), reference)
    shares = {"coverage": 0.5, "right_0_5_percent": 0.0, "right_1_percent": 0.25}
    shares["right_2_percent"] = 0.5
    record = result.record()
    assert {name: record[name] for name in shares} == shares
    pooled = depth.pool([result, result])
    assert pooled == record | {"count": 2 * record["count"]}
    nothing = depth.pool([])
    assert nothing["count"] == 0
    assert all(np.isnan(nothing[name]) for name in shares)


def test_mesh_without_reference_is_compared_at_observations(model_path, tmp_path):
    plane(-2.0).export(tmp_path / "mesh.ply")
    record = evaluate_mesh(tmp_path / "mesh.ply", model_path)
    assert record["points_depth"]["absolute"]["bias"] == pytest.approx(-2.0, abs=1e-5)
    assert record["points_depth"]["relative"]["mae"] == pytest.approx(0.02, abs=1e-6)
    plane(-1.5).export(tmp_path / "mesh.ply")
    record = evaluate_mesh(tmp_path / "mesh.ply", model_path)["points_depth"]
    for kind in record.values():  # both ask for the error relative to the depth
        shares = [kind["right_1_percent"], kind["right_2_percent"], kind["coverage"]]
        assert shares == [0, 1, 1]
    row = next(row for row in tables.mesh_tables({"faces": 2, "points_depth": record}).splitlines()
               if row.startswith("| absolute"))  # fmt: skip
    assert row.endswith("| 1 | 0 | 0 | 1 |")


def test_window_takes_the_nearer_side_of_a_depth_step(model_path):
    model = load_model(model_path)
    truth = np.full((60, 80), 150, dtype=np.float32)
    truth[30:, :] = 100.5  # the step runs through the points at y = 0
    reference = depth.ReferenceDepth(view=model.views[2], depth=truth, scale=1.0)
    middle = model.selected(model.points3D_xyz[:, 1] == 0)
    errors = edges.depth_window_errors(middle, [reference])
    np.testing.assert_allclose(errors, 0.5 / 100.5, rtol=1e-5)
    assert len(errors) == 7


def test_reprojection_errors_of_moved_points(model_path):
    model = load_model(model_path)
    moved = np.add(model.points3D_xyz, (0.5, 0, 0))  # half a unit is half a pixel here
    errors = edges.reprojection_errors(replace(model, points3D_xyz=moved))
    assert errors["distance_px"]["median"] == pytest.approx(0.5)
    assert errors["within_1_px"] == 1.0
    assert errors["observations_mean"] == 5


def test_shifted_line_scores_zero_or_one():
    line = Curves(points=np.array([(0, 0, 0), (1, 0, 0.0)]), segments=np.array([(0, 1)]))
    moved = Curves(points=np.add(line.points, (0, 0.015, 0)), segments=line.segments)
    errors = curves.compare_curves(moved, line, (0.01, 0.02))
    assert [row["f_score"] for row in errors["scores"]] == [0, 1]
    assert errors["accuracy"] == pytest.approx(0.015)


def test_half_a_line_has_half_the_recall():
    line = Curves(points=np.array([(0, 0, 0), (1, 0, 0.0)]), segments=np.array([(0, 1)]))
    half = Curves(points=line.points * 0.5, segments=line.segments)
    (row,) = curves.compare_curves(half, line, (0.002,))["scores"]
    assert row["precision"] == 1
    assert row["recall"] == pytest.approx(0.5, abs=0.003)


def test_unit_size_and_crop():
    line = Curves(points=np.array([(0, 0, 0), (200, 0, 0.0)]), segments=np.array([(0, 1)]))
    far = np.array([(0, 0.5, 0), (200, 0.5, 0), (0, 90, 0), (200, 90, 0.0)])
    result = Curves(points=far, segments=np.array([(0, 1), (2, 3)]))
    (row,) = curves.compare_curves(result, line, (0.005,), unit_size=True)["scores"]
    assert row["precision"] == 0.5
    (row,) = curves.compare_curves(result, line, (0.005,), unit_size=True, crop=True)["scores"]
    assert row["precision"] == 1
    assert row["recall"] == 1


def test_samples_stand_for_equal_lengths():
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 3, 0), (1, 3, 0.0)])
    result = Curves(points=points, segments=np.array([(0, 1), (1, 2), (2, 3)]))
    samples = curves.sample(result, 0.5)
    assert len(samples) == 2 + 6
    np.testing.assert_allclose(samples[:2, 0], (0.25, 0.75))


def test_hidden_curves_are_not_asked_for(model_path):
    views = load_model(model_path).views
    shown, hidden = np.array([(-10, 0, 0), (10, 0, 0.0)]), np.array([(-10, 5, 9), (10, 5, 9.0)])
    truth = Curves(points=np.vstack([shown, hidden]), segments=np.array([(0, 1), (2, 3)]))
    found = Curves(points=np.add(shown, (0, 0.8, 0)), segments=np.array([(0, 1)]))
    surface = plane(0.0)
    errors = curves.compare_visible_curves(found, truth, views, surface, thresholds_px=(0.5, 1))
    assert [row["recall"] for row in errors["scores"]] == [0, 1]  # a pixel is one unit at 100
    assert [row["precision"] for row in errors["scores"]] == [0, 1]
    by_views = [
        (row["min_views"], row["max_views"], row["recall"]) for row in errors["recall_by_views"]
    ]
    assert by_views == [(0, 0, [0, 0]), (5, 8, [0, 1])]
    assert [row["length"] for row in errors["recall_by_views"]] == pytest.approx([20, 20], rel=0.01)
    caster = RayCaster(surface.vertices, surface.faces)
    counts, _ = curves.visibility(truth.points, views, caster)
    assert counts.tolist() == [5, 5, 0, 0]
    everything = curves.compare_visible_curves(found, truth, views, thresholds_px=(1,))
    assert everything["scores"][0]["recall"] == pytest.approx(0.5, abs=0.01)
    assert everything["on_surface"] == []


def test_marks_on_the_surface_differ_from_points_off_it(model_path):
    views = load_model(model_path).views
    truth = Curves(points=np.array([(-10, 0, 0), (10, 0, 0.0)]), segments=np.array([(0, 1)]))
    # Of 60 units of length 20 are on the curve, 20 a mark, 20 at 1.5 pixels above the surface.
    ends = [(x, y, z) for y, z in ((0, 0), (5, 0), (10, -1.5)) for x in (-10.0, 10)]
    found = Curves(points=np.array(ends), segments=np.array([(0, 1), (2, 3), (4, 5)]))
    errors = curves.compare_visible_curves(found, truth, views, plane(0.0), thresholds_px=(1, 2))
    assert [row["precision"] for row in errors["scores"]] == pytest.approx([1 / 3, 1 / 3], abs=1e-3)
    assert errors["on_surface"] == pytest.approx([2 / 3, 1], abs=1e-3)


def test_recall_by_views_doubles_its_ranges():
    counts = np.array([0, 1, 2, 3, 4, 5, 8, 9, 17])
    distances = np.where(counts % 2 == 1, 0.5, 5.0)
    rows = curves.recall_by_views(distances, counts, (1.0,), 0.25)
    assert [(row["min_views"], row["max_views"]) for row in rows] == [
        (0, 0), (1, 1), (2, 2), (3, 4), (5, 8), (9, 16), (17, 32),
    ]  # fmt: skip
    assert [row["recall"][0] for row in rows] == [0, 1, 0, 0.5, 0.5, 1, 1]
    assert rows[3]["length"] == 0.5


def test_gross_segments_are_counted():
    points = np.column_stack([np.r_[np.arange(30.0), 1000], np.zeros(31), np.zeros(31)])
    chain = Curves(points=points, segments=np.array([(i, i + 1) for i in range(30)]))
    lengths = edges.segment_lengths(chain)
    assert (lengths["gross"], lengths["median"], lengths["gross_total"]) == (1, 1.0, 971.0)
    assert lengths["total"] == 1000


def write_edges(path, points, segments):
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element edge {len(segments)}\nproperty int vertex1\nproperty int vertex2\n"
        "property uchar red\nend_header\n"
    )
    rows = np.zeros(len(segments), dtype=[("vertices", "<i4", 2), ("red", "u1")])
    rows["vertices"] = segments
    path.write_bytes(header.encode() + np.asarray(points, "<f8").tobytes() + rows.tobytes())


def test_edges_are_read_from_ply(tmp_path):
    write_edges(tmp_path / "edges.ply", [(0, 0, 0), (1, 2, 3), (4, 5, 6)], [(0, 1), (1, 2)])
    found = load_curves(tmp_path / "edges.ply")
    assert found.segments.tolist() == [[0, 1], [1, 2]]
    assert found.points[2].tolist() == [4, 5, 6]


def test_scripts_write_figures_and_report_bad_input(model_path, tmp_path):
    plane(1.0).export(tmp_path / "mesh.ply")
    write_edges(tmp_path / "edges.ply", [(0, 0, 0), (1, 0, 0)], [(0, 1)])
    paths = ("--mesh_path", tmp_path / "mesh.ply", "--input_path", model_path)
    run_script("evaluate.py", "scene", *paths, "--output_path", tmp_path / "out")
    record = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert record["points_depth"]["absolute"]["mae"] == pytest.approx(1, abs=1e-5)
    sparse = ("--edges_path", tmp_path / "edges.ply", "--sparse_path", model_path)
    done = run_script("evaluate.py", "edges", *sparse, "--reference_path", tmp_path / "edges.ply")
    assert "| 0.005 | 1 | 1 | 1 |" in done.stdout
    np.savez(tmp_path / "none.npz", points=np.zeros((0, 3)), edges=np.zeros((0, 2), int))
    done = run_script(
        *("evaluate.py", "edges", *sparse, "--reference_path", tmp_path / "none.npz"), code=1
    )
    assert "none.npz holds no curve" in done.stderr
    done = run_script("evaluate.py", "scene", *paths[:2], "--input_path", tmp_path, code=1)
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
