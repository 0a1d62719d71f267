"""Points of curves lie on the faces that they are on within their noise."""

from dataclasses import replace

import numpy as np
import pytest
from curves import model_of, observed_edges, ring

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.surfaces.faces.evidence import gather_evidence
from colmap_edges.surfaces.faces.finding import NO_FACES
from colmap_edges.surfaces.faces.flattening import MOSTLY_ON_TOLERANCE, flattened, off_faces
from colmap_edges.surfaces.faces.labelling import ON_TOLERANCE
from colmap_edges.surfaces.faces.outlines import Face

SPACING = 0.1
VIEWS = ring(5)
MODEL = model_of(VIEWS)


@pytest.fixture
def ground():
    """A face in z = 0 for x and y from -1 to 1, with points."""
    side = np.arange(-1, 1 + SPACING / 2, SPACING)
    points = np.stack([*np.meshgrid(side, side), np.zeros((len(side), len(side)))], axis=-1)
    points = points.reshape(-1, 3)
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    up = np.array([0, 0, 1.0])
    face = Face(
        normal=up, offset=0.0, area=4.0, outline=corners, holes=(), views=np.arange(5), plane=0
    )
    offsets, views = np.arange(len(points) + 1), np.zeros(len(points), np.int32)
    return replace(
        NO_FACES,
        faces=[face],
        points=SeenPoints(points, offsets, views),
        face_ids=np.zeros(len(points), np.int64),
    )


def edge_at(heights, first=-0.8, last=0.8):
    """An edge above the ground, and along each of its points the height of a standard deviation."""
    x = np.linspace(first, last, len(heights))
    edge = observed_edges([np.column_stack([x, 0 * x + 0.04, heights])], range(5), sigmas=np.nan)
    evidence = gather_evidence(MODEL, edge)
    across = evidence.ray_sigmas * evidence.rays[:, 2]
    return edge, np.hypot(evidence.sigmas, across)


def test_points_within_their_noise_are_moved_along_their_rays(ground):
    _, deviation = edge_at(np.zeros(9))
    factors = np.array([0.0, 1, -1, 1.9, -1.9, 3.9, -3.9, 4.1, -6])
    edge, _ = edge_at(factors * deviation)
    found = flattened(edge, ground, MODEL)
    near = np.abs(factors) < MOSTLY_ON_TOLERANCE
    assert np.abs(found.points[near, 2]).max() < 1e-12
    assert np.array_equal(found.points[~near], edge.points[~near])
    moved = near & (factors != 0)
    steps = found.points[moved] - edge.points[moved]
    steps /= np.linalg.norm(steps, axis=1)[:, None]
    along = np.abs((steps * gather_evidence(MODEL, edge).rays[moved]).sum(axis=1))
    assert along.min() > 1 - 1e-9


def test_relief_stays(ground):
    """Most points of the edge are off the face by more than their noise, by 2.1 deviations."""
    _, deviation = edge_at(np.zeros(9))
    factors = np.array([1.9, 1.9, 1.9, 1.9, 2.1, 2.1, 2.1, 2.1, 2.1])
    edge, _ = edge_at(factors * deviation)
    found = flattened(edge, ground, MODEL)
    is_near = factors <= ON_TOLERANCE
    assert np.abs(found.points[is_near, 2]).max() < 1e-12
    assert np.array_equal(found.points[~is_near], edge.points[~is_near])


def test_points_beside_the_face_stay(ground):
    edge, _ = edge_at(np.full(9, 1e-4), first=1.5, last=2.5)
    assert np.array_equal(flattened(edge, ground, MODEL).points, edge.points)


def test_ends_at_a_node_stay_together(ground):
    edge, _ = edge_at(np.zeros(3))
    node = np.array([0.0, 0.04, 10 * gather_evidence(MODEL, edge).sigmas[1]])
    pieces = [np.array([node, [-0.5, 0.04, 0.4]]), np.array([node, [0.5, 0.3, 0.4]])]
    edges = observed_edges(pieces, range(5), sigmas=[1.0, 0.0])
    for first in (0, 1):  # the node lies on the face by the noise of one of the two only
        chosen = edges[[first, 1 - first]]
        found = flattened(chosen, ground, MODEL).points[[0, 2]]
        assert np.array_equal(found[0], found[1])
        assert (abs(found[0, 2]) < 1e-12) == (first == 0)


def test_contours_on_a_face_are_left_out(ground):
    on, beside, partly = (np.array([[x, 0.0, 0.02], [x + 1, 0, 0.02]]) for x in (-0.5, 2.0, 0.5))
    contours = observed_edges([on, beside, partly], range(5))
    assert np.array_equal(off_faces(contours, ground).points, np.concatenate([beside, partly]))
    assert off_faces(Edges3D.none(), ground).num_points == 0
    assert off_faces(contours, NO_FACES) is contours
