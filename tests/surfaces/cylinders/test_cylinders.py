"""Cylinders are found from their outlines, told from posts, and get points that views see."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from evidence import points_behind
from plain_rooms import model_of
from round_scenes import noisy_graph, views_around

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import rows_by_view
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges2d.straight_pieces import near_observations
from colmap_edges.surfaces.cylinders import hypotheses
from colmap_edges.surfaces.cylinders.finding import find_cylinders
from colmap_edges.surfaces.faces.evidence import gather_evidence
from colmap_edges.surfaces.outlines2d import find_outlines

AXIS = unit(np.array([0.2, 0.1, 1.0]))
BASE, RADIUS, HEIGHT = np.array([0.1, -0.2, 0.1]), 0.4, 1.2


def outlines_of_cylinder(view):
    """Both outlines (2, n, 3) of the cylinder in a view."""
    away = view.center - BASE
    across = away - (away @ AXIS) * AXIS
    distance = np.linalg.norm(across)
    toward, aside = across / distance, np.cross(AXIS, across / distance)
    share = RADIUS / distance
    normals = [share * toward + sign * np.sqrt(1 - share**2) * aside for sign in (1, -1)]
    way = np.linspace(0, HEIGHT, 200)[:, None] * AXIS
    return np.array([BASE + RADIUS * normal + way for normal in normals])


def outlines_of_post(view):
    """Those two upright edges (2, n, 3) of a square post that are its outlines in a view."""
    x, y = np.meshgrid([-RADIUS, RADIUS], [-RADIUS, RADIUS])
    feet = np.column_stack([x.ravel(), y.ravel(), np.zeros(4)])
    columns = view.project(feet)[0][:, 0]
    way = np.linspace(0, HEIGHT, 200)[:, None] * (0, 0, 1)
    return np.array([feet[i] + way for i in (columns.argmin(), columns.argmax())])


def stripe_of_slab(view):
    """Both borders (2, n, 3) of a level stripe, on the side of an upright slab that a view sees."""
    way = np.linspace(-HEIGHT, HEIGHT, 200)[:, None] * (1, 0, 0)
    side = np.array([0, np.sign(view.center[1]) * RADIUS / 4, 1.7])
    borders = side + np.array([[0, 0, -RADIUS / 2], [0, 0, RADIUS / 2]])
    return borders[:, None] + way


def graph_of(view, curves, rng):
    """The edge graph of a view that shows (E, n, 3) curves."""
    return noisy_graph([view.project_undistorted(curve)[0] for curve in curves], rng)


def scene_of(outlines, lift=0.4):
    """Views that show a body, and the straight pieces of what they show."""
    views, rng = views_around(np.array([0, 0, 0.6]), lift), np.random.default_rng(0)
    graphs = Graphs.of([graph_of(view, outlines(view), rng) for view in views])
    lines = find_outlines(views, graphs, Edges3D.none(), 1).lines
    return SimpleNamespace(views=views, model=model_of(views), lines=lines)


def found_in(scene, evidence=None):
    evidence = evidence or gather_evidence(scene.model, Edges3D.none())
    return find_cylinders(scene.lines, scene.views, evidence, 0)


@pytest.fixture(scope="module")
def can():
    return scene_of(outlines_of_cylinder)


@pytest.fixture(scope="module")
def found(can):
    return found_in(can)


def distances_from_axis(points):
    """(N,) distances of (N, 3) points from the true axis."""
    return np.linalg.norm(np.cross(points - BASE, AXIS), axis=1)


def test_a_cylinder_is_found_from_its_outlines(can, found):
    (one,) = found.faces
    places, radii = one.profile.T
    assert (one.kind, radii.tolist()) == ("cylinder", [pytest.approx(RADIUS, rel=2e-3)] * 2)
    ends = one.point + places[:, None] * one.direction
    assert distances_from_axis(ends) == pytest.approx(0, abs=2e-3)
    assert 0.9 * HEIGHT < np.ptp(places) < 1.01 * HEIGHT
    assert one.views.tolist() == list(range(len(can.views)))


def test_its_points_lie_on_it_and_are_seen_from_outside(can, found):
    seen = found.points
    assert len(seen.points) > 300
    assert distances_from_axis(seen.points) == pytest.approx(RADIUS, abs=2e-3)
    owners = np.repeat(np.arange(len(seen.points)), np.diff(seen.track_offsets))
    centers = np.array([view.center for view in can.views])[seen.track_views]
    outwards = seen.points - BASE
    outwards -= (outwards @ AXIS)[:, None] * AXIS
    facing = np.einsum("ij,ij->i", centers - seen.points[owners], outwards[owners])
    assert np.all(facing > 0)


def test_hypotheses_left_out_early_have_no_radius(can, monkeypatch):
    lines, views = can.lines, can.views
    rows = rows_by_view(lines.views, len(views))
    found, bases = hypotheses.find_hypotheses(lines, rows)
    kernel = hypotheses._kernels.pairs_of_one_radius
    monkeypatch.setattr(
        hypotheses._kernels,
        "pairs_of_one_radius",
        lambda *given: kernel(*given[:-1], 100 * hypotheses.NEAR_PX),
    )
    all_found, all_bases = hypotheses.find_hypotheses(lines, rows)
    assert len(bases) > 0
    np.testing.assert_array_equal(bases, all_bases)
    for own, other in zip(found, all_found, strict=True):
        np.testing.assert_array_equal(own, other)


def test_a_square_post_is_no_cylinder():
    assert found_in(scene_of(outlines_of_post)).faces == []


def test_a_stripe_seen_from_two_sides_is_no_cylinder():
    assert found_in(scene_of(stripe_of_slab, lift=0.1)).faces == []


def test_outlines_that_are_fixed_edges_are_of_no_cylinder(can):
    fixed = replace(can.lines, fixed=np.ones(len(can.lines.views)))
    assert found_in(replace_lines(can, fixed)).faces == []


def replace_lines(scene, lines):
    return SimpleNamespace(views=scene.views, model=scene.model, lines=lines)


def test_rays_through_the_body_refuse_it(can):
    middle = BASE + np.linspace(0.4, 0.8, 5)[:, None] * HEIGHT * AXIS
    assert found_in(can, points_behind(can.views, middle)).faces == []


def test_nothing_without_lines(can):
    none = can.lines.select(np.zeros(0, np.int64))
    found = found_in(replace_lines(can, none))
    assert (found.faces, len(found.points.points)) == ([], 0)


def test_points_beside_observations_belong_to_edges():
    near = near_observations(20, np.array([2.3, 15.0, np.nan]))
    assert np.flatnonzero(near).tolist() == [*range(7), *range(11, 20)]
