"""Planes through edges and points of walls."""

import numpy as np
import pytest

from colmap_edges.surfaces.faces import hypotheses
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.hypotheses import find_planes

SIGMA = 0.004
CENTERS = np.array([[1.0, 0.5, -100]])  # of the only view


def evidence_of(points, tangents, weights):
    """Of points that one view sees from far along z."""
    count = len(points)
    return Evidence(
        points=points,
        tangents=tangents,
        rays=np.tile([0.0, 0.0, 1.0], (count, 1)),
        sigmas=np.full(count, SIGMA),
        ray_sigmas=np.full(count, SIGMA / 2),
        weights=weights,
        edge_ids=np.full(count, -1),
        offsets=np.arange(count + 1),
        views=np.zeros(count, np.int32),
    )


def rectangle(rng, width, height, count):
    """Points and tangents along the sides of a rectangle at z = 0."""
    side = rng.integers(0, 4, count)
    along = rng.uniform(-0.5, 0.5, count)
    points, tangents = np.zeros((count, 3)), np.zeros((count, 3))
    flat = side < 2
    points[flat, 0], points[~flat, 0] = width * along[flat], width * (side[~flat] - 2.5)
    points[flat, 1], points[~flat, 1] = height * (side[flat] - 0.5), height * along[~flat]
    tangents[flat, 0] = tangents[~flat, 1] = 1
    return points, tangents


def error_of(planes, normal, offset):
    """The least of the errors of planes at the corners of a wall of 3 by 2.4."""
    corners = np.array([[x, y, 0.0] for x in (-1.5, 1.5) for y in (-1.2, 1.2)])
    corners += (offset - corners @ normal)[:, None] * normal
    return np.abs(corners @ planes.normals.T - planes.offsets).max(axis=0).min()


def test_a_picture_does_not_tilt_its_wall():
    rng = np.random.default_rng(0)
    wall, tangents = rectangle(rng, 3, 2.4, 400)
    picture = np.column_stack([rng.uniform(0.1, 0.8, 1600), rng.uniform(-0.3, 0.6, 1600)])
    picture = np.column_stack([picture, np.full(1600, -2.5 * SIGMA)])
    points = np.concatenate([wall, picture])
    points[:, 2] += SIGMA / 2 * rng.normal(size=len(points))
    tangents = np.concatenate([tangents, np.zeros_like(picture)])
    for seed in range(4):
        evidence = evidence_of(points, tangents, np.ones(len(points)))
        planes = find_planes(evidence, CENTERS, np.random.default_rng(seed))
        assert error_of(planes, np.array([0.0, 0, 1]), 0.0) < SIGMA


def test_points_on_no_plane_are_drawn_again(monkeypatch):
    """Of 100 pairs none or one would be of the plane with 0.6 % of the points."""
    monkeypatch.setattr(hypotheses, "NUM_PAIRS", 100)
    rng = np.random.default_rng(1)
    much = rng.uniform(-3, 3, (20_000, 3))
    much[:, 2] = np.where(rng.random(20_000) < 0.5, -2.0, 2.0)
    little, tangents = rectangle(rng, 3, 2.4, 120)
    slope = np.array([[1.0, 0, 0], [0, 0.8, 0.6], [0, -0.6, 0.8]])
    points = np.concatenate([much, little @ slope])
    points += SIGMA / 2 * rng.normal(size=points.shape)
    tangents = np.concatenate([np.zeros_like(much), tangents @ slope])
    for seed in range(4):
        evidence = evidence_of(points, tangents, np.ones(len(points)))
        planes = find_planes(evidence, CENTERS, np.random.default_rng(seed))
        assert error_of(planes, slope[2], 0.0) < 2 * SIGMA


def lines_of(*ends, count=150):
    """Points and tangents along lines between two ends each."""
    points = [np.linspace(*map(np.array, pair), count) for pair in ends]
    tangents = [np.broadcast_to(each[-1] - each[0], each.shape) for each in points]
    found = np.concatenate(tangents)
    return np.concatenate(points), found / np.linalg.norm(found, axis=1, keepdims=True)


