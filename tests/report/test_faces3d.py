"""Triangulation of planar faces: areas, holes, planes and colours."""

import cv2
import numpy as np
import pytest

from colmap_edges.report.faces3d import MAX_SHOWN, closed_rings, color_of, largest, triangulated
from colmap_edges.surfaces.faces.outlines import Face

NORMAL = np.array([2, -1, 2]) / 3


def face_of(outline, holes=(), normal=NORMAL, offset=1.5, plane=0):
    """A face whose rings are given in two coordinates of its plane."""
    basis = np.linalg.svd(normal[None])[2][1:]
    placed = [np.array(ring, float) @ basis + offset * normal for ring in (outline, *holes)]
    area = shoelace(outline) - sum(map(shoelace, holes))
    return Face(
        normal=normal,
        offset=offset,
        area=area,
        outline=placed[0],
        holes=tuple(placed[1:]),
        views=np.arange(3),
        plane=plane,
    )


def shoelace(ring):
    x, y = np.array(ring, float).T
    return abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def area_of(corners, triangles):
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


SQUARE = [(0, 0), (4, 0), (4, 4), (0, 4)]
L_SHAPE = [(0, 0), (5, 0), (5, 1), (2, 1), (2, 4), (0, 4)]
HOLE = [(1, 1), (1, 2.5), (3, 3), (2, 1)]


@pytest.mark.parametrize(
    ("outline", "holes"),
    [(SQUARE, ()), (L_SHAPE, ()), (SQUARE, (HOLE,)), ([(0, 0), (3, 1), (1, 5)], ())],
)
def test_triangles_cover_exactly_the_face(outline, holes):
    face = face_of(outline, holes)
    corners, triangles, _ = triangulated([face])
    assert area_of(corners, triangles) == pytest.approx(face.area, rel=0.005)
    assert np.abs(corners @ face.normal - face.offset).max() < 1e-9
    flat = (corners - face.offset * face.normal) @ np.linalg.svd(face.normal[None])[2][1:].T
    ring = np.array(outline, np.float32)
    for middle in flat[triangles].mean(axis=1).astype(np.float32):
        assert cv2.pointPolygonTest(ring, middle.tolist(), True) > -0.01
        for hole in holes:
            assert cv2.pointPolygonTest(np.array(hole, np.float32), middle.tolist(), True) < 0.01


def test_staircases_of_a_raster_are_covered():
    """Outlines as they come: of cells, with pieces that touch at corners."""
    rng = np.random.default_rng(0)
    mask = cv2.resize((rng.random((9, 9)) > 0.4).astype(np.uint8), (45, 45), interpolation=0)
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    faces = [face_of(ring[:, 0].tolist()) for ring in found if len(ring) > 2]
    for face in faces:
        corners, triangles, _ = triangulated([face])
        assert area_of(corners, triangles) == pytest.approx(face.area, rel=0.02)


def test_faces_of_one_plane_have_one_colour():
    faces = [face_of(SQUARE, plane=plane) for plane in (3, 3, 4)]
    corners, triangles, colors = triangulated(faces)
    assert len(corners) == len(colors) == 4 * len(faces)
    assert triangles.max() == len(corners) - 1
    assert (colors[:8] == color_of(3)).all()
    assert np.abs(colors[8].astype(int) - color_of(3)).max() > 50


def test_the_largest_of_many_faces_are_shown():
    faces = [face_of(np.array(SQUARE) * (i + 1)) for i in range(MAX_SHOWN + 5)]
    assert largest(faces)[0] is faces[-1]
    assert len(largest(faces)) == MAX_SHOWN
    assert [len(part) for part in triangulated([])] == [0, 0, 0]


def test_rings_come_back_to_their_start():
    rings = closed_rings([face_of(SQUARE, (HOLE,))])
    assert [len(ring) for ring in rings] == [5, 5]
    assert all((ring[0] == ring[-1]).all() for ring in rings)
