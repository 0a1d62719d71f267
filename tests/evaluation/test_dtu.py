from dataclasses import replace

import miniature
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.layouts import dtu, neus
from colmap_edges.evaluation.metrics import dtu_distances
from colmap_edges.evaluation.triangulation import neighbor_pairs, triangulate


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return miniature.write(tmp_path_factory.mktemp("dtu"))


def brute_force_distances(points, reference):
    return np.array([np.linalg.norm(reference - p, axis=1).min() for p in points])


def test_accuracy_and_completeness_equal_brute_force(root):
    reference = dtu.load_reference(root, 6)
    generator = np.random.default_rng(0)
    points = reference.points[generator.permutation(len(reference.points))[:1500]]
    points = points + generator.normal(0, 0.3, points.shape) + [0, 0, 0.4]
    points[:40, 2] += 30  # farther than 20 mm, and outside the box
    errors = dtu_distances.evaluate_points(points, reference)

    cells = np.rint((points - reference.mask.box[0]) / 2.0).astype(int)
    inside = [
        all(0 <= c < n for c, n in zip(cell, reference.mask.cells.shape, strict=True))
        and reference.mask.cells[tuple(cell)]
        for cell in cells
    ]
    accuracy = brute_force_distances(points[np.array(inside)], reference.points)
    judged = reference.points[reference.points[:, 2] - 0.1 > 0]
    completeness = brute_force_distances(judged, points)
    assert errors["points"] == sum(inside)
    assert errors["accuracy"] == pytest.approx(accuracy[accuracy < 20].mean(), abs=1e-9)
    assert errors["completeness"] == pytest.approx(completeness[completeness < 20].mean(), abs=1e-9)
    assert errors["overall"] == pytest.approx((errors["accuracy"] + errors["completeness"]) / 2)
    assert len(judged) < len(reference.points) / 5  # the table itself is not asked for


def test_shifted_square_is_complete_to_its_shift(root):
    reference = dtu.load_reference(root, 6)
    corners = [(-12, -12), (12, -12), (12, 12), (-12, 12)]
    top = trimesh.Trimesh(
        [(x, y, miniature.HEIGHT + 1) for x, y in corners], [(0, 1, 2), (0, 2, 3)]
    )
    errors = dtu_distances.evaluate_mesh(top, reference)
    # Samples every 0.2 mm, reference every 0.5 mm: sideways distances add less than 6 %.
    assert errors["completeness"] == pytest.approx(1.0, abs=0.02)
    assert errors["accuracy"] == pytest.approx(1.0, abs=0.06)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 300))
def test_thinning_equals_walking_the_points(seed, count):
    points = np.random.default_rng(seed).uniform(0, 2, (count, 3))
    kept = []
    for point in points[np.random.default_rng(1).permutation(count)]:
        if all(np.linalg.norm(point - other) > 0.2 for other in kept):
            kept.append(point)
    np.testing.assert_array_equal(
        dtu_distances.thin(points, 0.2, seed=1), np.reshape(kept, (-1, 3))
    )


def test_thinned_points_are_near_all():
    points = np.random.default_rng(0).uniform(0, 4, (5_000, 3)) * [1, 1, 0]
    distance, _ = cKDTree(dtu_distances.thin(points, 0.2)).query(points)
    assert distance.max() <= 0.2


def test_poses_come_out_of_the_projections(root):
    folder, images = dtu.posed_images(root, 6)
    assert [image.name for image in images] == [f"rect_00{i}_max.png" for i in range(1, 7)]
    assert folder == root / "Rectified" / "scan6"
    for image, (rotation, translation) in zip(images, miniature.poses(), strict=True):
        np.testing.assert_allclose(image.calibration, miniature.CALIBRATION, atol=1e-8)
        np.testing.assert_allclose(image.rotation, rotation, atol=1e-10)
        np.testing.assert_allclose(image.translation, translation, atol=1e-8)
        assert (image.width, image.height) == miniature.SIZE
    _, other = dtu.posed_images(root, 6, light="3_r5000")
    assert other[0].name == "rect_001_3_r5000.png"


