"""The sky is found above houses, not in rooms, and its rays keep the mesh open."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from curves import model_of
from plain_rooms import upright_view

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.core.upright import up_directions
from colmap_edges.options import MeshingOptions
from colmap_edges.surfaces.faces.finding import NO_FACES
from colmap_edges.surfaces.mesher import mesh_with_curves
from colmap_edges.surfaces.sky.colours import Colors
from colmap_edges.surfaces.sky.finding import find_sky
from colmap_edges.surfaces.sky.infinity import Matches, are_contradicted, spread
from colmap_edges.surfaces.sky.regions import Regions, below_structure, smooth_regions

CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=160, height=120, params=[120, 80, 60])
# Two towers on a meadow, which ends before the horizon: from, to in x; height.
TOWERS = [(-2.0, -1.0, 2.4), (0.7, 2.0, 1.8)]
MEADOW = (-4.0, 4.0, -3.0, 1.0)  # from, to in x and y
HAZE, BLUE, WHITE = (150, 152, 150), (230, 205, 180), (255, 255, 255)  # BGR
UP = np.array([0, 0, 1.0])


def make_views(count=9):
    """Views of the towers, which stand at y = 0, from both sides and two heights."""
    views = []
    for i, x in enumerate(np.linspace(-3, 3, count)):
        spot = np.array([x, 0.1 * x * x - 6, 1 + 0.5 * (i % 2)])
        views.append(upright_view(i, CAMERA, spot, np.array([0.1, 0, 1.4]) - spot))
    return views


def checks(*coordinates):
    """Dark and bright squares, on which structure is seen."""
    return 40 + 90.0 * (sum(np.floor(4 * x) for x in coordinates) % 2)


def sky_color(directions, colors):
    """(N, 3) colours at infinity, with a horizon; clouds are white."""
    above, haze = (np.array(color, float) for color in colors)
    up = directions[:, 2] / np.linalg.norm(directions, axis=1)
    smooth = above + 30 * up[:, None] * (1 - above / 255)
    return np.where(up[:, None] > 0, smooth, haze)


def render(view, colors=(BLUE, HAZE)):
    """What a view sees of towers, meadow and sky."""
    rays = rays_of_pixels(view)
    image = sky_color(rays, colors)
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = view.center + (-view.center[2] / rays[:, 2])[:, None] * rays
        front = view.center + (-view.center[1] / rays[:, 1])[:, None] * rays
    low, high, near, far = MEADOW
    inside = (rays[:, 2] < 0) & (ground[:, 0] > low) & (ground[:, 0] < high)
    inside &= (ground[:, 1] > near) & (ground[:, 1] < far)
    image[inside] = np.outer(checks(*ground[inside, :2].T), (0.5, 1, 0.8))
    for left, right, top in TOWERS:
        inside = (front[:, 0] > left) & (front[:, 0] < right)
        inside &= (front[:, 2] > 0) & (front[:, 2] < top)
        image[inside] = np.outer(checks(front[inside, 0], front[inside, 2]), (0.9, 1, 1))
    return image.reshape(120, 160, 3).round().astype(np.uint8)


def structure():
    """Points on towers and meadow, at the corners of their squares."""
    points = []
    for left, right, top in TOWERS:
        x, z = np.meshgrid(np.arange(left, right + 0.01, 0.1), np.arange(0, top + 0.01, 0.1))
        points.append(np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3))
    x, y = np.meshgrid(np.arange(*MEADOW[:2], 0.15), np.arange(*MEADOW[2:], 0.15))
    points.append(np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3))
    return np.concatenate(points)


def scene(views, points=None):
    """A model of views that observe all points in their images."""
    points = structure() if points is None else points
    observed = np.array([view.holds(*view.project(points)) for view in views]).T
    return replace(
        model_of(views),
        points3D_xyz=points,
        point3D_ids=np.arange(len(points)),
        points3D_rgb=np.zeros((len(points), 3), np.uint8),
        track_offsets=offsets_of(observed.sum(axis=1)),
        track_views=np.nonzero(observed)[1].astype(np.int32),
        track_points2D=np.zeros((observed.sum(), 2)),
    )


def sky_of(model, pictures):
    """(V,) masks of the sky, or None."""
    found = find_sky(model, Edges3D.none(), dict(enumerate(pictures)))
    return found and [~mask.body() if mask.is_seen else None for mask in found[1].masks]


def rays_of_pixels(view):
    """Viewing rays of all pixels, row by row."""
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    return view.rays(np.column_stack([x.ravel(), y.ravel()]))


def is_empty(view, colors):
    """Whether pixels show what lies at infinity, row by row."""
    far = sky_color(rays_of_pixels(view), colors).round()
    return (render(view, colors).reshape(-1, 3) == far).all(axis=1)


def shares(views, masks, colors=(BLUE, HAZE)):
    """Shares of the sky that are found, and of all else that is taken for it."""
    right, wrong = [], []
    for view, mask in zip(views, masks, strict=True):
        empty = is_empty(view, colors)
        found = np.zeros(empty.shape, bool) if mask is None else mask.ravel()
        right.append(found[empty].mean())
        wrong.append(found[~empty].mean())
    return np.mean(right), np.max(wrong)


def test_sky_and_haze_are_found():
    views = make_views()
    masks = sky_of(scene(views), [render(view) for view in views])
    found, wrong = shares(views, masks)
    assert found > 0.8
    assert wrong < 0.01


def test_overexposed_parts_are_found_beside_blue_ones():
    views = make_views()
    colors = [(WHITE, HAZE) if i in (3, 4) else (BLUE, HAZE) for i in range(len(views))]
    masks = sky_of(scene(views), list(map(render, views, colors)))
    assert all(mask is not None and mask[0].mean() > 0.3 for mask in masks)
    assert sky_of(scene(views), [render(view, (WHITE, HAZE)) for view in views]) is None


@pytest.mark.parametrize("color", [(160, 160, 160), (150, 170, 200), (120, 90, 100)])
def test_walls_are_no_sky(color):
    """Gray, yellow and lilac walls above and behind all points."""
    views = make_views()
    assert sky_of(scene(views), [render(view, (color, color)) for view in views]) is None


def test_bluish_walls_move_before_the_sky():
    """Strips of a wall in the shade, near the border of some images."""
    views, pictures, wall = make_views(), [], ((150, 160, 170), (150, 160, 170))
    for view in views:
        picture, rays = render(view, wall), rays_of_pixels(view)
        at = view.center + ((1.5 - view.center[1]) / rays[:, 1])[:, None] * rays
        strip = (np.abs(at[:, 0]) > 2.5) & (np.abs(at[:, 0]) < 3.5) & (at[:, 2] > 1)
        picture.reshape(-1, 3)[strip & is_empty(view, wall)] = BLUE
        pictures.append(picture)
    assert sum((picture[0] == BLUE).all(axis=1).any() for picture in pictures) >= 5
    assert sky_of(scene(views), pictures) is None


def test_what_lies_below_the_horizon_is_no_sky():
    """A blue table cloth, seen from above."""
    views = []
    for i, angle in enumerate(np.linspace(-0.8, 0.8, 8)):
        spot = np.array([7 * np.sin(angle), -7 * np.cos(angle), 6])
        views.append(upright_view(i, CAMERA, spot, -spot))
    pictures = [render(view, (BLUE, BLUE)) for view in views]
    assert sky_of(scene(views), pictures) is None


def regions_below_the_sky():
    """Of each of three views the sky, regions 0 to 2, and a region below it, 3 to 5.

    Structure separates the last one of these from its sky.
    """
    labels, near = np.full((3, 40, 40), -1, np.int32), np.zeros((3, 40, 40), bool)
    for view in range(3):
        labels[view, :10] = view
        labels[view, 12:30, 5:35] = 3 + view
    near[2, 10:12] = True
    return Regions(
        pictures=[np.zeros((40, 40, 3), np.uint8)] * 3,
        labels=list(labels),
        near=list(near),
        views=np.array([0, 1, 2, 0, 1, 2]),
        below=np.zeros(6, bool),
    )


def found_among(*pairs):
    """Which regions are found if 0 to 2 are the sky; pairs are source, target, samples, agree."""
    sources, targets, counts, agree = (np.array(column) for column in zip(*pairs, strict=True))
    matches = Matches(
        np.full(6, 100),
        np.repeat(sources, counts),
        np.repeat(targets, counts),
        np.repeat(agree, counts),
    )
    return spread(matches, regions_below_the_sky(), np.arange(6) < 3).tolist()


@pytest.mark.parametrize("in_the_sky, is_roof", [(2, False), (15, True)])
def test_a_roof_agrees_with_itself_alone(in_the_sky, is_roof):
    # Samples of regions 3 and 4 agree with each other and with 5, and some lie in the sky.
    pairs = [(3, 4, 60, True), (3, 5, 30, True), (3, 1, in_the_sky, False)]
    pairs += [(4, 3, 60, True), (4, 5, 30, True), (4, 0, in_the_sky, False)]
    assert found_among(*pairs) == [True] * 3 + [not is_roof] * 2 + [False]


def test_what_agreed_with_a_roof_alone_is_no_sky_either():
    # The samples of region 3 that lie in the sky tell that it is a roof. Those of 4 are too few.
    pairs = [(3, 4, 60, True), (3, 5, 60, True), (3, 1, 20, False)]
    pairs += [(4, 3, 60, True), (4, 0, 8, False)]
    assert found_among(*pairs) == [True] * 3 + [False] * 3


def test_a_blue_gable_is_elsewhere_in_other_views():
    # Samples of sky 0 lie in sky 1 and in roof 3, those of gable 2 in the roof, of sky 1 nowhere.
    sources, targets = np.repeat([[0, 0, 2], [1, 3, 3]], (10, 90, 100), axis=1)
    matches = Matches(np.full(4, 100), sources, targets, np.zeros(200, bool))
    is_sky = np.array([True, True, True, False])
    assert are_contradicted(matches, is_sky).tolist() == [False, False, True, False]


def test_points_in_a_region_contradict_the_sky():
    """A blue ceiling with lamps."""
    views, random = make_views(), np.random.default_rng(0)
    lamps = np.column_stack([random.uniform((-8, 0), (8, 8), (3000, 2)), np.full(3000, 4.0)])
    model = scene(views, np.concatenate([structure(), lamps]))
    assert sky_of(model, [render(view) for view in views]) is None


@pytest.mark.parametrize("turns", [1, 3])
@pytest.mark.parametrize("all_of_them", [False, True])
def test_photographs_may_be_turned(turns, all_of_them):
    views, pictures = make_views(), []
    for i, view in enumerate(views):
        picture = render(view)
        if all_of_them or i % 3 == 0:
            angle = np.pi / 2 * turns
            cos, sin = np.cos(angle), np.sin(angle)
            turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
            camera = pycolmap.Camera(
                model="SIMPLE_PINHOLE", width=120, height=160, params=[120, 60, 80]
            )
            views[i] = replace(
                view,
                width=120,
                height=160,
                camera=camera,
                rotation=turn @ view.rotation,
                translation=turn @ view.translation,
            )
            picture = np.ascontiguousarray(np.rot90(picture, -turns))
        pictures.append(picture)
    masks = sky_of(scene(views), pictures)
    assert masks is not None
    assert min(np.mean(mask) for mask in masks if mask is not None) > 0.2
    assert abs(up_directions(views)[0] @ UP) > 0.98


def test_structure_casts_its_shadow_downwards():
    near = np.zeros((60, 80), bool)
    near[20, 30:40] = True
    below = below_structure(near, 0.0)
    assert below[20:, 31:39].all()
    assert not below[:19].any()
    assert not below[:, :28].any()
    aside = below_structure(near, np.pi / 2)  # up is to the right
    assert aside[19:22, :30].any(axis=0).all()
    assert not aside[:, 42:].any()


def test_regions_end_below_structure():
    """The wall of a tower has the colour of the sky, and no line between them."""
    picture = np.full((60, 80, 3), 200, np.uint8)
    near = np.zeros((60, 80), bool)
    near[20, 30:50] = True
    regions, counts = smooth_regions(picture, near, below_structure(near, 0.0))
    assert counts == [1, 1]
    assert regions[5, 40] == 0
    assert regions[40, 40] == 1


def test_colours_are_compared_with_those_of_structure():
    gray = Colors.of(np.tile(np.arange(200, dtype=np.uint8)[:, None], 3))
    bluish = Colors.of(
        np.column_stack([np.arange(55, 255), *2 * [np.arange(0, 200)]]).astype(np.uint8)
    )
    assert gray.below_blue(np.array([200.0, 190, 180]))
    assert not bluish.below_blue(np.array([200.0, 190, 180]))
    assert gray.below_blue(np.array([120.0, 90, 60]))  # deep blue may be dark
    assert not gray.below_blue(np.array([30.0, 20, 10]))
    assert not gray.below_blue(np.array([190.0, 200, 180]))  # green
    assert gray.below_white(np.array([255.0, 254, 252]))
    assert not gray.below_white(np.array([240.0, 240, 240]))


def test_rays_of_the_sky_open_the_mesh_and_leave_faces():
    """Without them the mesh spans the gap between the towers."""
    views = make_views()
    model = scene(views)
    sky, _ = find_sky(model, Edges3D.none(), dict(enumerate(map(render, views))))
    middle, track = np.array([[1.25, 0, 0.95]]), np.array([0, 2])
    points = SeenPoints(middle, track, np.array([3, 4], np.int32))
    faces = replace(NO_FACES, points=points)
    options = replace(MeshingOptions(), long_facet_factor=0.0)

    def found(background):
        mesh = mesh_with_curves(model, (Edges3D.none(), None), options, 1, background, faces)
        return mesh.vertices[mesh.faces], mesh.point3D_ids

    def spanning(triangles):
        x, _, z = np.moveaxis(triangles.mean(axis=1), 1, 0)
        return np.sum((x > -0.9) & (x < 0.6) & (z > 0.8))

    closed, _ = found(None)
    opened, ids = found(sky)
    assert spanning(closed) > 0
    assert spanning(opened) == 0
    assert len(structure()) in ids  # the point of a face


def turned_away(mesh, model):
    """(F,) whether all cameras that observe corners of a triangle see it from behind."""
    corners = mesh.vertices[mesh.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = np.ones(len(mesh.faces), bool)
    for view in range(len(model.views)):
        own = np.zeros(len(model.points3D_xyz), bool)
        own[model.track_points[model.track_views == view]] = True
        observed = (own[mesh.point3D_ids[mesh.faces]] & (mesh.point3D_ids[mesh.faces] >= 0)).any(
            axis=1
        )
        towards = ((model.views[view].center - corners[:, 0]) * outward).sum(axis=1) > 0
        away &= ~(observed & towards)
    return away


def test_volumes_behind_the_towers_are_not_closed_by_long_triangles():
    """Rays of the sky bound what no view sees, which is no surface."""
    views = make_views()
    model = scene(views)
    sky, _ = find_sky(model, Edges3D.none(), dict(enumerate(map(render, views))))

    def long_ones(factor):
        options = replace(MeshingOptions(), long_facet_factor=factor)
        mesh = mesh_with_curves(model, (None, None), options, 1, sky)
        corners = mesh.vertices[mesh.faces]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        return turned_away(mesh, model) & (sides > 0.3 * 6)

    assert long_ones(0.0).sum() > 0
    assert long_ones(0.5).sum() == 0
