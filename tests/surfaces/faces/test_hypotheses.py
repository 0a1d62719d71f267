"""Planes through edges and points of walls."""

import numpy as np

from colmap_edges.surfaces.faces import hypotheses
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.hypotheses import find_planes

SIGMA = 0.004


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
        planes = find_planes(evidence, np.random.default_rng(seed))
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
        planes = find_planes(evidence, np.random.default_rng(seed))
        assert error_of(planes, slope[2], 0.0) < 2 * SIGMA
