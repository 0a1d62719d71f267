"""A far backdrop looks the same from all places; walls do not."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from plain_rooms import upright_view

from colmap_edges.core.polylines import unit
from colmap_edges.surfaces.sky.backdrop import find_backdrop, fitted, harmonics, samples
from colmap_edges.surfaces.sky.regions import Regions

WIDTH, HEIGHT = 80, 60
CAMERA = pycolmap.Camera(
    model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[60, WIDTH / 2, HEIGHT / 2]
)
VIEWS = 12


def orbit(share=1.0):
    """Views that look slightly down at a body, from a share of the circle around it."""
    turns = 2 * np.pi * share * np.arange(VIEWS) / VIEWS
    spots = 3 * np.column_stack([np.cos(turns), np.sin(turns), np.full(VIEWS, 0.2)])
    return [upright_view(i, CAMERA, spot, -spot) for i, spot in enumerate(spots)]


def rays_of(view):
    """(H W, 3) unit viewing rays."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return unit(view.rays(np.column_stack([x.ravel(), y.ravel()])))


def gradient(view):
    """Levels of a backdrop: darker below, and a little bluish to one side."""
    rays = rays_of(view)
    return 120 + 60 * rays[:, 2:] + 15 * rays[:, :1] * (1, 0, 0)


def walls(view):
    """Levels of a round room, which is lit from one side, 5 units around the body."""
    rays = rays_of(view)
    a = (rays[:, :2] ** 2).sum(axis=1)
    b = rays[:, :2] @ view.center[:2]
    along = (-b + np.sqrt(b * b - a * ((view.center[:2] ** 2).sum() - 25))) / a
    places = view.center + along[:, None] * rays
    return np.repeat(120 + 12 * places[:, :1] + 8 * places[:, 2:], 3, axis=1)


def regions_of(views, colors, exposures=None, below=()):
    """A region a view, around a body in the middle of the picture, with noise of half a level."""
    rng = np.random.default_rng(0)
    labels = np.full((HEIGHT, WIDTH), -1, np.int32)
    outside = np.ones((HEIGHT, WIDTH), bool)
    outside[20:45, 25:55] = False
    pictures, numbers = [], []
    for index, view in enumerate(views):
        gain = 1.0 if exposures is None else exposures[index]
        levels = gain * colors(view) + rng.normal(0, 0.5, (HEIGHT * WIDTH, 3))
        picture = np.clip(levels.round(), 0, 255).astype(np.uint8)
        pictures.append(picture.reshape(HEIGHT, WIDTH, 3))
        numbers.append(np.where(outside, index, labels))
    return Regions(
        pictures=pictures,
        labels=numbers,
        near=[~outside] * len(views),
        views=np.arange(len(views)),
        below=np.isin(np.arange(len(views)), below),
    )


def all_shown(views, regions):
    """Whether all pixels of all regions, and no others, are a backdrop."""
    shown = find_backdrop(views, regions).shown
    return all(np.array_equal(a, b >= 0) for a, b in zip(shown, regions.labels, strict=True))


def test_a_gradient_around_a_body_is_a_backdrop_at_any_exposure():
    views = orbit()
    assert all_shown(views, regions_of(views, gradient))
    exposures = np.random.default_rng(1).uniform(0.7, 1.3, VIEWS)
    assert all_shown(views, regions_of(views, gradient, exposures))


def test_a_plain_colour_around_a_body_is_a_backdrop():
    views = orbit()
    plain = regions_of(views, lambda view: np.full((HEIGHT * WIDTH, 3), 200.0))
    assert all_shown(views, plain)


def test_walls_of_a_room_are_no_backdrop():
    views = orbit()
    assert find_backdrop(views, regions_of(views, walls)) is None


def test_one_side_is_not_enough():
    views = orbit(share=0.1)
    assert find_backdrop(views, regions_of(views, gradient)) is None


def test_nearly_all_views_must_show_it():
    views = orbit()
    few = regions_of(views, gradient, below=(0, 1, 2))
    assert find_backdrop(views, few) is None


def test_regions_that_disagree_are_left_out():
    views = orbit()
    regions = regions_of(views, gradient)
    regions.pictures[4][:, :40] = 60  # a plain curtain
    shown = find_backdrop(views, regions).shown
    assert [of.any() for of in shown] == [index != 4 for index in range(VIEWS)]


