"""Refinement of meshes: the kernel against numpy, what it keeps, and what it learns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from curves import make_view
from solid_points import fibonacci_sphere

from colmap_edges.surfaces import refinement
from colmap_edges.surfaces.information import COLUMNS, ROWS, Tracks, information_of, noise_px
from colmap_edges.surfaces.mesh import Mesh

mesher = pytest.importorskip("colmap_edges._mesher", reason="the CGAL extension is not built")

NO_CREASES = np.zeros((0, 2), np.int32)
IDENTITY = np.array([1.0, 0, 0, 1, 0, 1])


def grid_mesh(size, height, step=1.0):
    """Vertices and faces of a height field over a square grid; the inner vertices."""
    y, x = (of.ravel() for of in np.mgrid[:size, :size] * step)
    vertices = np.column_stack([x, y, height(x, y)])
    index = np.arange(size * size).reshape(size, size)
    a, b, c, d = (
        of.ravel() for of in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    )
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    inner = np.zeros((size, size), bool)
    inner[1:-1, 1:-1] = True
    return vertices, faces.astype(np.int32), inner.ravel()


def matrices(information):
    full = np.zeros((len(information), 3, 3))
    full[:, ROWS, COLUMNS] = full[:, COLUMNS, ROWS] = information
    return full


def units(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def normals_of(vertices, faces):
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def numpy_refined(vertices, faces, creases, information, smoothness, rounds):
    """The energy of docs/meshing.md, minimised as the kernel does, face by face."""
    sides = {}
    for f, face in enumerate(faces):
        for k in range(3):
            sides.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append(f)
    cut = {frozenset(pair) for pair in creases}
    information = matrices(information)
    for side, owners in sides.items():
        if len(owners) == 1:
            information[list(side)] = 0
    neighbors = [[] for _ in faces]
    for side, owners in sides.items():
        if len(owners) == 2 and side not in cut:
            neighbors[owners[0]].append(owners[1])
            neighbors[owners[1]].append(owners[0])
    moves = np.trace(information, axis1=1, axis2=2) > 0
    typical = np.sort(np.trace(information[moves], axis1=1, axis2=2) / 3)[moves.sum() // 2]
    small = 1e-9 * typical * np.eye(3)
    x = vertices.copy()
    for _ in range(rounds):
        cross = normals_of(x, faces)
        areas, measured = np.linalg.norm(cross, axis=1), units(cross)
        variances = np.zeros(len(faces))
        for f, face in enumerate(faces):
            for k in np.flatnonzero(moves[face]):
                side = np.linalg.norm(x[face[(k + 1) % 3]] - x[face[(k + 2) % 3]])
                covariance = np.linalg.inv(information[face[k]] + small)
                variances[f] += measured[f] @ covariance @ measured[f] * (side / areas[f]) ** 2
        variances = np.minimum(variances, 1)
        certain = areas / np.sort(areas)[len(areas) // 2] / (0.1 + variances)
        normals = measured
        for _ in range(10):
            sums = certain[:, None] * measured
            for f, around in enumerate(neighbors):
                for g in around:
                    scale = smoothness[1] ** 2 + 0.2 * (variances[f] + variances[g])
                    q = ((normals[f] - normals[g]) ** 2).sum() / scale
                    sums[f] = sums[f] + smoothness[0] * (1 + q / 16) ** -8 * certain[g] * normals[g]
            normals = units(sums)
        left, right = information.copy(), np.zeros_like(x)
        for v in np.flatnonzero(moves):
            moved = x[v] - vertices[v]
            left[v] /= 1 + moved @ information[v] @ moved / 8
            right[v] = left[v] @ vertices[v] + small @ x[v]
            left[v] += small
        for f, face in enumerate(faces):
            left[face] += 2 * typical * np.outer(normals[f], normals[f])
        for _ in range(5):
            sums = right.copy()
            for f, face in enumerate(faces):
                sums[face] += 2 * typical * (normals[f] @ x[face].mean(axis=0)) * normals[f]
            x = np.array(
                [np.linalg.solve(left[v], sums[v]) if moves[v] else x[v] for v in range(len(x))]
            )
    return x


def test_kernel_equals_numpy():
    rng = np.random.default_rng(3)
    vertices, faces, _ = grid_mesh(6, lambda x, y: np.abs(x - 2.5) + 0.02 * rng.normal(size=36))
    factors = rng.normal(size=(36, 3, 3)) * 20
    information = (factors @ factors.transpose(0, 2, 1) + 9000 * np.eye(3))[:, ROWS, COLUMNS]
    creases = np.array([[14, 20], [21, 15]], np.int32)
    refiner = mesher.Refiner(vertices, faces, creases, information, 2)
    expected = numpy_refined(vertices, faces, creases, information, (2, 0.05), 3)
    np.testing.assert_allclose(refiner.refine(2, 0.05, 3), expected, atol=1e-9)
    assert np.abs(expected - vertices).max() > 0.005


def test_held_out_vertices_are_predicted_without_their_measurement():
    vertices, faces, _ = grid_mesh(7, lambda x, y: 0.3 * x)
    information = np.tile(100 * IDENTITY, (49, 1))
    held_out = np.array([16, 24, 0], np.int32)  # the last one is on the border
    moved = vertices.copy()
    moved[24] += [-0.3, 0, 1.0] / np.linalg.norm([-0.3, 0, 1.0]) * 0.2  # two deviations off
    refiner = mesher.Refiner(moved, faces, NO_CREASES, information, 1)
    errors = refiner.held_out_errors(held_out, 16, 0.05, 4)[:, 0]
    np.testing.assert_allclose(errors, [0, 4, -1], atol=0.1)


def test_faces_between_creases_become_smooth():
    rng = np.random.default_rng(0)
    size, sigma = 21, 0.05
    roof = lambda x, y: -np.abs(x - 10)  # noqa: E731
    vertices, faces, inner = grid_mesh(size, roof)
    noisy = vertices + sigma * rng.normal(size=vertices.shape) * inner[:, None]
    ridge = np.arange(size) * size + size // 2
    noisy[ridge] = vertices[ridge]
    information = np.tile(IDENTITY / sigma**2, (len(vertices), 1))
    information[ridge] *= 100
    creases = np.column_stack([ridge[:-1], ridge[1:]]).astype(np.int32)
    refined = mesher.Refiner(noisy, faces, creases, information, 1).refine(16, 0.1, 6)

    true = units(normals_of(vertices, faces))
    angles = [
        np.degrees(np.arccos(np.clip((units(normals_of(of, faces)) * true).sum(1), -1, 1)))
        for of in (noisy, refined)
    ]
    assert np.median(angles[1]) < 0.3 * np.median(angles[0])
    at_ridge = np.isin(faces, ridge).any(axis=1)
    assert np.median(angles[1][at_ridge]) < 0.3 * np.median(angles[0][at_ridge])
    np.testing.assert_array_equal(refined[~inner], noisy[~inner])
    assert np.abs(refined - noisy).max() < 8 * sigma


def test_a_sphere_without_noise_keeps_its_shape_where_points_are_certain():
    from scipy.spatial import ConvexHull

    points = fibonacci_sphere(500)
    information = np.tile(IDENTITY / 1e-4**2, (len(points), 1))
    faces = ConvexHull(points).simplices.astype(np.int32)
    turned = (normals_of(points, faces) * points[faces[:, 0]]).sum(axis=1) < 0
    faces[turned] = faces[turned][:, ::-1]
    refined = mesher.Refiner(points, faces, NO_CREASES, information, 1).refine(16, 0.1, 6)
    assert np.abs(np.linalg.norm(refined, axis=1) - 1).max() < 8e-4


def segment_hits(start, end, triangle):
    """Whether a segment passes through the inside of a triangle, in general position."""

    def volume(a, b, c, d):
        return np.sign(np.dot(np.cross(b - a, c - a), d - a))

    a, b, c = triangle
    across = volume(a, b, c, start) != volume(a, b, c, end)
    return across and len({volume(start, end, *pair) for pair in ((a, b), (b, c), (c, a))}) == 1


def crossing_pairs(vertices, faces):
    """Pairs of faces of which a side of one passes through the other; brute force."""
    found = set()
    for f in range(len(faces)):
        for g in range(len(faces)):
            for k in range(3):
                ends = faces[f][[k, (k + 1) % 3]]
                if not np.isin(ends, faces[g]).any() and segment_hits(
                    *vertices[ends], vertices[faces[g]]
                ):
                    found.add((min(f, g), max(f, g)))
    return found


def test_intersections_equal_brute_force():
    rng = np.random.default_rng(5)
    vertices = rng.random((40, 3))
    faces = rng.permuted(np.tile(np.arange(40), (30, 1)), axis=1)[:, :3].astype(np.int32)
    expected = crossing_pairs(vertices, faces)
    assert len(expected) > 20
    assert {tuple(pair) for pair in mesher.intersections(vertices, faces, 2).tolist()} == expected
    duplicated = vertices[faces].reshape(-1, 3)  # each face has its own vertices
    alone = np.arange(len(duplicated), dtype=np.int32).reshape(-1, 3)
    assert {tuple(pair) for pair in mesher.intersections(duplicated, alone, 1).tolist()} == expected


def test_no_triangle_turns_over_or_passes_another():
    """Two rough sheets, closer than their noise: smoothing alone would mix them up."""
    rng = np.random.default_rng(1)
    vertices, faces, _ = grid_mesh(15, lambda x, y: 0.4 * rng.random(len(x)))
    below = vertices * [1, 1, -1] - [0, 0, 0.02]
    below[:, 2] = vertices[:, 2] - 0.05
    both = np.concatenate([vertices, below])
    all_faces = np.concatenate([faces, faces[:, ::-1] + len(vertices)]).astype(np.int32)
    assert not len(mesher.intersections(both, all_faces, 1))
    weak = np.tile(IDENTITY, (len(both), 1)) * rng.choice([0.1, 100], (len(both), 1))
    refined = mesher.Refiner(both, all_faces, NO_CREASES, weak, 1).refine(16, 0.1, 6)
    assert not len(mesher.intersections(refined, all_faces, 1))
    assert ((normals_of(refined, all_faces) * normals_of(both, all_faces)).sum(axis=1) > 0).all()
    assert (refined != both).any()


def test_sheets_that_touch_stay_together():
    vertices, faces, _ = grid_mesh(5, lambda x, y: 0.1 * (x * 7 % 3))
    double = np.concatenate([vertices, vertices[[12]]])
    faces[np.flatnonzero((faces == 12).any(axis=1))[:3]] = np.where(
        (part := faces[np.flatnonzero((faces == 12).any(axis=1))[:3]]) == 12, 25, part
    )
    information = np.tile(IDENTITY, (26, 1))
    refined = mesher.Refiner(double, faces, NO_CREASES, information, 1).refine(16, 0.1, 6)
    np.testing.assert_array_equal(refined[[12, 25]], double[[12, 25]])


def test_bad_input_is_refused():
    vertices, faces, _ = grid_mesh(3, lambda x, y: 0 * x)
    information = np.tile(IDENTITY, (9, 1))
    for change in (
        {"faces": faces + 9},
        {"creases": np.array([[0, 9]], np.int32)},
        {"information": information[1:]},
    ):
        given = {"vertices": vertices, "faces": faces, "creases": NO_CREASES, **change}
        with pytest.raises(ValueError, match=r"9|number"):
            mesher.Refiner(**{"information": information, **given}, num_threads=1)


def camera(center, focal=500.0):
    """A view towards the origin."""
    forward = units(-np.asarray(center, float))
    right = units(np.cross([0.0, 1.0, 0.2], forward))
    rotation = np.array([right, np.cross(forward, right), forward])
    given = {"model": "PINHOLE", "width": 640, "height": 480, "params": [focal, focal, 320, 240]}
    return make_view(rotation, -rotation @ center, camera=pycolmap.Camera(**given))


def observed(num_points=200, sigma=0.3, seed=0):
    """Views, and tracks of points with noisy observations, triangulated to first order."""
    rng = np.random.default_rng(seed)
    views = [camera(5 * center) for center in fibonacci_sphere(6)]
    points = rng.uniform(-1, 1, (num_points, 3))
    seen = np.array([view.project(points)[0] for view in views])
    pixels = (seen + sigma * rng.normal(size=seen.shape)).transpose(1, 0, 2).reshape(-1, 2)
    offsets = np.arange(num_points + 1) * len(views)
    return views, Tracks(points, offsets, np.tile(np.arange(6, dtype=np.int32), num_points), pixels)


def test_information_is_the_inverse_covariance_of_a_track():
    views, tracks = observed(5)
    found = matrices(information_of(views, tracks)) * noise_px(views, tracks) ** 2
    steps = 1e-6 * np.eye(3)
    for point, information in zip(tracks.points, found, strict=True):
        rows = [
            np.column_stack(
                [
                    (view.project((point + step)[None])[0][0] - view.project(point[None])[0][0])
                    / 1e-6
                    for step in steps
                ]
            )
            for view in views
        ]
        jacobian = np.concatenate(rows)
        np.testing.assert_allclose(information, jacobian.T @ jacobian, rtol=1e-3, atol=1)


def test_noise_is_corrected_for_the_length_of_tracks():
    views, tracks = observed(400)
    # Of the points as they are, residuals have all degrees of freedom.
    whole = noise_px(views, tracks) * np.sqrt((2 * 6 - 3) / (2 * 6))
    assert whole == pytest.approx(0.3, rel=0.1)
    exact = tracks._replace(
        pixels=np.concatenate(
            [view.project(tracks.points)[0][:, None] for view in views], 1
        ).reshape(-1, 2)
    )
    assert noise_px(views, exact) == 0.05
    short = tracks._replace(offsets=np.arange(1201) * 2, points=np.repeat(tracks.points, 3, axis=0))
    assert noise_px(views, short) == 1.0


def test_edges_are_measured_across_only():
    views, tracks = observed(1)
    normals = np.tile(np.array([[1, 0]], np.float32), (6, 1))
    both = information_of(views, tracks) * noise_px(views, tracks) ** 2
    across = tracks._replace(normals=normals)
    down = tracks._replace(normals=normals[:, ::-1].copy())
    parts = [information_of(views, of) * noise_px(views, of) ** 2 for of in (across, down)]
    added = refinement.isotropic(0.1 * refinement.mean_of(both))
    np.testing.assert_allclose(sum(parts), both + added, rtol=1e-9)
    unknown = tracks._replace(normals=np.full((6, 2), np.nan, np.float32))
    half = information_of(views, unknown) * noise_px(views, unknown) ** 2
    np.testing.assert_allclose(2 * half, both + added, rtol=1e-9)


def measured_mesh(height, sigma, seed=0):
    """A mesh of a height field, its information, as if of SfM points."""
    rng = np.random.default_rng(seed)
    vertices, faces, _ = grid_mesh(40, height)
    noisy = vertices + sigma * rng.normal(size=vertices.shape)
    count = len(vertices)
    mesh = Mesh(
        vertices=noisy,
        faces=faces,
        point3D_ids=np.arange(count, dtype=np.int64),
        colors=np.zeros((count, 3), np.uint8),
    )
    measured = refinement.Measured.__new__(refinement.Measured)
    measured.information, measured.num_certain = np.tile(IDENTITY / sigma**2, (count, 1)), count
    return vertices, mesh, measured


def test_smoothness_is_learned_from_the_scene():
    _, flat, measured = measured_mesh(lambda x, y: 0.1 * x, 0.05)
    smooth = refinement.refined(flat, measured, 1)
    assert smooth.stats["smooth_angle_rad"] == 0.1
    off = [np.abs(of.vertices[:, 2] - 0.1 * of.vertices[:, 0]).mean() for of in (flat, smooth)]
    assert off[1] < 0.6 * off[0]

    # Flat folds of 5 degrees, of which the points are certain.
    _, rough, measured = measured_mesh(lambda x, y: 0.04 * np.abs(x % 8 - 4), 1e-3)
    kept = refinement.refined(rough, measured, 1)
    assert kept.stats["smooth_angle_rad"] == 0.02
    assert np.abs(kept.vertices - rough.vertices).max() <= 8e-3


def test_the_result_does_not_depend_on_threads():
    _, mesh, measured = measured_mesh(lambda x, y: np.sin(x / 5), 0.05)
    one, many = (refinement.refined(mesh, measured, threads) for threads in (1, 5))
    np.testing.assert_array_equal(one.vertices, many.vertices)


def test_few_points_tell_nothing():
    _, mesh, measured = measured_mesh(lambda x, y: 0 * x, 0.05)
    measured.num_certain = 100
    refined = refinement.refined(mesh, measured, 1)
    np.testing.assert_array_equal(refined.vertices, mesh.vertices)
    assert "smooth_angle_rad" not in refined.stats


def test_points_without_measurement_take_that_next_to_them():
    _, mesh, measured = measured_mesh(lambda x, y: 0 * x, 0.05)
    measured.information = measured.information[:-1] * np.arange(1, 1600)[:, None]
    ids = mesh.point3D_ids.copy()
    ids[5] = -1
    information, certain = measured.of_vertices(replace(mesh, point3D_ids=ids))
    assert not certain[5] and not certain[-1] and certain[:5].all()
    assert information[5, 0] in measured.information[[4, 6, 45, 44, 46], 0]
    near = 100 * measured.information[[-1, -40, -41], 0]
    assert np.isclose(near, information[-1, 0]).any()


def test_held_out_vertices_share_no_face():
    _, faces, inner = grid_mesh(30, lambda x, y: 0 * x)
    chosen = refinement.chosen_apart(inner, faces)
    assert 40 < len(chosen) < 90 and inner[chosen].all()
    assert np.isin(faces, chosen).sum(axis=1).max() == 1
