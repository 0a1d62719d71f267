"""A face is seen from one side; a mesh that is as the face says needs no points of it."""

from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.decision import (
    EACH_VIEW,
    PLAIN_CELLS,
    SAME_CELLS,
    FacePoints,
    are_believed,
    are_plain,
    gaps_to_mesh,
    lacking_points,
    points_of_samples,
    sample_cells,
    thinned,
)
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.grids import blank_grid
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import make_scene
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.silhouettes import SeenPoints

CENTERS = np.array([[0.0, 0, 3], [0.2, 0, 3], [0, 0, -3], [0.2, 0, -3]])  # two above, two below
ANGLES = np.full(4, 4 / 320)  # of a cell


def four_views():
    """Views of the origin from `CENTERS`, whose small pictures have a focal length of 320."""
    camera = pycolmap.Camera(model="PINHOLE", width=80, height=80, params=[80, 80, 40, 40])
    views = []
    for i, center in enumerate(CENTERS):
        up = np.sign(center[2])
        rotation = np.array([[1, 0, 0], [0, -up, 0], [0, 0, -up]])
        name, turned = f"{i}.png", -rotation @ center
        views.append(
            View(
                image_id=i + 1,
                name=name,
                width=80,
                height=80,
                camera=camera,
                rotation=rotation,
                translation=turned,
            )
        )
    return tuple(views)


def corners_of_plate():
    """Corners of a plate's upper side as evidence that all views observe."""
    corners = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    count = len(corners)
    return Evidence(
        points=corners,
        tangents=np.zeros((count, 3)),
        rays=np.tile([0.0, 0, 1], (count, 1)),
        sigmas=np.full(count, 0.01),
        ray_sigmas=np.full(count, 0.01),
        weights=np.ones(count),
        offsets=np.arange(count + 1) * 4,
        views=np.tile(np.arange(4, dtype=np.int32), count),
    )


def support(labels_below):
    """What views say of a plate from z = -0.3 to 0, whose upper side the views above show."""
    views = four_views()
    grids = [blank_grid(view) for view in views]
    evidence = corners_of_plate()
    planes = Planes(normals=np.tile([0.0, 0, 1], (3, 1)), offsets=np.array([0, -0.3, 1.5]))
    scene = make_scene(SimpleNamespace(views=views), grids, evidence, planes, 1)
    cells = grids[0].gray.size // 16
    labels = np.repeat(np.array([0, 0, *labels_below], np.int32), cells)
    samples = sample_cells(scene, labels, CENTERS, ANGLES, 1)
    upper = np.abs(samples.points[:, 2]) < 1e-9
    middle = upper & (np.abs(samples.points[:, :2]).max(axis=1) < 0.5)
    return samples, middle & (samples.planes == 0)


def test_views_below_a_plate_do_not_hide_its_upper_side():
    samples, upper = support([1, 1])
    assert upper.sum() > 100
    assert set(samples.holding[upper]) == {2}
    assert set(samples.agreeing[upper]) == {2}
    assert not samples.hidden[upper].any()
    assert are_believed(samples)[upper].all()


def test_views_below_do_not_agree_on_the_upper_side():
    samples, _ = support([0, 0])
    assert set(samples.agreeing) <= {1, 2}
    for first, last in zip(samples.offsets[:-1], samples.offsets[1:], strict=True):
        assert len(set(samples.views[first:last] // 2)) == 1


def test_views_below_that_see_through_a_plate_contradict_it():
    samples, upper = support([1, 2])
    assert set(samples.through[upper]) == {1}
    assert not are_believed(samples)[upper].any()


def mesh_of(corners, faces):
    """A mesh without colours."""
    count = len(corners)
    none, black = np.full(count, -1, np.int64), np.zeros((count, 3), np.uint8)
    return Mesh(vertices=corners, faces=faces, point3D_ids=none, colors=black)


@pytest.fixture
def square():
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return mesh_of(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))  # seen from above


@pytest.fixture
def empty():
    return mesh_of(np.zeros((0, 3)), np.zeros((0, 3), np.int32))


def missing(square, point, view):
    """Whether a square lacks a place that a view sees in cells of 0.04."""
    return gaps_to_mesh(points_seen([point], view), four_views(), square)[0] > SAME_CELLS


def points_seen(points, view):
    """Points that one view sees."""
    count = len(points)
    views = np.full(count, view, np.int32)
    return SeenPoints(np.array(points, float), np.arange(count + 1), views)


def test_places_on_a_triangle_that_faces_the_view_are_not_missing(square):
    assert not missing(square, [0.3, 0.2, 0], 0)
    assert not missing(square, [-0.7, 0.9, 0.005], 1)


def test_places_off_triangles_are_missing(square):
    assert missing(square, [0.3, 0.2, 0.03], 0)  # before it
    assert missing(square, [1.2, 0.2, 0], 0)  # beside it
    assert missing(square, [0.3, 0.2, 0], 2)  # on its back


def test_nothing_is_there_of_an_empty_mesh(empty):
    assert missing(empty, [0.3, 0.2, 0], 0)


def taken_points(surface, counts):
    """The points taken, where a square has some of each plane's points and lacks others.

    Args:
        surface: the square, or an empty mesh, which lacks all.
        counts: of each plane, how many of its points the mesh has, and how many it lacks.
    """
    has, lacks = [0.3, 0.2, 0.0], [0.3, 0.2, 0.5]
    points = [place for had, lacked in counts for place in [has] * had + [lacks] * lacked]
    planes = np.repeat(np.arange(len(counts), dtype=np.int32), [sum(pair) for pair in counts])
    faces = FacePoints(seen=points_seen(points, 0), planes=planes)
    return lacking_points(faces, four_views(), surface)


def test_all_points_of_planes_that_a_mesh_lacks_are_taken(square):
    taken = taken_points(square, [(9, 1), (2, 8)])
    assert len(taken.points) == 10  # of the second plane, also those that the mesh has
    assert np.sum(taken.points[:, 2] == 0) == 2


def test_everything_is_taken_without_a_mesh(empty):
    assert len(taken_points(empty, [(2, 1)]).points) == 3


def test_places_far_from_all_points_of_their_view_are_plain():
    samples, upper = support([1, 1])
    views = four_views()
    grids = [blank_grid(view) for view in views]
    plain = are_plain(samples, views, grids, corners_of_plate())
    cell = 3 * ANGLES[0]  # side of a cell of the views above, on the plate
    corners = np.abs(samples.points[:, :2]) - 0.5
    gaps = np.linalg.norm(corners, axis=1) / cell
    assert plain[upper & (gaps > PLAIN_CELLS + 1)].all()
    assert not plain[upper & (gaps < PLAIN_CELLS - 1)].any()
    assert 0 < np.sum(upper & ~plain) < np.sum(upper & plain)


def test_samples_are_thinned_to_points_of_every_third_view():
    samples, _ = support([1, 1])
    accepted = np.arange(len(samples.points))
    chosen = thinned(samples, accepted)
    assert 0 < len(chosen) < len(accepted)
    made = points_of_samples(samples, accepted)
    assert np.array_equal(made.planes, samples.planes[chosen])
    assert np.array_equal(made.seen.points, samples.points[chosen])
    for row, sample in enumerate(chosen):
        views = samples.views[samples.offsets[sample] : samples.offsets[sample + 1]]
        first, last = made.seen.track_offsets[row : row + 2]
        assert made.seen.track_views[first:last].tolist() == views[::EACH_VIEW].tolist()
