"""A face is seen from one side, by views that show the same there."""

from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from evidence import evidence_of

from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.decision import (
    EACH_VIEW,
    PLAIN_CELLS,
    Samples,
    are_believed,
    are_overexposed,
    are_plain,
    points_of_samples,
    sample_cells,
    thinned,
)
from colmap_edges.surfaces.faces.grids import blank_grid, halved
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import evidence_arrays, make_scene

CENTERS = np.array([[0.0, 0, 3], [0.2, 0, 3], [0, 0, -3], [0.2, 0, -3]])  # two above, two below
PLANES = Planes(normals=np.tile([0.0, 0, 1], (3, 1)), offsets=np.array([0, -0.3, 1.5]))
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


def corners_of_plate(height=0.0):
    """Corners above a plate's upper side, or of it, as evidence that all views observe."""
    corners = np.array([[x, y, height] for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    views = np.tile(np.arange(4, dtype=np.int32), len(corners))
    return evidence_of(corners, np.arange(len(corners) + 1) * 4, views, 0.01)


def support(labels_below):
    """What views say of a plate from z = -0.3 to 0, whose upper side the views above show."""
    views = four_views()
    grids = [halved(blank_grid(view)) for view in views]
    evidence = corners_of_plate()
    known = evidence_arrays(evidence, PLANES, len(views))
    scene = make_scene(SimpleNamespace(views=views), grids, known, 1)
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


def test_places_far_from_all_points_of_their_view_are_plain():
    samples, upper = support([1, 1])
    views = four_views()
    grids = [halved(blank_grid(view)) for view in views]
    plain = are_plain(samples, views, grids, corners_of_plate())
    cell = 3 * ANGLES[0]  # side of a cell of the views above, on the plate
    corners = np.abs(samples.points[:, :2]) - 0.5
    gaps = np.linalg.norm(corners, axis=1) / cell
    assert plain[upper & (gaps > PLAIN_CELLS + 1)].all()
    assert not plain[upper & (gaps < PLAIN_CELLS - 1)].any()
    assert 0 < np.sum(upper & ~plain) < np.sum(upper & plain)


@pytest.mark.parametrize(
    ("white", "height", "expected"),
    [((), 0.2, False), ((0, 1), 0.0, False), ((0, 1), -0.2, False), ((0, 1), 0.2, True)],
)
def test_images_are_overexposed_where_white_cells_are_next_to_points_before_them(
    white, height, expected
):
    samples, _ = support([1, 1])
    views = four_views()
    grids = [halved(blank_grid(view)) for view in views]
    for view, grid in enumerate(grids):
        grid.gray[:] = 255 if view in white else 200
    accepted = np.flatnonzero(samples.agreeing > 0)
    seeing = samples.views[samples.offsets[accepted]]
    assert 0.3 < np.mean(seeing < 2) < 0.7  # of the upper side
    evidence = corners_of_plate(height)
    assert are_overexposed(samples, accepted, PLANES, views, grids, evidence) == expected


def test_samples_are_thinned_to_points_of_a_third_of_their_views():
    samples, _ = support([1, 1])
    accepted = np.arange(len(samples.points))
    inside = np.zeros(len(accepted), bool)
    chosen = thinned(samples, accepted, inside, 1)
    assert 0 < len(chosen) < len(accepted)
    assert len(chosen) < len(thinned(samples, accepted, ~inside, 1)) < len(accepted)
    views = four_views()
    made = points_of_samples(samples, chosen, views, [halved(blank_grid(view)) for view in views])
    assert np.array_equal(made.points, samples.points[chosen])
    for row, sample in enumerate(chosen):
        seeing = samples.views[samples.offsets[sample] : samples.offsets[sample + 1]]
        first, last = made.track_offsets[row : row + 2]
        assert last - first == -(-len(seeing) // EACH_VIEW)
        assert np.isin(made.track_views[first:last], seeing).all()


def test_rays_come_from_views_that_show_the_middle_gray():
    views = [*four_views()[:1] * 6]
    grids = [halved(blank_grid(view)) for view in views]
    for i, grid in enumerate(grids):
        grid.gray[:] = 100 + 7 * i  # exposures differ
        grid.gray[:, grid.gray.shape[1] // 2 :] += 40 * (i % 3 == 0)  # something stands before it
    points = np.column_stack([np.linspace(-0.5, 0.5, 40), np.zeros((40, 2))])
    none = np.zeros(len(points), np.int32)
    samples = Samples(
        points=points,
        sizes=np.full(len(points), 0.01),
        cells=none,
        planes=none,
        holding=none + 6,
        agreeing=none + 6,
        through=none,
        hidden=none,
        offsets=6 * np.arange(len(points) + 1),
        views=np.tile(np.arange(6, dtype=np.int32), len(points)),
    )
    made = points_of_samples(samples, np.arange(len(points)), views, grids)
    assert np.all(np.diff(made.track_offsets) == 6 // EACH_VIEW)
    covered = np.repeat(made.points[:, 0] > 0.05, np.diff(made.track_offsets))
    assert covered.any()
    assert not np.isin(made.track_views[covered], [0, 3]).any()


def test_without_accepted_samples_there_are_no_points():
    samples, _ = support([1, 1])
    views = four_views()
    grids = [halved(blank_grid(view)) for view in views]
    made = points_of_samples(samples, np.zeros(0, np.int64), views, grids)
    assert len(made.points) == len(made.track_views) == 0
    assert made.track_offsets.tolist() == [0]
