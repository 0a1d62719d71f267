"""What other views and the background say of the ground that views look down on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from evidence import evidence_of

from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.grids import (
    blank_grid,
    doubled,
    halved,
    with_background,
    with_bodies,
)
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import (
    REFINED_CELLS,
    EvidenceWeights,
    evidence_arrays,
    label_cells,
    make_scene,
    refine_labels,
    split_by_view,
)

GROUND = Planes(normals=np.array([[0.0, 0, 1]]), offsets=np.zeros(1))
HEIGHT = 3.0
CENTERS = np.array([[0.1 * i, 0, HEIGHT] for i in range(4)])
CAMERA = pycolmap.Camera(model="PINHOLE", width=80, height=80, params=[80, 80, 40, 40])


def views_from_above():
    """Views that look straight down, x to the right."""
    down = np.diag([1.0, -1, -1])
    return tuple(
        View(
            image_id=i + 1,
            name=f"{i}.png",
            width=80,
            height=80,
            camera=CAMERA,
            rotation=down,
            translation=-down @ center,
        )
        for i, center in enumerate(CENTERS)
    )


def pictures_of(views, change=halved):
    """Small pictures of the ground's blotches."""
    blotches = np.random.default_rng(0).integers(60, 200, (64, 64))
    for view in views:
        grid = change(blank_grid(view))
        rows, columns = np.indices(grid.gray.shape) + 0.5
        x, y = view.center[:2, None, None] + HEIGHT / grid.focal_px * np.array(
            [columns - grid.principal[0], grid.principal[1] - rows]
        )
        at = np.floor([8 * x, 8 * y]).astype(int) % 64
        yield replace(grid, gray=blotches[at[0], at[1]].astype(np.uint8))


def around_the_ground(missing=0):
    """Points on a square around what is looked at; the last view misses the first of them."""
    sides = np.linspace(-1, 1, 20)
    ends = np.ones(20)
    square = np.concatenate(
        [np.column_stack(pair) for end in (-ends, ends) for pair in ((sides, end), (end, sides))]
    )
    points = np.column_stack([square, np.zeros(len(square))])
    sees = np.ones((len(points), len(CENTERS)), bool)
    sees[:missing, -1] = False
    seen_by = np.nonzero(sees)[1].astype(np.int32)
    return evidence_of(points, np.append(0, np.cumsum(sees.sum(axis=1))), seen_by, 0.01)


def scene_of(views, pictures, missing=0):
    """What labels cost, of the ground alone."""
    evidence = around_the_ground(missing)
    known = evidence_arrays(evidence, GROUND, len(views))
    return make_scene(SimpleNamespace(views=views), pictures, known, 1)


def labels_of(views, pictures, missing=0, num_rounds=1):
    """(rows, columns) of each view whether cells are labelled with the ground."""
    labels = label_cells(scene_of(views, pictures, missing), num_rounds, 1)
    return [each == 0 for each in split_by_view(labels, pictures)]


@pytest.fixture(scope="module")
def ground():
    views = views_from_above()
    return SimpleNamespace(views=views, pictures=list(pictures_of(views)))


def test_what_stands_before_the_ground_in_one_view_does_not_end_it_in_others(ground):
    assert all(labels.mean() > 0.9 for labels in labels_of(ground.views, ground.pictures))
    noise = np.random.default_rng(1).integers(60, 200, ground.pictures[3].gray.shape)
    hidden = replace(ground.pictures[3], gray=noise.astype(np.uint8))
    labelled = labels_of(ground.views, [*ground.pictures[:3], hidden])
    assert all(labels.mean() > 0.9 for labels in labelled[:3])
    assert labelled[3].mean() < 0.5  # where it stands, no view agrees


def test_views_that_observe_few_points_take_the_planes_of_their_neighbours(ground):
    """The last view observes five of 80 points."""
    alone = labels_of(ground.views, ground.pictures, missing=75)
    assert all(labels.mean() > 0.9 for labels in alone[:3])
    assert not alone[3].any()
    agreed = labels_of(ground.views, ground.pictures, missing=75, num_rounds=2)
    assert all(labels.mean() > 0.9 for labels in agreed[:3])
    assert agreed[3].mean() > 0.7


def test_labels_of_smaller_cells_differ_only_near_borders_of_the_larger_ones(ground):
    """The larger cells of the right half of one view have no label, though all show the ground."""
    finer = list(pictures_of(ground.views, change=lambda grid: grid))
    given = [np.zeros(picture.shape, np.int32) for picture in ground.pictures]
    given[0][:, 40:] = -1
    start = doubled(np.concatenate([of.ravel() for of in given]), ground.pictures, finer)
    scene = scene_of(ground.views, finer)
    weights = EvidenceWeights(no_plane=3.0)
    refined = split_by_view(refine_labels(scene, start, 1, weights), finer)
    assert [labels.shape for labels in refined] == 4 * [(160, 160)]
    assert all((labels == 0).all() for labels in refined[1:])
    assert (refined[0][:, : 80 + REFINED_CELLS] == 0).all()
    assert (refined[0][:, 80 + REFINED_CELLS :] == -1).all()
    again = refine_labels(scene, start, 2, weights)
    assert np.array_equal(again, np.concatenate([of.ravel() for of in refined]))