def planes_of_ceiling(seed, centers):
    """Planes of a room of which the wall at x = 3 is known by its line with the ceiling, z = 2."""
    walls = [((0.0, 0, 0), (0.0, 0, 2)), ((0.0, 3, 0), (0.0, 3, 2)), ((0.0, 0, 0), (0.0, 3, 0))]
    ceiling = [((0.0, 0, 2), (0.0, 3, 2)), ((0.0, 3, 2), (3.0, 3, 2)), ((3.0, 0, 2), (3.0, 3, 2))]
    points, tangents = lines_of(*walls, *ceiling)
    points += SIGMA / 2 * np.random.default_rng(seed).normal(size=points.shape)
    evidence = evidence_of(points, tangents, np.ones(len(points)))
    return find_planes(evidence, centers, np.random.default_rng(seed))


def walls_across_x(planes):
    """Where planes of which x is the normal are, ascending."""
    across = np.abs(planes.normals[:, 0]) > 1 - 1e-3
    return np.sort(planes.offsets[across] * np.sign(planes.normals[across, 0]))


@pytest.mark.parametrize("seed", range(4))
def test_a_wall_is_known_by_its_line_with_the_ceiling(seed):
    found = walls_across_x(planes_of_ceiling(seed, CENTERS))
    assert found == pytest.approx([0, 3], abs=SIGMA)
    around = np.array([[1.0, 0.5, -100], [5.0, 0.5, -100]])  # a camera went through it
    assert walls_across_x(planes_of_ceiling(seed, around)) == pytest.approx([0], abs=SIGMA)


@pytest.mark.parametrize("seed", range(4))
def test_no_wall_stands_on_a_line_of_a_pattern(seed):
    """Tiles go on behind the line."""
    tiles = [((0.0, 3, 2), (3.0, 3, 2)), ((0.0, 0, 2), (3.0, 0, 2))]
    tiles += [((x, 0.0, 2.0), (x, 3.0, 2.0)) for x in (0.0, 1.0, 2.0, 3.0)]
    walls = [((0.0, 0, 0), (0.0, 0, 2)), ((0.0, 3, 0), (0.0, 3, 2)), ((0.0, 0, 0), (0.0, 3, 0))]
    points, tangents = lines_of(*tiles, *walls)
    points += SIGMA / 2 * np.random.default_rng(seed).normal(size=points.shape)
    evidence = evidence_of(points, tangents, np.ones(len(points)))
    found = walls_across_x(find_planes(evidence, CENTERS, np.random.default_rng(seed)))
    assert found == pytest.approx([0, 3], abs=SIGMA)


@pytest.mark.parametrize("seed", range(4))
def test_most_lines_of_a_slope_may_lie_on_a_wall(seed):
    """The slope of an attic is known by its line on a gable, and a part of that on a low wall.

    Cameras on both sides of it tell that it is not taken for a plane at which others end.
    """
    gable = [((0.0, 0, 0), (3.0, 0, 0)), ((0.0, 0, 0), (0.0, 0, 2)), ((0.0, 0, 2), (2.0, 0, 2))]
    low = [((3.0, 0, 0), (3.0, 3, 0)), ((3.0, 0, 0), (3.0, 0, 1)), ((3.0, 3, 0), (3.0, 3, 1))]
    lines = lines_of(*gable, *low, ((3.0, 0, 1), (2.0, 0, 2)))
    part = lines_of(((3.0, 0, 1), (3.0, 0.6, 1)), count=30)
    points, tangents = (np.concatenate(of) for of in zip(lines, part, strict=True))
    points += SIGMA / 2 * np.random.default_rng(seed).normal(size=points.shape)
    evidence = evidence_of(points, tangents, np.ones(len(points)))
    around = np.array([[1.0, 0.5, -100], [5.0, 0.5, 5]])
    planes = find_planes(evidence, around, np.random.default_rng(seed))
    slope = np.array([1.0, 0, 1]) / np.sqrt(2)
    assert error_of(planes, slope, 4 / np.sqrt(2)) < 0.1
