"""Labels are believed between the points of their plane, and not beyond the last of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from evidence import evidence_of
from scipy import ndimage

from colmap_edges.core.view import View
from colmap_edges.kernels import _kernels
from colmap_edges.surfaces.faces.decision import Samples
from colmap_edges.surfaces.faces.enclosure import (
    DIRECTIONS,
    ENCLOSED_SHARE,
    MAX_OPEN,
    are_enclosed,
    backdrops,
)
from colmap_edges.surfaces.faces.grids import (
    CELL_PX,
    Grid,
    blank_grid,
    cells_in,
    with_background,
)
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import evidence_arrays, make_scene


def enclosed_cells(shown, touched, inside):
    return _kernels.enclosed_cells(
        shown,
        touched.astype(np.uint8),
        inside.astype(np.uint8),
        np.array(DIRECTIONS, np.int32),
        MAX_OPEN,
    ).astype(bool)


def steps_that_meet(shown, touched, inside, row, column):
    """Walk from one cell, step by step."""
    met = []
    for right, down in DIRECTIONS:
        at = np.array([row, column])
        while True:
            here = tuple(at)
            at += (down, right)
            if (at < 0).any() or (at >= shown.shape).any():
                met.append(inside[here])
                break
            if touched[(*at, shown[row, column])]:
                met.append(True)
                break
            if shown[tuple(at)] != shown[row, column]:
                met.append(False)
                break
    return met


def is_enclosed(met):
    """Whether no more directions in a row are open than may be."""
    around = "".join("x" if hit else "." for hit in [*met, *met])
    return "." * (MAX_OPEN + 1) not in around


def wall(touched_columns):
    """A plain wall of 20 x 30 cells with vertical edges, before nothing else."""
    shown = np.zeros((20, 30), np.int32)
    touched = np.zeros((20, 30, 2), bool)
    touched[:, touched_columns, 0] = True
    return shown, touched, np.zeros((20, 30), bool)


def test_cells_are_enclosed_as_walking_says():
    rng = np.random.default_rng(1)
    shown = np.repeat(np.repeat(rng.integers(-1, 3, (4, 5)), 5, 0), 5, 1).astype(np.int32)
    touched = rng.random((*shown.shape, 4)) < 0.08
    touched[..., -1] = False
    inside = rng.random(shown.shape) < 0.5
    enclosed = enclosed_cells(shown, touched, inside)
    assert 0.1 < enclosed.mean() < 0.9
    for row in range(shown.shape[0]):
        for column in range(shown.shape[1]):
            met = steps_that_meet(shown, touched, inside, row, column)
            expected = shown[row, column] >= 0 and is_enclosed(met)
            assert enclosed[row, column] == expected


def test_a_wall_is_enclosed_between_its_edges_and_not_beyond():
    enclosed = enclosed_cells(*wall([5, 15]))
    assert enclosed[8:12, 7:14].all()
    assert not enclosed[:, 16:].any()
    assert not enclosed[:, :5].any()


def test_the_end_of_the_picture_encloses_where_the_plane_is_known_to_go_on():
    shown, touched, inside = wall([5])
    assert not enclosed_cells(shown, touched, inside)[:, 6:].any()
    inside[:, -2:] = inside[:2] = inside[-2:] = True
    assert enclosed_cells(shown, touched, inside)[8:12, 10:20].all()


def held_cells(shown, touched, enclosed, has_backdrop=False):
    return _kernels.whole_pieces(
        shown, touched.astype(np.uint8), enclosed.astype(np.uint8), has_backdrop, ENCLOSED_SHARE
    ).astype(bool)


def test_pieces_are_believed_as_most_of_their_cells_are():
    shown = np.array([[0, 0, 0, 1, 1, -1, 0, 0, 0]], np.int32)
    enclosed = np.array([[1, 1, 0, 0, 1, 0, 1, 0, 0]], bool)
    held = held_cells(shown, np.zeros((1, 9, 2), bool), enclosed)
    assert held.tolist() == [[1, 1, 1, 1, 1, 0, 1, 0, 0]]


def test_before_a_backdrop_what_lies_beyond_the_points_of_a_piece_is_another_piece():
    shown = np.zeros((1, 9), np.int32)
    touched = np.zeros((1, 9, 1), bool)
    touched[0, 6] = True
    enclosed = np.array([[1, 1, 1, 1, 1, 0, 0, 0, 0]], bool)
    assert held_cells(shown, touched, enclosed, has_backdrop=True).tolist() == [[1] * 7 + [0] * 2]
    assert held_cells(shown, touched, enclosed).all()


@pytest.mark.parametrize("has_backdrop", [False, True])
def test_pieces_are_connected_along_sides(has_backdrop):
    rng = np.random.default_rng(2)
    shown = rng.integers(-1, 2, (12, 15)).astype(np.int32)
    touched = rng.random((*shown.shape, 2)) < 0.1
    enclosed = (rng.random(shown.shape) < 0.4) & (shown >= 0)
    expected = enclosed.copy()
    for plane in (0, 1):
        ends = touched[..., plane] & has_backdrop
        expected |= (shown == plane) & ends
        pieces, count = ndimage.label((shown == plane) & ~ends)
        for piece in range(1, count + 1):
            expected |= (pieces == piece) & (enclosed[pieces == piece].mean() >= ENCLOSED_SHARE)
    assert np.array_equal(held_cells(shown, touched, enclosed, has_backdrop), expected)


def picture_of(levels):
    """A small picture (240, 320) of gray levels."""
    return Grid(gray=levels.astype(np.uint8), focal_px=200.0, principal=np.array([160.0, 120.0]))


def test_a_backdrop_is_where_much_of_the_border_is_of_one_gray():
    """A part crosses the border; the backdrop is as noisy as photographs are."""
    rng = np.random.default_rng(3)
    levels = 40 + rng.normal(0, 0.7, (240, 320))
    levels[80:, 100:200] = np.linspace(90, 200, 100)
    shown = backdrops([picture_of(levels)])[0]
    assert shown.shape == (60, 80)
    assert shown[:, :24].all()
    assert not shown[21:, 26:49].any()


@pytest.mark.parametrize(("width", "is_told"), [(40, False), (120, True)])
def test_much_ground_of_the_gray_of_a_backdrop_is_told_by_its_colours(width, is_told):
    """A little of other colours may be the mixed pixels of outlines."""
    ground = np.zeros((240, 320), bool)
    ground[:, :width] = True
    picture = replace(picture_of(np.full((240, 320), 200)), others=ground)
    shown = backdrops([picture])[0]
    assert shown[:, width // 4 :].all()
    assert shown[:, : width // 4].any() != is_told


def test_walls_of_changing_gray_are_no_backdrop():
    rows, columns = np.mgrid[:240, :320]
    assert not backdrops([picture_of(90 + rows / 6 + columns / 4)])[0].any()


@pytest.mark.parametrize(
    ("depth_of_wall", "backdrop", "enclosed"),
    [(4, False, True), (8, False, False), (3, False, False), (4, True, False)],
)
def test_a_floor_ends_where_it_meets_a_wall_or_a_backdrop(depth_of_wall, backdrop, enclosed):
    """The floor has a line of points next to the view, and a wall is shown from a depth of 4 on."""
    assert floor_is_enclosed(depth_of_wall, backdrop) == enclosed


def test_a_floor_goes_on_behind_what_is_enclosed():
    """A board stands before the wall: it hides where floor and wall meet."""
    frame = [(x, y, 3.0) for x in np.linspace(-3, 3, 301) for y in (-1.5, 0.74)]
    frame += [(x, y, 3.0) for x in (-2.3, 2.3) for y in np.linspace(-1.5, 1, 100)]
    assert floor_is_enclosed(3, more_points=np.array(frame))


@pytest.mark.parametrize("shows_background", [False, True])
def test_a_floor_ends_where_only_background_is_shown(shows_background):
    assert floor_is_enclosed(None, shows_background=shows_background) == shows_background


@pytest.mark.parametrize(("depth", "enclosed"), [(2.0, True), (9.0, False)])
def test_a_floor_goes_on_behind_a_round_body(depth, enclosed):
    assert floor_is_enclosed(None, depth_of_body=depth) == enclosed


def view_above_floor(index, center):
    """A view that looks along z; the floor is at y = 1."""
    camera = pycolmap.Camera(model="PINHOLE", width=320, height=240, params=[200, 200, 160, 120])
    return View(
        image_id=index + 1,
        name=f"{index}.png",
        width=320,
        height=240,
        camera=camera,
        rotation=np.eye(3),
        translation=-center,
    )


def sample_at(points, views):
    """One place (1, 3) on the first plane that (V,) views show."""
    one = np.ones(1, np.int32)
    return Samples(
        points=points,
        sizes=np.ones(1),
        cells=0 * one,
        planes=0 * one,
        holding=one,
        agreeing=one,
        through=0 * one,
        hidden=0 * one,
        offsets=np.array([0, len(views)]),
        views=views,
    )


def lawn_is_enclosed(differs):
    """Whether a place on a textured floor is that a second view shows, too; its points are away."""
    textures = np.random.default_rng(4).normal(120, 30, (2, 512, 512))
    textures = [ndimage.gaussian_filter(texture, 2) for texture in textures]
    views, grids, labels = [], [], []
    for i in range(2):
        view = view_above_floor(i, np.array([1.0 * i, 0, 0]))
        rows, columns = np.mgrid[:240, :320] + 0.5
        depth = 200 / np.maximum(rows - 120, 1e-9)
        across = (columns - 160) / 200 * depth + view.center[0]
        at = np.floor(np.array([depth, across]) * 64).astype(int) % 512
        gray = 120 + 8 * (textures[i if differs else 0][at[0], at[1]] - 120)
        grids.append(picture_of(np.where(rows < 130, columns / 2, np.clip(gray, 0, 255))))
        views.append(view)
        labels.append(np.where(np.arange(60)[:, None] < 33, -1, np.zeros((60, 80), np.int32)))
    line = np.column_stack([np.linspace(-2, 2, 200), np.ones(200), np.full(200, 6.0)])
    evidence = evidence_of(
        line, 2 * np.arange(201), np.tile(np.arange(2, dtype=np.int32), 200), 0.01
    )
    planes = Planes(normals=np.eye(3)[1:2], offsets=np.ones(1))
    known = evidence_arrays(evidence, planes, len(views))
    scene = make_scene(SimpleNamespace(views=views), grids, known, 1)
    samples = sample_at(np.array([[0.5, 1, 2.2]]), np.arange(2, dtype=np.int32))
    labels = np.concatenate([of.ravel() for of in labels]).astype(np.int32)
    return bool(are_enclosed(scene, samples, labels, grids)[0])


def test_a_lawn_goes_on_where_another_view_shows_its_texture():
    assert lawn_is_enclosed(differs=False)
    assert not lawn_is_enclosed(differs=True)


def floor_is_enclosed(
    depth_of_wall, backdrop=False, more_points=(), shows_background=False, depth_of_body=None
):
    """Whether a place on the floor is; above it is a wall, or no plane."""
    view = view_above_floor(0, np.zeros(3))
    rows, columns = np.mgrid[:240, :320]
    grid = blank_grid(view) if backdrop else picture_of(columns / 2 + rows / 3)
    labels = np.zeros(np.array(grid.gray.shape) // CELL_PX, np.int32)
    below = np.arange(len(labels)) + 0.5 - grid.principal[1] / CELL_PX
    above = below < grid.focal_px / CELL_PX / 4
    labels[above] = -1 if depth_of_wall is None else 1
    if shows_background:
        body = np.repeat(~above, CELL_PX)[:, None] & np.ones(grid.gray.shape[1], bool)
        grid = with_background(view, grid, body)
    if depth_of_body is not None:
        bodies = np.where(above[:, None], np.float32(depth_of_body), np.full(grid.shape, np.nan))
        grid = replace(grid, bodies=bodies.astype(np.float32))
    count = 200
    line = np.column_stack([np.linspace(-2, 2, count), np.ones(count), np.full(count, 2.0)])
    line = np.concatenate([line, np.reshape(more_points, (-1, 3))])
    seen_by = np.zeros(len(line), np.int32)
    evidence = evidence_of(line, np.arange(len(line) + 1), seen_by, 0.01)
    planes = Planes(normals=np.eye(3)[1:], offsets=np.array([1.0, depth_of_wall or 4]))
    samples = sample_at(np.array([[0.1, 1, 2.7]]), np.zeros(1, np.int32))
    known = evidence_arrays(evidence, planes, 1)
    scene = make_scene(SimpleNamespace(views=(view,)), [grid], known, 1)
    return bool(are_enclosed(scene, samples, labels.ravel(), [grid])[0])


def test_labels_may_end_a_small_cell_before_the_points_that_enclose_them():
    """A square on the floor, of which all cells but those next to its sides are labelled."""
    view = view_above_floor(0, np.zeros(3))
    rows, columns = np.mgrid[:240, :320]
    grid = picture_of(columns / 2 + rows / 3)
    along, ends = np.linspace(-1, 1, 400), np.ones(400)
    sides = [(along, ends), (along, -ends), (ends, along), (-ends, along)]
    square = np.concatenate([np.column_stack([x, ends, 3 + z]) for x, z in sides])
    touched = np.zeros(grid.shape, np.uint8)
    touched[cells_in(view, grid, square)] = 1
    inside = ndimage.binary_fill_holes(touched) & ~ndimage.binary_dilation(touched, np.ones((3, 3)))
    seen_by = np.zeros(len(square), np.int32)
    evidence = evidence_of(square, np.arange(len(square) + 1), seen_by, 0.01)
    floor = Planes(normals=np.eye(3)[1:2], offsets=np.ones(1))
    known = evidence_arrays(evidence, floor, 1)
    scene = make_scene(SimpleNamespace(views=(view,)), [grid], known, 1)
    samples = sample_at(np.array([[0.0, 1, 3]]), np.zeros(1, np.int32))
    labels = np.where(inside, 0, -1).astype(np.int32).ravel()
    given = (scene, samples, labels, [grid], 1)
    assert [are_enclosed(*given, side).tolist() for side in (1, 2)] == [[False], [True]]
