"""Vertices of a mesh fitted to the depths that patches measured."""

from dataclasses import replace

import numpy as np
import pytest
from textured_plane import NORMAL, OFFSET

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.surfaces.information import MIN_COSINE
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.patches.depths import NO_DEPTHS, Depths
from colmap_edges.surfaces.patches.fitting import (
    are_repeated,
    differences_of,
    fitted,
    normals_of_vertices,
)

mesher = pytest.importorskip("colmap_edges._mesher", reason="the CGAL extension is not built")

SIGMA = 0.02  # of vertices, world units
UP = NORMAL / np.linalg.norm(NORMAL)


def rough_plane(size=25, half=1.2):
    """A mesh around the textured plane, and the information of its vertices."""
    across = np.linalg.svd(UP[None])[2][1:]
    steps = np.stack(np.meshgrid(*[np.linspace(-half, half, size)] * 2), -1).reshape(-1, 2)
    rng = np.random.default_rng(0)
    plane = steps @ across + UP * OFFSET / np.linalg.norm(NORMAL)
    vertices = plane + SIGMA * rng.normal(size=(size**2, 1)) * UP
    index = np.arange(size**2, dtype=np.int32).reshape(size, size)
    a, b, c, d = (
        of.ravel() for of in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    )
    mesh = Mesh(
        vertices=vertices,
        faces=np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]),
        point3D_ids=np.arange(size**2, dtype=np.int64),
        colors=np.zeros((size**2, 3), np.uint8),
    )
    return mesh, np.tile(np.array([1, 0, 0, 1, 0, 1]) / SIGMA**2, (size**2, 1))


def off_plane(mesh):
    return np.abs(mesh.vertices @ UP - OFFSET / np.linalg.norm(NORMAL))


def test_depths_are_those_of_the_plane_within_their_noise(scene, depths):
    assert (np.diff(depths.views) >= 0).all()
    assert len(depths.views) > 300
    errors = []
    for index, view in enumerate(scene[0].views):
        own = depths.views == index
        local = np.column_stack([depths.rays[own], np.ones(own.sum())])
        points = view.center + depths.depths[own, None] * (local @ view.rotation)
        slopes = local @ view.rotation @ NORMAL
        errors.append((points @ NORMAL - OFFSET) / slopes / depths.sigmas[own])
    assert np.median(np.abs(np.concatenate(errors))) < 1


def test_vertices_move_to_what_patches_measured(scene, depths):
    mesh, information = rough_plane()
    found = fitted(mesh, information, scene[0].views, depths, 1)
    seen = off_plane(found) != off_plane(mesh)
    assert seen.mean() > 0.5
    assert np.median(off_plane(found)[seen]) < 0.4 * np.median(off_plane(mesh)[seen])
    moved = found.vertices - mesh.vertices
    across = np.cross(moved, normals_of_vertices(mesh))
    np.testing.assert_allclose(across, 0, atol=1e-12)  # along their normals only
    assert not len(mesher.intersections(found.vertices, found.faces, 1))
    many = fitted(mesh, information, scene[0].views, depths, 3)
    np.testing.assert_array_equal(found.vertices, many.vertices)


def test_certain_vertices_stay(scene, depths):
    mesh, information = rough_plane()
    found = fitted(mesh, 1e12 * information, scene[0].views, depths, 1)
    np.testing.assert_allclose(found.vertices, mesh.vertices, atol=1e-6)


def test_depths_of_another_surface_move_nothing(scene, depths):
    mesh, information = rough_plane()
    farther = depths._replace(depths=depths.depths * 1.5)
    for none in (farther, NO_DEPTHS):
        assert fitted(mesh, information, scene[0].views, none, 1) is mesh


def test_wrong_depths_are_told(depths):
    depths.check("depths", 5)
    with pytest.raises(ColmapEdgesError, match=r"depths\.views holds view 4"):
        depths.check("depths", 3)
    with pytest.raises(ColmapEdgesError, match="do not ascend"):
        depths._replace(views=depths.views[::-1].copy()).check("depths", 5)
    with pytest.raises(ColmapEdgesError, match=r"depths\.rays"):
        depths._replace(rays=depths.rays[1:]).check("depths", 5)


def test_sheets_that_touch_stay_together(scene, depths):
    mesh, information = rough_plane()
    doubled = np.flatnonzero(np.abs(mesh.vertices - mesh.vertices.mean(axis=0)).max(axis=1) < 0.4)
    faces = np.concatenate([mesh.faces, len(mesh.vertices) + mesh.faces[:, ::-1]])
    vertices = np.concatenate([mesh.vertices, mesh.vertices - UP])
    vertices[len(mesh.vertices) + doubled] = mesh.vertices[doubled]
    both = replace(mesh, vertices=vertices, faces=np.ascontiguousarray(faces))
    found = fitted(both, np.tile(information, (2, 1)), scene[0].views, depths, 1)
    np.testing.assert_array_equal(found.vertices[doubled], mesh.vertices[doubled])
    assert (found.vertices != vertices).any()


def test_points_that_are_there_twice():
    points = np.array([[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1], [0.0, 1, 2], [-0.0, 1, 0]])
    assert are_repeated(points).tolist() == [True, True, True, False, False, True]
    assert are_repeated(points[:0]).tolist() == []


def with_needles(mesh):
    """A mesh with a face of no area along every second of its diagonals, the first faces."""
    count, half = len(mesh.vertices), len(mesh.faces) // 2
    one, other = mesh.faces[:half, 0], mesh.faces[:half, 2]
    share = np.random.default_rng(0).uniform(0.2, 0.8, (half, 1))
    between = mesh.vertices[one] * (1 - share) + mesh.vertices[other] * share
    needles = np.column_stack([one, count + np.arange(half), other]).astype(np.int32)
    return replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, between]),
        faces=np.concatenate([needles, mesh.faces]),
        point3D_ids=np.arange(count + half),
        colors=np.zeros((count + half, 3), np.uint8),
    )


def test_depths_on_needles_without_an_area_change_little_by_their_vertices(scene):
    mesh = with_needles(rough_plane()[0])
    ends = mesh.vertices[mesh.faces[: len(mesh.faces) // 3][:, [0, 2]]]
    on_needles, views = ends.mean(axis=1), scene[0].views
    local = np.concatenate([view.cam_from_world(on_needles) for view in views])
    given = Depths(
        views=np.repeat(np.arange(len(views), dtype=np.int32), len(on_needles)),
        rays=local[:, :2] / local[:, 2:],
        depths=local[:, 2].copy(),
        sigmas=np.full(len(local), 0.01),
    )
    differences = differences_of(mesh, normals_of_vertices(mesh), views, given, 1)
    assert len(differences.depths) > 1000
    assert np.abs(differences.changes.data).max() <= 1 / MIN_COSINE
