"""Shapes of triangles: needles and caps vanish; points, creases and topology stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from meshes import make_mesh
from scipy.spatial import ConvexHull, Delaunay
from solid_points import fibonacci_sphere

from colmap_edges.surfaces.shaping import shaped

mesher = pytest.importorskip("colmap_edges._mesher", reason="the CGAL extension is not built")

IDENTITY = np.array([1.0, 0, 0, 1, 0, 1])
SIGMA = 0.01


def roof(sigma=SIGMA, slope=0.5, seed=0):
    """Two slopes with few noisy points, and a ridge along x = 0 with many: fans of needles."""
    rng = np.random.default_rng(seed)
    ridge = np.column_stack([np.zeros(81), np.linspace(-2, 2, 81)])
    corners = np.array([[-2, -2], [-2, 2], [2, -2], [2, 2.0]])
    others = rng.uniform(-1.9, 1.9, (60, 2))
    others = others[np.abs(others[:, 0]) > 0.15]
    flat = np.concatenate([ridge, corners, others])
    vertices = np.column_stack([flat, -slope * np.abs(flat[:, 0])])
    vertices[:, 2] += sigma * np.clip(rng.normal(size=len(flat)), -1, 1) / 2
    faces = Delaunay(flat).simplices
    return make_mesh(vertices, faces, np.column_stack([np.arange(80), np.arange(1, 81)]))


def information(mesh, sigma=SIGMA):
    return np.tile(IDENTITY / sigma**2, (len(mesh.vertices), 1))


def normals_of(mesh):
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return np.cross(b - a, c - a)


def smallest_angles(mesh):
    corners = mesh.vertices[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    sides.sort(axis=1)
    sines = np.linalg.norm(normals_of(mesh), axis=1) / (sides[:, 1] * sides[:, 2])
    return np.degrees(np.arcsin(np.clip(sines, 0, 1)))


def sides_of(faces):
    """Sorted sides of faces, and how many faces have each."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)


def euler_characteristic(mesh):
    return len(np.unique(mesh.faces)) - len(sides_of(mesh.faces)[0]) + len(mesh.faces)


def distances(points, mesh):
    """Distances (N,) of points from a mesh, by brute force: of dense samples of its triangles."""
    steps = np.linspace(0, 1, 41)
    u, v = (of.ravel() for of in np.meshgrid(steps, steps))
    inside = u + v <= 1
    weights = np.column_stack([1 - u - v, u, v])[inside]
    best = np.full(len(points), np.inf)
    for corners in mesh.vertices[mesh.faces]:
        samples = weights @ corners
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        off = np.linalg.norm(points[:, None] - samples, axis=2).min(axis=1)
        # Over the inside of a triangle the plane is nearer than its samples.
        normal /= np.linalg.norm(normal)
        local = np.linalg.lstsq((corners[1:] - corners[0]).T, (points - corners[0]).T, rcond=None)[
            0
        ]
        over = (local >= 0).all(axis=0) & (local.sum(axis=0) <= 1)
        off[over] = np.abs((points[over] - corners[0]) @ normal)
        best = np.minimum(best, off)
    return best


def test_needles_vanish_and_everything_else_stays():
    mesh = roof()
    result = shaped(mesh, information(mesh), 1)
    needles = [np.count_nonzero(smallest_angles(of) < 5) for of in (mesh, result)]
    assert needles[0] > 60 and needles[1] < needles[0] / 10
    assert euler_characteristic(result) == euler_characteristic(mesh)
    assert not len(mesher.intersections(result.vertices, result.faces, 1))
    assert (normals_of(result)[:, 2] > 0).all()
    assert set(sides_of(result.faces)[1]) == {1, 2}
    assert distances(mesh.vertices, result).max() < SIGMA * 1.05
    # The ridge is still there, as sides of faces with fewer vertices, and so is the border.
    sides = set(map(tuple, sides_of(result.faces)[0].tolist()))
    assert {tuple(crease) for crease in result.creases.tolist()} <= sides
    ends = result.vertices[result.creases]
    assert 2 < len(ends) < 60
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum() == pytest.approx(4, abs=0.01)
    assert np.abs(ends[..., 0]).max() == 0
    np.testing.assert_allclose(normals_of(result)[:, :2].sum(0), normals_of(mesh)[:, :2].sum(0))


def test_vertices_keep_their_points():
    mesh = roof()
    result = shaped(mesh, information(mesh), 1)
    old = result.point3D_ids >= 0
    np.testing.assert_array_equal(result.vertices[old], mesh.vertices[result.point3D_ids[old]])
    assert (result.colors[old] == 7).all() and not result.colors[~old].any()
    assert result.stats["vertices_left_out"] == len(mesh.vertices) - np.count_nonzero(old)
    assert result.stats["vertices_inserted"] == np.count_nonzero(~old)