def test_repackaged_layout_gives_the_same_poses(root, tmp_path):
    (tmp_path / "image").mkdir()
    matrices = {}
    folder, images = dtu.posed_images(root, 6)
    for index, image in enumerate(images):
        (tmp_path / "image" / f"{index:06d}.png").write_bytes((folder / image.name).read_bytes())
        projection = np.column_stack([image.rotation, image.translation])
        matrices[f"world_mat_{index}"] = np.eye(4)
        matrices[f"world_mat_{index}"][:3] = image.calibration @ projection
        matrices[f"scale_mat_{index}"] = np.diag([50, 50, 50, 1.0])
    np.savez(tmp_path / "cameras_sphere.npz", **matrices)
    assert neus.is_layout(tmp_path)
    _, again = neus.posed_images(tmp_path)
    for a, b in zip(images, again, strict=True):
        np.testing.assert_allclose(a.center, b.center, atol=1e-8)


def test_triangulated_points_lie_on_the_surface(root, tmp_path):
    folder, images = dtu.posed_images(root, 6)
    model = model_from_reconstruction(triangulate(images, folder, tmp_path / "sparse"))
    assert len(model.views) == 6
    assert len(model.points3D_xyz) > 300
    x, y, z = model.points3D_xyz.T
    raised = (np.abs(x) < 11) & (np.abs(y) < 11)
    on_table = (np.abs(x) > 14) | (np.abs(y) > 14)
    assert np.median(np.abs(z[raised] - miniature.HEIGHT)) < 0.1
    assert np.median(np.abs(z[on_table])) < 0.1
    np.testing.assert_allclose(model.views[0].rotation, miniature.poses()[0][0], atol=1e-9)


def test_neighbours_are_the_nearest_centres(root):
    _, images = dtu.posed_images(root, 6)
    pairs = neighbor_pairs(images, 1)
    assert all(b - a == 1 for a, b in pairs)
    assert len(neighbor_pairs(images, 99)) == 15


@pytest.mark.parametrize(
    ("text", "expected"),
    [("odd", [1, 3, 5]), ("all", [1, 2, 3, 4, 5, 6]), ("2", [2]), ("6,1-3", [1, 2, 3, 6])],
)
def test_positions_and_light_choose_images(root, text, expected):
    chosen = dtu.parse_positions(text)
    _, images = dtu.posed_images(root, 6, light="3_r5000", positions=chosen)
    assert [image.name for image in images] == [f"rect_00{p}_3_r5000.png" for p in expected]
    for image, position in zip(images, expected, strict=True):
        rotation, _ = miniature.poses()[position - 1]
        np.testing.assert_allclose(image.rotation, rotation, atol=1e-10)


def test_of_49_positions_25_are_odd():
    assert sum(position in dtu.parse_positions("odd") for position in range(1, 50)) == 25


@pytest.mark.parametrize("text", ["", "even", "1,", "3-1", "0", "-3", "1.5", "1000"])
def test_invalid_positions_are_refused(text):
    with pytest.raises(ColmapEdgesError, match="give all, odd, or a list"):
        dtu.parse_positions(text)


def test_without_plane_the_accuracy_stays(root):
    whole = dtu.load_reference(root, 6)
    points = whole.points[::3] + np.array([0, 0, 0.4])
    expected = dtu_distances.evaluate_points(points, whole)
    found = dtu_distances.evaluate_points(points, replace(whole, plane=None))
    assert found == {name: expected[name] for name in ("accuracy", "accuracy_median", "points")}
    # Completeness is asked for within the box of the mask.
    for lacking in (replace(whole, mask=None), replace(whole, mask=None, plane=None)):
        assert dtu_distances.evaluate_points(points, lacking) == {}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda root: dtu.posed_images(root, 6, positions=frozenset([1, 7])), "position 007"),
        (lambda root: dtu.posed_images(root, 6, light="dark"), "its lights: 3_r5000, max"),
        (lambda root: dtu.posed_images(root, 99), "scan99"),
        (lambda root: dtu.load_reference(root, 99), "stl099"),
        (lambda root: dtu.posed_images(root, 6, light="dark"), "dark"),
        (lambda root: dtu.scan_numbers(root / "Rectified"), "none of the scans"),
    ],
)
def test_missing_data_is_named(root, call, message):
    with pytest.raises(ColmapEdgesError, match=message):
        call(root)


def test_scans_of_the_paper_are_found(root):
    assert dtu.scan_numbers(root) == [6]
