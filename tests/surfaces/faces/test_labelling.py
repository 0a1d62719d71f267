"""Which points lie on planes."""

import numpy as np

from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.faces.hypotheses import Planes
from colmap_edges.surfaces.faces.labelling import ON_TOLERANCE, planes_of_points

SIGMA = 0.01


def share_on_ground(*edges):
    """The share of each edge's points that lie on the plane z = 0."""
    counts = [len(edge) for edge in edges]
    points, total = np.concatenate(edges), sum(counts)
    evidence = Evidence(
        points=points,
        tangents=np.zeros((total, 3)),
        rays=np.tile([1.0, 0, 0], (total, 1)),
        sigmas=np.full(total, SIGMA),
        ray_sigmas=np.full(total, SIGMA),
        weights=np.ones(total),
        edge_ids=np.repeat(np.arange(len(edges)), counts),
        offsets=np.arange(total + 1),
        views=np.zeros(total, np.int32),
    )
    ground = Planes(normals=np.array([[0.0, 0, 1]]), offsets=np.zeros(1))
    offsets, planes = planes_of_points(evidence, ground)
    assert len(planes) == offsets[-1]
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return np.add.reduceat(np.diff(offsets), starts) / counts


def test_edges_that_touch_or_cross_a_plane_do_not_lie_on_it():
    """A circle that stands on the ground, a line at a small slope, and a noisy line on it."""
    rng = np.random.default_rng(0)
    angles = np.linspace(0, 2 * np.pi, 300)
    circle = np.column_stack([np.sin(angles), 0 * angles, 1 - np.cos(angles)])
    along = np.linspace(-1, 1, 200)
    slope = np.column_stack([along, 0 * along, 0.1 * along])
    flat = np.column_stack([along, 0 * along, rng.normal(0, SIGMA / 3, 200)])
    assert share_on_ground(circle, slope, flat).tolist() == [0, 0, 1]


def test_outlines_lie_on_a_plane_that_is_slightly_tilted():
    """One within 0.9 standard deviations of it, and an edge that leaves it like a parabola."""
    angles = np.linspace(0, 2 * np.pi, 300)
    outline = np.column_stack([np.cos(angles), np.sin(angles), 0.9 * SIGMA * np.cos(angles)])
    along = np.linspace(0, 1, 200)
    leaving = np.column_stack([along, 0 * along, 10 * SIGMA * along**2])
    assert share_on_ground(outline, leaving).tolist() == [1, 0]


def test_single_points_lie_on_a_plane_within_the_tolerance():
    heights = SIGMA * ON_TOLERANCE * np.array([0.9, -0.9, 1.1])
    shares = [share_on_ground([[0.0, 0, height]])[0] for height in heights]
    assert shares == [1, 1, 0]