def test_smaller_cells_that_show_background_lose_the_label_of_the_larger_one(ground):
    """The last three small cells of the rows of one view."""
    finer = list(pictures_of(ground.views, change=lambda grid: grid))
    body = np.ones((160, 160), bool)
    body[:, 157:] = False
    finer[0] = with_background(ground.views[0], finer[0], body)
    start = np.zeros(4 * 160 * 160, np.int32)
    found = refine_labels(scene_of(ground.views, finer), start, 1, EvidenceWeights())
    labels = split_by_view(found, finer)[0]
    assert (labels[:, 157:] == -1).all()
    assert (labels[:, : 157 - REFINED_CELLS] == 0).all()


def test_halves_of_pictures_hold_what_is_in_all_of_their_cells(ground):
    """An odd number of cells, a strip of background, and a body in one corner."""
    view = replace(ground.views[0], width=78, height=78)
    fine = blank_grid(view, num_columns=7)
    shown = np.zeros(fine.gray.shape, bool)
    shown[:, :20] = True
    bodies = np.full(fine.shape, np.nan, np.float32)
    bodies[0, 0], bodies[1, 1], bodies[6, 6] = 3, 2, 5
    gray = np.arange(28, dtype=np.uint8) * np.ones((28, 1), np.uint8)
    half = halved(replace(fine, gray=gray, background=shown, bodies=bodies, usable=shown))
    assert half.shape == (4, 4)
    assert half.focal_px == fine.focal_px / 2
    assert half.gray[3, :14].tolist() == [2 * i + 1 for i in range(14)]
    assert half.background[0].tolist() == half.usable[0].tolist() == [True] * 10 + [False] * 6
    assert half.bodies[0, 0] == 2
    assert half.bodies[3, 3] == 5
    assert np.isnan(half.bodies).sum() == 14
    labels = np.arange(16, dtype=np.int32)
    both = doubled(labels, [half], [fine]).reshape(7, 7)
    assert both[0].tolist() == [0, 0, 1, 1, 2, 2, 3]
    assert both[:, 0].tolist() == [0, 0, 4, 4, 8, 8, 12]


def test_cells_that_show_background_are_on_no_plane(ground):
    body = np.ones((80, 80), bool)
    body[:, 60:] = False
    first = with_background(ground.views[0], ground.pictures[0], body)
    labelled = labels_of(ground.views, [first, *ground.pictures[1:]])
    assert not labelled[0][:, 60:].any()
    assert labelled[0][10:-10, 20:55].all()


def test_views_that_show_background_behind_a_plane_contradict_it(ground):
    nothing = np.zeros((80, 80), bool)
    pictures = [
        with_background(view, picture, nothing)
        for view, picture in zip(ground.views[1:], ground.pictures[1:], strict=True)
    ]
    labelled = labels_of(ground.views, [ground.pictures[0], *pictures])
    assert labelled[0].mean() < 0.5
    assert not any(labels.any() for labels in labelled[1:])


def test_a_cell_that_shows_some_of_a_body_is_no_background(ground):
    body = np.zeros((80, 80), bool)
    body[40, 40] = True
    shown = with_background(ground.views[0], ground.pictures[0], body).shown
    assert shown.shape == (80, 80)
    assert np.argwhere(np.isnan(shown)).tolist() == [[40, 40]]
    assert np.isinf(shown).sum() == 80 * 80 - 1
    assert np.isnan(ground.pictures[0].shown).all()


def ball(height):
    """3,490 points all over a ball of radius 0.5 in the middle of the first view's image."""
    count = 3490
    heights = np.linspace(-1, 1, count)
    turns = np.arange(count) * np.pi * (3 - np.sqrt(5))
    around = np.sqrt(1 - heights**2)
    unit = np.column_stack([around * np.cos(turns), around * np.sin(turns), heights])
    return CENTERS[0] * (1, 1, 0) + 0.5 * unit + (0, 0, height)


@pytest.mark.parametrize(("height", "is_hidden"), [(1.0, True), (-2.0, False)])
def test_no_plane_lies_behind_a_round_body(ground, height, is_hidden):
    first = with_bodies(ground.views[0], ground.pictures[0], ball(height))
    labelled = labels_of(ground.views, [first, *ground.pictures[1:]])
    assert labelled[0][36:44, 36:44].all() != is_hidden
    assert labelled[0][36:44, 36:44].any() != is_hidden
    assert labelled[0][4:20].mean() > 0.9


def test_a_body_is_as_deep_as_its_front(ground):
    """Gaps of a cell between its points are filled."""
    view = ground.views[0]
    first = halved(with_bodies(view, blank_grid(view), ball(1.0)))
    rows, columns = np.indices((80, 80)) + 0.5 - 40
    off = np.hypot(rows, columns) / 80  # of rays, at depth 1; the ball's centre is 2 deep
    on = off < np.tan(np.arcsin(0.5 / 2)) - 0.03
    depths = (2 - np.sqrt(4 - (4 - 0.25) * (1 + off[on] ** 2))) / (1 + off[on] ** 2)
    assert np.abs(first.shown[on] - depths).max() < 0.08
    assert np.isnan(first.shown[off > np.tan(np.arcsin(0.5 / 2)) + 0.03]).all()
