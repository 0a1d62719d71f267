"""Simplification: fewer triangles where it is flat; creases, colours and topology stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from meshes import make_mesh
from scipy.spatial import ConvexHull, Delaunay
from solid_points import fibonacci_sphere

from colmap_edges.surfaces.simplify import simplify

mesher = pytest.importorskip("colmap_edges._mesher", reason="the CGAL extension is not built")


def roof(bend=0.0):
    """Two noisy slopes and a ridge near x = 0 of 41 points, with a bend at its middle."""
    rng = np.random.default_rng(0)
    along = np.linspace(-2, 2, 41)
    ridge = np.column_stack([bend * (2 - np.abs(along)), along])
    corners = np.array([[-2, -2], [-2, 2], [2, -2], [2, 2.0]])
    others = rng.uniform(-1.9, 1.9, (400, 2))
    others = others[np.abs(others[:, 0] - bend * (2 - np.abs(others[:, 1]))) > 0.1]
    flat = np.concatenate([ridge, corners, others])
    height = -np.abs(flat[:, 0] - bend * (2 - np.abs(flat[:, 1])))
    vertices = np.column_stack([flat, height + 1e-3 * rng.normal(size=len(flat))])
    return make_mesh(vertices, Delaunay(flat).simplices, np.column_stack([range(40), range(1, 41)]))


def sides_of(faces):
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(sides, axis=0)


def euler_number(mesh):
    return len(mesh.vertices) - len(sides_of(mesh.faces)) + len(mesh.faces)


def distances(points, starts, ends):
    """(N,) distances of points from the nearest of some segments."""
    side = ends - starts
    offsets = points[:, None] - starts
    share = np.clip((offsets * side).sum(2) / (side**2).sum(1), 0, 1)
    return np.linalg.norm(offsets - share[..., None] * side, axis=2).min(axis=1)


def grid_faces(size):
    """Triangles of the vertices (x, y) -> size * x + y; sides join (x, y) and (x + 1, y + 1)."""
    first = (size * np.arange(size - 1)[:, None] + np.arange(size - 1)).ravel()
    right, above, beyond = first + size, first + 1, first + size + 1
    return np.concatenate(
        [np.stack([first, right, beyond], 1), np.stack([first, beyond, above], 1)]
    )


def saw_teeth(size, rows):
    """Sides that rise by one from each column to the next, and fall back there."""
    low = (size * np.arange(1, size - 2)[:, None] + np.array(rows)).ravel()
    tips = low + size + 1
    return np.concatenate([np.stack([low, tips], 1), np.stack([tips, tips - 1], 1)])


def heights(mesh, places):
    """(N,) heights of a mesh over (N, 2) places of a plane that it covers once."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)[:, 2]
    a, b, c = (corner[area != 0] for corner in (a, b, c))
    transform = np.linalg.inv(np.stack([(b - a)[:, :2], (c - a)[:, :2]], axis=2))
    shares = np.einsum("fij,nfj->nfi", transform, places[:, None] - a[:, :2])
    inside = np.minimum(shares.min(axis=2), 1 - shares.sum(axis=2))
    face = inside.argmax(axis=1)
    u, v = shares[np.arange(len(places)), face].T
    return a[face, 2] + u * (b - a)[face, 2] + v * (c - a)[face, 2]


@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_creases_stay_and_lose_the_points_that_say_nothing(bend):
    mesh = roof(bend)
    simple = simplify(mesh, len(mesh.faces) // 4)
    assert len(simple.faces) <= len(mesh.faces) // 4
    on_sides = sides_of(simple.faces)
    kept = {tuple(sorted(pair)) for pair in simple.creases.tolist()}
    assert kept <= set(map(tuple, on_sides.tolist())) and len(kept) < 20
    ends = simple.vertices[simple.creases]
    ridge = mesh.vertices[np.unique(mesh.creases)]
    assert distances(ridge, ends[:, 0], ends[:, 1]).max() <= 0.2 * 0.105
    assert not len(mesher.intersections(simple.vertices, simple.faces, 1))
    assert euler_number(simple) == euler_number(mesh) == 1
    up = np.cross(
        *(simple.vertices[simple.faces[:, k]] - simple.vertices[simple.faces[:, 0]] for k in (1, 2))
    )[:, 2]
    assert (np.sign(up) == np.sign(up[0])).all()


def test_vertices_keep_places_colours_and_points():
    mesh = roof()
    colors = np.random.default_rng(1).integers(0, 256, (len(mesh.vertices), 3))
    mesh = replace(mesh, colors=colors.astype(np.uint8))
    simple = simplify(mesh, 100)
    ids = simple.point3D_ids
    np.testing.assert_array_equal(simple.vertices, mesh.vertices[ids])
    np.testing.assert_array_equal(simple.colors, mesh.colors[ids])
    assert simple.stats["faces_before_simplification"] == len(mesh.faces)


def test_closed_surfaces_stay_closed_down_to_a_few_triangles():
    points = fibonacci_sphere(500)
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    inward = (
        np.einsum(
            "ij,ij->i",
            hull.equations[:, :3],
            np.cross(
                points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
            ),
        )
        < 0
    )
    faces[inward] = faces[inward][:, ::-1]
    mesh = make_mesh(points, faces)
    simple = simplify(mesh, 60)
    assert len(simple.faces) == 60 and euler_number(simple) == 2
    assert not len(mesher.intersections(simple.vertices, simple.faces, 1))
    assert len(simplify(mesh, 1).faces) >= 4
    assert simplify(mesh, len(mesh.faces)) is mesh


def test_creases_give_way_where_too_many_triangles_are_left():
    mesh = roof(0.3)
    simple = simplify(mesh, 8)
    assert len(simple.faces) <= 8
    assert not len(mesher.intersections(simple.vertices, simple.faces, 1))


def test_creases_give_way_before_the_surface_is_used_up():
    """Saw-tooth creases on a plane need more triangles than are left beside a hill."""
    x, y = (axis.ravel() for axis in np.mgrid[:40, :40])
    hill = 6 * np.exp(-((x - 20) ** 2 + (y - 28) ** 2) / 30)
    mesh = make_mesh(np.column_stack([x, y, hill]), grid_faces(40), saw_teeth(40, range(1, 17, 3)))
    simple = simplify(mesh, len(mesh.faces) // 10)
    error = np.abs(heights(simple, mesh.vertices[:, :2]) - hill)
    assert error.max() < 0.25 * hill.max() and len(simple.creases) > 50


def test_the_result_depends_on_neither_threads_nor_unit():
    mesh = roof(0.3)
    one, many = (simplify(mesh, 150, threads) for threads in (1, 5))
    large = simplify(replace(mesh, vertices=mesh.vertices * 1024), 150)
    for other in (many, large):
        np.testing.assert_array_equal(other.faces, one.faces)
        np.testing.assert_array_equal(other.creases, one.creases)
    np.testing.assert_array_equal(many.vertices, one.vertices)


def test_bad_input_is_refused():
    mesh = roof()
    beyond = np.array([[0, 1, len(mesh.vertices)]], np.int32)
    with pytest.raises(ValueError, match="faces"):
        simplify(replace(mesh, faces=np.concatenate([mesh.faces, beyond])), 10)