def test_certain_points_of_bent_edges_stay():
    """Every point of a circle is farther from its neighbours' chord than its noise."""
    angles = np.arange(60) * 2 * np.pi / 60
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    flat = np.concatenate([circle, [[0, 0.0]], 3 * circle[::10]])
    faces = Delaunay(flat).simplices
    vertices = np.column_stack([flat, np.zeros(len(flat))])
    mesh = make_mesh(vertices, faces, np.column_stack([np.arange(60), np.roll(np.arange(60), -1)]))
    result = shaped(mesh, information(mesh, 1e-4), 1)
    assert np.isin(np.arange(60), result.point3D_ids).all()
    assert len(result.creases) == 60
    before, after = (np.count_nonzero(smallest_angles(of) < 5) for of in (mesh, result))
    assert before >= 60 and after == 0  # since vertices are inserted


def test_creases_are_not_swapped():
    """A flat cap with its longest side on a crease, of which all points are certain."""
    flat = np.array([[-1, 0], [1, 0], [0, 0.03], [0, -1.0]])
    mesh = make_mesh(np.column_stack([flat, np.zeros(4)]), [[0, 1, 2], [0, 3, 1]])
    swapped = shaped(mesh, information(mesh, 1e-3), 1)
    assert {2, 3} in [set(side) for side in sides_of(swapped.faces)[0].tolist()]
    creased = replace(mesh, creases=np.array([[0, 1]], np.int32))
    np.testing.assert_array_equal(shaped(creased, information(mesh, 1e-3), 1).faces, creased.faces)


@pytest.mark.parametrize("seed", range(4))
def test_closed_surfaces_stay_closed(seed):
    """Flattened bodies with large noise: nearly all triangles are needles and may be replaced."""
    rng = np.random.default_rng(seed)
    points = fibonacci_sphere(300) * [1, 1, 0.1] + 0.002 * rng.normal(size=(300, 3))
    hull = ConvexHull(points)
    faces = hull.simplices
    turned = (
        np.cross(*(points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2)))
        * hull.equations[:, :3]
    ).sum(axis=1) < 0
    faces[turned] = faces[turned][:, ::-1]
    mesh = make_mesh(points * [1, 0.05, 1], faces)
    result = shaped(mesh, information(mesh, 0.02), 1)
    assert len(result.faces) != len(mesh.faces)
    assert euler_characteristic(result) == 2
    assert set(sides_of(result.faces)[1]) == {2}
    assert not len(mesher.intersections(result.vertices, result.faces, 1))


def test_a_tetrahedron_stays():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0.01, 0], [0, 0, 0.01]])
    mesh = make_mesh(vertices, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    result = shaped(mesh, information(mesh, 10), 1)
    assert len(result.faces) == 4 and len(np.unique(result.faces)) == 4


def test_vertices_without_information_and_touching_sheets_stay():
    mesh = roof()
    none = np.zeros((len(mesh.vertices), 6))
    result = shaped(mesh, none, 1)
    assert result.stats["vertices_left_out"] == 0
    double = replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, mesh.vertices.copy()]),
        faces=np.concatenate([mesh.faces, mesh.faces[:, ::-1] + len(mesh.vertices)]).astype(
            np.int32
        ),
        point3D_ids=np.arange(2 * len(mesh.vertices)),
        colors=np.concatenate([mesh.colors, mesh.colors]),
    )
    assert shaped(double, information(double), 1).stats["vertices_left_out"] == 0


def test_the_result_depends_on_neither_threads_nor_unit():
    mesh = roof()
    one, many = (shaped(mesh, information(mesh), threads) for threads in (1, 5))
    large = replace(mesh, vertices=1024 * mesh.vertices)
    far = shaped(large, information(mesh) / 1024**2, 1)
    for other in (many, far):
        np.testing.assert_array_equal(one.faces, other.faces)
        np.testing.assert_array_equal(one.creases, other.creases)
    np.testing.assert_array_equal(one.vertices, many.vertices)
    np.testing.assert_array_equal(1024 * one.vertices, far.vertices)


def test_bad_input_is_refused():
    mesh = roof()
    for bad in (
        replace(mesh, faces=mesh.faces + 1),
        replace(mesh, creases=np.array([[0, len(mesh.vertices)]], np.int32)),
    ):
        with pytest.raises(ValueError, match="hold vertex"):
            shaped(bad, information(mesh), 1)
    with pytest.raises(ValueError, match="number"):
        shaped(mesh, information(mesh)[1:], 1)
