"""Patches of a textured plane, their noise, and which of them a mesh lacks."""

from dataclasses import replace

import numpy as np
import pytest
from textured_plane import NORMAL, OFFSET

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.surfaces.faces.grids import blank_grid, usable_at
from colmap_edges.surfaces.patches.adding import what_they_add
from colmap_edges.surfaces.patches.finding import (
    NO_PATCHES,
    Agreed,
    are_among_others,
    find_patches,
)
from colmap_edges.surfaces.patches.sites import (
    hypotheses_at,
    noise_of,
    texture_of,
    textured_sites,
)
from colmap_edges.surfaces.patches.smoothing import fitted_planes, noise_factor, smoothed

CORNERS = np.array([[-3.0, -3], [3, -3], [3, 3], [-3, 3]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_patches_lie_on_the_plane_within_their_noise(scene, patches):
    assert len(patches.sigmas) > 100
    assert patches.num_sites >= patches.num_found >= patches.num_agreed
    points = patches.points
    first = points.track_views[points.track_offsets[:-1]]
    rays = points.points - scene[0].camera_centers[first]
    distance = points.points @ NORMAL - OFFSET
    along = distance / (rays @ NORMAL) * np.linalg.norm(rays, axis=1)
    assert np.median(np.abs(along) / 4) < 0.002  # a tenth of a pixel's parallax
    assert np.median(np.abs(along) / patches.tolerances) < 1.5
    cosines = patches.normals @ NORMAL / np.linalg.norm(NORMAL)
    assert np.median(cosines) < -np.cos(np.radians(8))  # they look at the views
    assert np.diff(points.track_offsets).min() >= 3


def test_patches_do_not_depend_on_threads(scene, patches):
    again = find_patches(scene[0], Edges3D.none(), scene[1], 0, 1)
    np.testing.assert_array_equal(again.points.points, patches.points.points)
    np.testing.assert_array_equal(again.points.track_views, patches.points.track_views)


def agreed_at(places):
    """Patches at these rows and columns of the second of two views."""
    rows = np.zeros((len(places), 5), np.int32)
    rows[:, 0], rows[:, 1:3] = 1, places
    nothing = np.zeros(0, np.int32)
    return Agreed(rows, np.zeros((len(rows), 7)), np.zeros(len(rows) + 1, np.int64), nothing)


def test_patches_of_chance_have_few_around_them():
    active = [np.zeros((40, 60), bool), np.ones((40, 60), bool)]
    area = np.argwhere(np.ones((20, 20)))  # on a carpet, of which the last columns are refused
    lone = np.array([[30, 30], [33, 50]])
    accepted = np.concatenate([area[:, 1] < 15, [True, True]])
    among = are_among_others(accepted, agreed_at(np.concatenate([area, lone])), active)
    assert among[:400].reshape(20, 20)[4:16, 4:15].all()
    assert not among[400:].any()
    # In a reflection of few sites most may agree.
    small = np.argwhere(np.ones((3, 4)))
    shown = [active[0], np.zeros((40, 60), bool)]
    shown[1][:3, :4] = True
    assert not are_among_others(np.ones(12, bool), agreed_at(small), shown).any()


def test_views_without_pictures_show_no_patches(scene):
    assert not len(find_patches(scene[0], Edges3D.none(), {}, 0, 1).sigmas)
    one = {0: scene[1][0]}
    assert not len(find_patches(scene[0], Edges3D.none(), one, 0, 1).sigmas)


def test_masked_windows_are_no_sites(scene):
    usable = np.ones(scene[1][0].gray.shape, bool)
    usable[:, :80] = False
    sites = textured_sites(replace(scene[1][0], usable=usable), np.zeros((0, 2)))
    columns = np.flatnonzero(sites.any(axis=0)) * 4 + 3
    assert columns.min() >= 83


def test_windows_that_touch_the_background_are_no_sites(scene):
    background = np.zeros(scene[1][0].gray.shape, bool)
    background[:, :80] = True
    sites = textured_sites(replace(scene[1][0], background=background), np.zeros((0, 2)))
    columns = np.flatnonzero(sites.any(axis=0)) * 4 + 3
    assert 83 < columns.min() <= 87
    # A window goes on to 3 pixels; outlines blur it for one more.
    background[:, :81] = True
    fewer = textured_sites(replace(scene[1][0], background=background), np.zeros((0, 2)))
    assert (np.flatnonzero(fewer.any(axis=0)) * 4 + 3).min() > 84


def test_places_outside_the_image_are_not_usable():
    at = np.stack(np.meshgrid(np.arange(6.0), np.arange(4.0)), -1).astype(np.float32)
    assert usable_at(at, None) is None
    np.testing.assert_array_equal(usable_at(at - [2, 0], None)[0], [0, 0, 1, 1, 1, 1])
    mask = np.ones((8, 12), bool)
    mask[:, 6:] = False
    np.testing.assert_array_equal(usable_at(at, mask)[0], [1, 1, 1, 0, 0, 0])


def test_sites_keep_away_from_edges(scene):
    edge = np.column_stack([np.full(120, 80.0), np.arange(120.0)])
    columns = np.flatnonzero(textured_sites(scene[1][0], edge).any(axis=0)) * 4 + 3
    assert np.abs(columns - 80).min() >= 5


def test_shading_and_noise_are_no_texture(rng, scene):
    rows, columns = np.mgrid[:120, :160].astype(np.float32)
    np.testing.assert_allclose(texture_of(rows + 0.5 * columns)[10:-10, 10:-10], 0, atol=0.02)
    noise = rng.normal(100, 3, rows.shape).astype(np.float32)
    assert np.median(noise_of(noise)) == pytest.approx(9, rel=0.1)
    gray = np.clip(np.rint(noise), 0, 255).astype(np.uint8)
    grid = replace(scene[1][0], gray=gray)
    assert textured_sites(grid, np.zeros((0, 2))).mean() < 0.01


def test_hypotheses_continue_the_plane_of_known_points(rng):
    pixels = rng.uniform(0, 120, (200, 2))
    inverse = 0.3 + pixels @ [0.001, -0.002]
    found = hypotheses_at(np.ones((15, 15), bool), pixels, inverse)
    inner = found[3:12, 3:12, 0].reshape(-1, 3)
    rows, columns = np.mgrid[3:12, 3:12].reshape(2, -1) * 4 + 3
    expected = 0.3 + 0.001 * columns - 0.002 * rows
    np.testing.assert_allclose(inner[:, 0], expected, rtol=1e-5)
    np.testing.assert_allclose(inner[:, 1:], np.tile([0.001, -0.002], (81, 1)), rtol=1e-3)
    assert np.isnan(hypotheses_at(np.ones((2, 2), bool), pixels[:2], inverse[:2])).all()


def test_noise_is_averaged_on_planes_only(rng):
    rows, columns = np.mgrid[:32, :32].reshape(2, -1)
    at = np.zeros((len(rows), 5), np.int32)
    at[:, 1], at[:, 2] = rows, columns
    values = np.zeros((len(rows), 7))
    values[:, :2] = np.column_stack([columns, rows]) * 4 + 3
    true = 0.3 + values[:, 0] * 1e-4 + np.where(columns < 16, 0, 0.05)
    values[:, 2] = true + rng.normal(0, 1e-3, len(rows))
    values[:, 5] = 5e-4  # half of the true deviation
    assert noise_factor(at, values) == pytest.approx(2, rel=0.15)
    planes, sigmas, single = smoothed(at, values)
    assert np.std(planes[:, 0] - true) < 3e-4
    assert np.median(sigmas) < 3e-4 < np.median(single)
    assert not len(smoothed(at[:0], values[:0])[0])
    fits = fitted_planes(values, np.zeros(len(rows), np.int64))
    assert not fits.is_plane.any()


def test_a_mesh_lacks_the_patches_that_are_elsewhere(scene, patches):
    depth = (OFFSET - CORNERS @ NORMAL[:2]) / NORMAL[2]
    plane = np.column_stack([CORNERS, depth])
    given = scene[0]
    right = what_they_add(patches, given, plane, SQUARE, 1)
    assert len(right) < 0.05 * len(patches.sigmas)
    everything = np.arange(len(patches.sigmas))
    wrong = what_they_add(patches, given, plane + np.array([0, 0, 0.2]), SQUARE, 1)
    np.testing.assert_array_equal(wrong, everything)
    hole = what_they_add(patches, given, plane[:0], SQUARE[:0], 1)
    np.testing.assert_array_equal(hole, everything)
    assert not len(what_they_add(NO_PATCHES, given, plane, SQUARE, 1))


def test_patches_of_another_size_are_told(patches):
    with pytest.raises(ColmapEdgesError, match="sigmas has 1 rows"):
        replace(patches, sigmas=np.ones(1)).check()
    patches.check(num_views=5)


def test_blank_grids_hold_no_sites(scene):
    assert not textured_sites(blank_grid(scene[0].views[0]), np.zeros((0, 2))).any()
