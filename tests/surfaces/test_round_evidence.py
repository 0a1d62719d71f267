"""Points on round bodies: where rays to observed points pass, there is no surface."""

import numpy as np
import pytest

from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.round_evidence import Rays, frontal_views, seen_on_body

HEIGHTS, TURNS = np.meshgrid(np.linspace(0, 1, 11), np.arange(48) * np.pi / 24)
NORMALS = np.stack([np.cos(TURNS), np.sin(TURNS), 0 * TURNS], axis=-1).reshape(-1, 3)
POINTS = NORMALS + HEIGHTS.reshape(-1, 1) * [0, 0, 1]  # on a cylinder of radius 1
STEP = 0.14
CENTERS = np.array([(5 * np.cos(turn), 5 * np.sin(turn), 0.5) for turn in np.arange(8) * np.pi / 4])


def seen(passed, from_outside=1.0):
    """The points that are kept where rays enter the cylinder at some of them and end inside.

    Rays come along the normals, or nearly along the surface if `from_outside` is small.
    """
    tangents = np.cross(NORMALS[passed], [0, 0, 1])
    directions = -from_outside * NORMALS[passed] + np.sqrt(1 - from_outside**2) * tangents
    count = len(directions)
    rays = Rays(
        views=np.zeros(count, np.int32),
        starts=POINTS[passed] - 4 * directions,
        directions=directions,
        lengths=np.full(count, 4.5),
        limits=np.full(count, 0.1),
    )
    sight = rays.met(np.arange(count), np.full(count, 4.0), np.zeros(count))
    frontal = frontal_views(POINTS, NORMALS, np.ones((len(POINTS), len(CENTERS)), bool), CENTERS)
    nothing = np.zeros((0, 3))
    evidence = Evidence(
        points=nothing,
        tangents=nothing,
        rays=nothing,
        sigmas=np.zeros(0),
        ray_sigmas=np.zeros(0),
        weights=np.zeros(0),
        edge_ids=np.zeros(0, np.int64),
        offsets=np.zeros(1, np.int64),
        views=np.zeros(0, np.int32),
    )
    return seen_on_body(POINTS, NORMALS, frontal, np.arange(8), evidence, sight, STEP)


def test_all_points_are_kept_where_no_ray_passes():
    assert len(seen(np.zeros(0, np.int64)).points) == len(POINTS)


def test_a_slot_through_which_rays_pass_has_no_points():
    slot = np.flatnonzero((POINTS[:, 0] > 0.9) & (POINTS[:, 2] > 0.3) & (POINTS[:, 2] < 0.7))
    kept = seen(slot)
    assert isinstance(kept, SeenPoints)
    distances = np.linalg.norm(kept.points[:, None] - POINTS[slot], axis=2).min(axis=1)
    assert distances.min() > STEP
    near = np.linalg.norm(POINTS[:, None] - POINTS[slot], axis=2).min(axis=1) <= STEP
    assert len(kept.points) == len(POINTS) - near.sum()


def test_rays_of_an_eighth_of_the_turn_leave_a_body_and_those_of_half_of_it_none():
    angles = np.arctan2(POINTS[:, 1], POINTS[:, 0])
    assert seen(np.flatnonzero(np.abs(angles) < np.pi / 8)) is not None
    assert seen(np.flatnonzero(np.abs(angles) < np.pi / 2)) is None


@pytest.mark.parametrize("cosine, kept", [(0.2, True), (0.5, False)])
def test_rays_that_graze_the_body_say_nothing(cosine, kept):
    points = seen(np.arange(len(POINTS)), cosine)
    assert (points is not None and len(points.points) == len(POINTS)) == kept