def test_a_face_of_a_body_is_none_where_the_border_shows_something_else():
    """The factor of a view with an overexposed backdrop is free, and any plain face fits it."""
    views = orbit()
    regions = regions_of(views, gradient)
    outside = regions.labels[4] >= 0
    noise = np.random.default_rng(2).integers(0, 256, (int(outside.sum()), 1))  # fits no factor
    regions.pictures[4][outside] = noise
    face = np.s_[22:43, 27:53]
    regions.pictures[4][face] = 0.8 * gradient(views[4]).reshape(HEIGHT, WIDTH, 3)[face]
    regions.labels[4][face] = 5
    for labels in regions.labels[5:]:
        labels[labels >= 0] += 1
    of_views = np.insert(regions.views, 5, 4)
    with_face = replace(regions, views=of_views, below=np.zeros(VIEWS + 1, bool))
    shown = find_backdrop(views, with_face).shown
    assert [of.any() for of in shown] == [index != 4 for index in range(VIEWS)]


def test_a_body_into_which_a_region_leaks_is_left_out():
    """Its shade reaches that of the backdrop at one side, so that no outline is found there."""
    views = orbit()
    regions = regions_of(views, gradient)
    shade = regions.pictures[4][25:40, 55:65].astype(float) - np.arange(10)[None, :, None]
    regions.pictures[4][25:40, 55:65] = shade
    shown = find_backdrop(views, regions).shown
    assert not shown[4][27:38, 60:64].any()
    assert shown[4][:, 70:].all() and shown[4][:20].all() and shown[5][27:38, 60:64].all()


def test_a_body_little_darker_than_a_noisy_backdrop_is_left_out():
    views, rng = orbit(), np.random.default_rng(3)
    regions = regions_of(views, gradient)
    for index, picture in enumerate(regions.pictures):
        levels = picture + rng.normal(0, 1.0, picture.shape)
        if index == 4:
            levels[:16, :20] -= 2.5
        picture[:] = np.rint(levels)
    shown = find_backdrop(views, regions).shown
    assert not shown[4][:14, :18].any()
    assert shown[4][:, 60:].mean() > 0.99
    assert shown[5][:14, :18].mean() > 0.99


def test_a_body_of_the_gray_of_the_backdrop_has_other_colours():
    views = orbit()
    regions = regions_of(views, gradient)
    body = np.s_[24:40, 30:50]
    for index, labels in enumerate(regions.labels):
        labels[body] = -1
        if index != 4:
            regions.pictures[index][body] += np.array([12, 0, 0], np.uint8)
    others = find_backdrop(views, regions).others
    inner = np.s_[27:37, 33:47]
    assert [of[inner].all() for of in others] == [index != 4 for index in range(VIEWS)]
    assert not others[4].any()
    outer = np.ones((HEIGHT, WIDTH), bool)
    outer[21:43, 27:53] = False
    assert not any(of[outer].any() for of in others)


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_factors_of_views_are_taken_out_exactly(noise):
    rng = np.random.default_rng(2)
    directions = unit(rng.normal(size=(3000, 3)))
    seen_by = np.sort(rng.integers(0, 5, 3000))
    shape = np.exp(harmonics(directions) @ rng.normal(0, 0.05, (15, 3)))
    factors = np.array([60.0, 90, 120, 150, 100])
    colors = factors[seen_by, None] * shape + noise * rng.normal(size=(3000, 3))
    off, model = fitted(seen_by, harmonics(directions), colors, 6)
    assert off.max() < 1e-6 + 5 * noise
    found = np.exp(harmonics(directions) @ model.coefficients + model.factors[seen_by])
    assert np.abs(found - colors).max() < 1e-6 + 5 * noise
    assert np.isnan(model.factors[5]).all()


def test_samples_are_bounded_and_in_the_order_of_views():
    views = orbit()
    owners, rays, levels = samples(views, regions_of(views, gradient))
    assert len(owners) == len(rays) == len(levels) == VIEWS * (HEIGHT * WIDTH - 25 * 30)
    assert (np.diff(owners) >= 0).all()
    assert not len(samples(views, regions_of(views, gradient, below=range(VIEWS)))[0])
