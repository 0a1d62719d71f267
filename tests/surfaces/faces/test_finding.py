"""Faces of a plain room lie on its walls, and the open door stays open."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from curves import model_of
from plain_rooms import DOOR, distance_to_room, render, room_edges, room_views

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.export.faces import write_faces
from colmap_edges.images.background import BackgroundRays
from colmap_edges.options import MeshingOptions
from colmap_edges.surfaces.bodies import Body
from colmap_edges.surfaces.faces.evidence import gather_evidence
from colmap_edges.surfaces.faces.finding import NO_FACES, find_faces, label_scene
from colmap_edges.surfaces.faces.grids import cells_in, make_grid
from colmap_edges.surfaces.faces.hypotheses import find_planes
from colmap_edges.surfaces.faces.labelling import EvidenceWeights, split_by_view
from colmap_edges.surfaces.mesher import mesh_with_curves


@pytest.fixture(scope="module")
def room():
    views = room_views()
    grids = {i: make_grid(view, render(view)) for i, view in enumerate(views)}
    model, edges = model_of(views), room_edges(views)
    return SimpleNamespace(
        model=model, edges=edges, grids=grids, faces=find_faces(model, edges, grids, 0, 1)
    )


def points_on(faces):
    """The points on faces."""
    return faces.points.points


def test_points_lie_on_the_walls(room):
    points = points_on(room.faces)
    assert len(points) > 500
    off = distance_to_room(points)
    assert np.median(off) < 0.01
    assert np.mean(off < 0.03) > 0.97


def test_every_side_of_the_room_has_points(room):
    x, y, z = points_on(room.faces).T
    sides = [abs(z), abs(z - 2.5), abs(x), abs(x - 4), abs(y), abs(y - 3)]
    assert min(np.sum((side < 0.02) & (y < 3.1)) for side in sides) > 30


def test_no_point_bridges_the_door(room):
    x, y, z = points_on(room.faces).T
    margin = 0.3  # about five cells as they are seen from the middle of the room
    inside = (x > DOOR[0] + margin) & (x < DOOR[1] - margin) & (z > margin) & (z < DOOR[2] - margin)
    assert not (inside & (abs(y - 3) < 0.3)).any()
    assert (y > 5.9).any()


def test_points_are_seen_by_views_that_hold_them(room):
    seen = room.faces.points
    for point in range(0, len(points_on(room.faces)), 50):
        at = seen.points[point : point + 1]
        for view in seen.track_views[seen.track_offsets[point] : seen.track_offsets[point + 1]]:
            pixel, depth = room.model.views[view].project(at)
            assert depth[0] > 0
            assert (np.abs(pixel - (80, 60)) < (81, 61)).all()


def test_threads_and_views_without_images_change_nothing_else(room):
    again = find_faces(room.model, room.edges, room.grids, 0, 3)
    assert np.array_equal(again.points.points, room.faces.points.points)
    assert np.array_equal(again.points.track_views, room.faces.points.track_views)
    fewer = {i: grid for i, grid in room.grids.items() if i != 5}
    assert len(points_on(find_faces(room.model, room.edges, fewer, 0, 1))) > 400


def test_faint_lines_are_sought_on_accepted_labels(room):
    model, pictures = room.model, [room.grids[v] for v in range(len(room.model.views))]
    evidence = gather_evidence(model, room.edges)
    planes = find_planes(evidence, model.camera_centers, np.random.default_rng(0))
    found = label_scene(model, pictures, (), 1, evidence, planes, 1, EvidenceWeights())
    accepted = found.accepted_labels()
    assert sum(np.sum(labels >= 0) for labels in accepted) == len(found.accepted)
    own = found.samples.views[found.samples.offsets[:-1]]
    for v, labels in enumerate(split_by_view(found.labels, pictures)):
        rows = found.accepted[own[found.accepted] == v]
        cells = cells_in(model.views[v], pictures[v], found.samples.points[rows])
        assert np.array_equal(accepted[v][cells], found.samples.planes[rows])
        assert np.isin(accepted[v], [-1]).sum() == labels.size - len(rows)


def test_nothing_without_edges(room):
    found = find_faces(room.model, Edges3D.none(), room.grids, 0, 1)
    assert found.faces == []
    assert len(found.points.points) == 0


def test_faces_are_told_with_their_outlines(room, tmp_path):
    write_faces(room.faces.faces, room.model, tmp_path / "faces.json")
    told = json.loads((tmp_path / "faces.json").read_text())["faces"]
    assert len(told) == len(room.faces.faces) > 5
    floor = max((f for f in told if f["normal"][2] > 0.99), key=lambda f: f["area"])
    assert floor["offset"] == pytest.approx(0, abs=0.02)
    assert 8 < floor["area"] < 26  # 12 in the room, more through the door
    assert np.abs(np.array(floor["outline"])[:, 2]).max() < 0.02
    assert set(floor["image_ids"]) <= {view.image_id for view in room.model.views}
    for face, record in zip(room.faces.faces, told, strict=True):
        on = face.outline @ face.normal - face.offset
        assert np.abs(on).max() < 1e-9
        assert record["area"] > 0
        assert record["in_mesh"] is False


def test_no_point_lies_where_a_view_sees_the_background(room):
    bodies = [Body(room.model.views[0], np.zeros((12, 16), bool))]
    points = points_on(room.faces)
    assert not bodies[0].holds(points).all()
    found = points_on(find_faces(room.model, room.edges, room.grids, 0, 1, bodies))
    assert 100 < len(found) < len(points)
    assert bodies[0].holds(found).all()


def meshed(room, faces, background=None):
    """The room's mesh, with points on faces."""
    return mesh_with_curves(room.model, (room.edges, None), MeshingOptions(), 1, background, faces)


def test_a_mesh_follows_points_on_faces(room):
    without, given = meshed(room, NO_FACES), meshed(room, room.faces)
    assert len(given.vertices) > len(without.vertices) + 300
    assert np.median(distance_to_room(given.vertices)) < 0.01


def test_a_mesh_follows_points_on_faces_before_a_background_too(room):
    background = BackgroundRays(np.zeros(1, np.int32), room.model.views[0].rotation[2:])
    without = meshed(room, NO_FACES, background)
    given = meshed(room, room.faces, background)
    assert len(given.vertices) > len(without.vertices) + 300
    assert np.median(distance_to_room(given.vertices)) < 0.01
