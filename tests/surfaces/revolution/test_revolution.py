"""Bodies of revolution are found from their outlines, told from edges, and written as CAD faces."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from evidence import evidence_of, points_behind
from plain_rooms import model_of
from round_scenes import noisy_graph, views_around
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.similarity import Similarity
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.export.faces import read_faces, write_faces
from colmap_edges.surfaces.faces.evidence import gather_evidence
from colmap_edges.surfaces.outlines2d import find_outlines
from colmap_edges.surfaces.revolution.finding import find_bodies
from colmap_edges.surfaces.revolution.primitives import parts_of
from colmap_edges.surfaces.round_face import RoundFace, moved_round

CENTER = np.array([0.1, -0.2, 0.6])
AXIS = unit(np.array([0.3, -0.1, 1.0]))


def outlines_of(profile, view):
    """Both outlines (n, 3) of a body with (n, 4) places, radii and normals, in a view."""
    places, radii, slopes, rises = profile.T
    away = view.center - CENTER
    height = away @ AXIS
    across = away - height * AXIS
    reach = np.linalg.norm(across)
    toward, aside = across / reach, np.cross(AXIS, across / reach)
    cosines = (rises * radii + slopes * (places - height)) / (rises * reach)
    seen = np.abs(cosines) < 1
    sines = np.sqrt(1 - cosines[seen] ** 2)
    for sign in (1, -1):
        outwards = cosines[seen, None] * toward + sign * sines[:, None] * aside
        yield CENTER + places[seen, None] * AXIS + radii[seen, None] * outwards


def dense(curve):
    """(n, 2) points about a pixel apart along a curve through (k, 2) pixels."""
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    at = np.arange(0, arc[-1], 1.0)
    return np.column_stack([np.interp(at, arc, column) for column in curve.T])


def graph_of(view, curves, rng):
    """The edge graph of a view that shows (n, 3) curves."""
    return noisy_graph([dense(view.project_undistorted(curve)[0]) for curve in curves], rng)


def ball():
    """The profile of a ball of radius 0.5 about the centre."""
    angles = np.radians(np.linspace(-70, 70, 200))
    sines, cosines = np.sin(angles), np.cos(angles)
    return np.column_stack([0.5 * sines, 0.5 * cosines, sines, cosines])


def pebble():
    """The profile of a flat pebble of length 0.8 and radius 0.5 about the centre."""
    angles = np.radians(np.linspace(-80, 80, 200))
    sines, cosines = np.sin(angles), np.cos(angles)
    normals = unit(np.column_stack([sines / 0.4, cosines / 0.5]))
    return np.column_stack([0.4 * sines, 0.5 * cosines, normals])


def vase():
    """The profile of a vase with a waist."""
    places = np.linspace(-0.6, 0.6, 300)
    radii = 0.32 + 0.08 * np.cos(6 * places)
    normals = unit(np.column_stack([0.48 * np.sin(6 * places), np.ones(300)]))
    return np.column_stack([places, radii, normals])


def cone():
    """The profile of a part of a cone."""
    places = np.linspace(-0.5, 0.5, 300)
    normals = unit(np.column_stack([np.full(300, 0.3), np.ones(300)]))
    return np.column_stack([places, 0.35 - 0.3 * places, normals])


def scene_of(curves_in):
    """Views that show curves, and the samples of these."""
    views, rng = views_around(CENTER, 0.6), np.random.default_rng(0)
    graphs = Graphs.of([graph_of(view, list(curves_in(view)), rng) for view in views])
    samples = find_outlines(views, graphs, Edges3D.none(), 1).samples
    return SimpleNamespace(views=views, model=model_of(views), samples=samples)


def found_in(scene, known=(), samples=None, evidence=None):
    evidence = evidence or gather_evidence(scene.model, Edges3D.none())
    samples = samples or scene.samples
    return find_bodies(samples, Curves3D.none(), scene.views, evidence, known, 0)


def radii_of(points, axis=AXIS):
    """(N,) distances of (N, 3) points from the true axis, and (N,) places along it."""
    away = points - CENTER
    return np.linalg.norm(np.cross(away, axis), axis=1), away @ axis


@pytest.fixture(scope="module")
def waisted():
    return scene_of(lambda view: outlines_of(vase(), view))


def test_a_vase_is_found_from_its_outlines(waisted):
    found = found_in(waisted)
    assert {face.kind for face in found.faces} <= {"revolution", "torus", "cone"}
    for face in found.faces:
        assert abs(face.direction @ AXIS) == pytest.approx(1, abs=1e-4)
        assert face.views.tolist() == list(range(len(waisted.views)))
    radii, places = radii_of(found.points.points)
    assert np.ptp(places) > 0.85 * 1.2
    assert radii == pytest.approx(np.interp(places, vase()[:, 0], vase()[:, 1]), abs=4e-3)


def test_its_points_are_seen_from_outside(waisted):
    seen = found_in(waisted).points
    owners = np.repeat(np.arange(len(seen.points)), np.diff(seen.track_offsets))
    centers = np.array([view.center for view in waisted.views])[seen.track_views]
    outwards = seen.points - CENTER
    outwards -= (outwards @ AXIS)[:, None] * AXIS
    facing = np.einsum("ij,ij->i", centers - seen.points[owners], outwards[owners])
    assert len(seen.points) > 300
    assert np.mean(facing > 0) > 0.99  # on the slopes a view may see it from above the axis


@pytest.fixture(scope="module")
def rounded():
    return scene_of(lambda view: outlines_of(pebble(), view))


def test_a_ball_gets_its_top():
    found = found_in(scene_of(lambda view: outlines_of(ball(), view)))
    assert {face.kind for face in found.faces} == {"sphere"}
    away = np.linalg.norm(found.points.points - CENTER, axis=1)
    assert away == pytest.approx(0.5, abs=4e-3)
    # No outline shows the top, which all views see.
    assert (found.points.points[:, 2] - CENTER[2]).max() > 0.495


def top_of(found):
    """The highest place of a body's points along the axis."""
    return radii_of(found.points.points)[1].max()


def rings_around(views, is_edge):
    """Edge points around the end of a pebble's outlines, seen as edges on it or as outlines."""
    turns, heights = np.meshgrid(np.arange(0, 2 * np.pi, 0.05), np.radians(np.arange(40, 66, 3)))
    aside = np.linalg.svd(AXIS[None])[2][1:]
    away = (np.stack([np.cos(turns), np.sin(turns)], axis=-1) @ aside).reshape(-1, 3)
    cosines, sines = np.cos(heights.ravel())[:, None], np.sin(heights.ravel())[:, None]
    points = CENTER + 0.5 * cosines * away + 0.4 * sines * AXIS
    normals = unit(cosines / 0.5 * away + sines / 0.4 * AXIS)
    toward = unit(np.array([view.center for view in views]) - points[:, None])
    facing = np.einsum("pvj,pj->pv", toward, normals)
    seen = facing > 0 if is_edge else np.abs(facing) < 0.05
    given = evidence_of(points, offsets_of(seen.sum(axis=1)), np.nonzero(seen)[1], 1e-3)
    return replace(given, edge_ids=np.repeat(np.arange(len(heights)), turns.shape[1]))


def test_edges_around_its_end_are_a_rim_unless_they_are_outlines(rounded):
    edges, outlines = (rings_around(rounded.views, is_edge) for is_edge in (True, False))
    assert top_of(found_in(rounded, evidence=edges)) < 0.38
    assert top_of(found_in(rounded, evidence=outlines)) > 0.39


def test_rays_that_graze_its_top_leave_it_closed(rounded):
    behind = []
    for view in rounded.views:
        tangent = np.concatenate(list(outlines_of(pebble(), view)))
        tangent = tangent[(tangent - CENTER) @ AXIS > 0.25]
        behind.append(points_behind([view], CENTER + 0.96 * (tangent - CENTER)).points)
    views = np.repeat(np.arange(len(behind), dtype=np.int32), [len(points) for points in behind])
    points = np.concatenate(behind)
    evidence = evidence_of(points, np.arange(len(points) + 1), views, 1e-3)
    assert top_of(found_in(rounded, evidence=evidence)) > 0.39


def test_a_small_ball_among_many_curves_is_found():
    def curves_in(view):
        rng = np.random.default_rng(view.image_id)
        bows = np.linspace(-0.5, 0.5, 100)
        for _ in range(60):
            start, along, across = rng.uniform(-1, 1, (3, 3))
            yield CENTER + 1.5 * start + bows[:, None] * along + (bows**2)[:, None] * across
        yield from outlines_of(0.3 * ball() + [0, 0, 0.7, 0.7] * ball(), view)

    found = found_in(scene_of(curves_in))
    away = np.linalg.norm(found.points.points - CENTER, axis=1)
    assert len(away) > 100
    assert away == pytest.approx(0.15, abs=4e-3)


def test_a_cone_is_one():
    found = found_in(scene_of(lambda view: outlines_of(cone(), view)))
    (face,) = found.faces
    assert face.kind == "cone"
    slope = np.diff(face.profile[:, 1])[0] / np.diff(face.profile[:, 0])[0]
    assert slope * (face.direction @ AXIS) == pytest.approx(-0.3, abs=0.01)


def test_fixed_edges_are_no_outlines(waisted):
    fixed = replace(waisted.samples, fixed=np.ones(len(waisted.samples.views), bool))
    assert found_in(waisted, samples=fixed).faces == []
    none = waisted.samples.select(np.zeros(0, np.int64))
    assert len(found_in(waisted, samples=none).points.points) == 0


def test_a_circle_is_no_body():
    turns = np.linspace(0, 2 * np.pi, 400)
    aside = np.linalg.svd(AXIS[None])[2][1:]
    ring = CENTER + 0.5 * np.column_stack([np.cos(turns), np.sin(turns)]) @ aside
    assert found_in(scene_of(lambda _view: [ring])).faces == []


def test_rays_through_the_body_refuse_it(waisted):
    middle = CENTER + np.linspace(-0.3, 0.3, 50)[:, None] * AXIS
    assert found_in(waisted, evidence=points_behind(waisted.views, middle)).faces == []


def test_a_body_ends_where_rays_pass(waisted):
    middle = CENTER + np.linspace(0.35, 0.6, 25)[:, None] * AXIS
    found = found_in(waisted, evidence=points_behind(waisted.views, middle))
    _, places = radii_of(found.points.points)
    whole = radii_of(found_in(waisted).points.points)[1]
    assert places.min() == pytest.approx(whole.min(), abs=0.02)
    assert 0.0 < places.max() < 0.4 < whole.max()


def test_a_body_with_some_false_points_behind_it_lacks_the_points_next_to_their_rays(waisted):
    middle = CENTER + np.linspace(-0.5, 0.5, 8)[:, None] * AXIS
    found = found_in(waisted, evidence=points_behind(waisted.views, middle))
    whole = found_in(waisted)
    assert [face.kind for face in found.faces] == [face.kind for face in whole.faces]
    distances, nearest = cKDTree(whole.points.points).query(found.points.points)
    assert distances == pytest.approx(0, abs=1e-9)
    lacking = np.delete(whole.points.points, nearest, axis=0)
    assert 0 < len(lacking) < 0.25 * len(whole.points.points)


def test_kinds_of_the_parts_of_a_profile():
    straight = np.column_stack([np.arange(0, 120, 3.0), np.full(40, 50.0)])
    (cylinder,) = parts_of(straight, 0.3)
    assert cylinder[0] == "cylinder"
    assert cylinder[1] == pytest.approx(np.array([[0, 50], [117, 50]]))
    angles = np.radians(np.linspace(3, 80, 20))
    bend = np.column_stack([117 + 40 * np.sin(angles), 10 + 40 * np.cos(angles)])
    kinds = [kind for kind, _ in parts_of(np.concatenate([straight, bend]), 0.3)]
    assert kinds == ["cylinder", "torus"]
    wavy = np.column_stack([straight[:, 0], 50 + 5 * np.sin(straight[:, 0] / 10)])
    assert [kind for kind, _ in parts_of(wavy, 0.3)] == ["revolution"]


def faces_of_all_kinds():
    turns = np.radians([-40, 10, 60])
    places = np.linspace(0, 1, 8)
    profiles = {
        "cylinder": [[0, 1], [2, 1]],
        "cone": [[0, 1], [2, 0.5]],
        "sphere": np.column_stack([np.sin(turns), np.cos(turns)]),
        "torus": np.column_stack([np.sin(turns), 2 + np.cos(turns)]),
        "revolution": np.column_stack([places, 1 + 0.1 * np.sin(3 * places)]),
    }
    return [
        RoundFace(
            kind=kind,
            point=CENTER,
            direction=AXIS,
            profile=np.array(profile, np.float64),
            views=np.arange(2),
        )
        for kind, profile in profiles.items()
    ]


def test_round_faces_are_written_and_moved(waisted, tmp_path):
    path = tmp_path / "faces.json"
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = Similarity(scale=2.0, rotation=turn, translation=np.ones(3))
    faces = [moved_round(face, moved) for face in faces_of_all_kinds()]
    write_faces([], waisted.model, path, round_faces=faces)
    planar, again = read_faces(path, waisted.model)
    assert planar == []
    assert [face.kind for face in again] == [face.kind for face in faces]
    for face, read in zip(faces, again, strict=True):
        assert read.point == pytest.approx(turn @ CENTER * 2 + 1)
        assert read.direction == pytest.approx(turn @ AXIS)
        assert read.profile == pytest.approx(face.profile)
        assert read.views.tolist() == [0, 1]
    path.write_text('{"faces": []}')  # of versions without round faces
    assert read_faces(path, waisted.model) == ([], [])


def test_the_cad_kernel_reads_round_faces_as_what_they_are(tmp_path):
    pytest.importorskip("OCP", reason="STEP files are written by OpenCASCADE (extra step)")
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    from colmap_edges.export.step import write_step

    path = tmp_path / "edges.step"
    write_step(Curves3D.none(), path, round_faces=faces_of_all_kinds(), unit="m")
    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    places, surfaces = TopExp_Explorer(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_FACE), []
    while places.More():
        surfaces.append(BRepAdaptor_Surface(TopoDS.Face(places.Current())))
        places.Next()
    kinds = [surface.GetType().name.removeprefix("GeomAbs_") for surface in surfaces]
    assert kinds == ["Cylinder", "Cone", "Sphere", "Torus", "SurfaceOfRevolution"]
    assert surfaces[0].Cylinder().Radius() == pytest.approx(1000)
    assert surfaces[2].Sphere().Radius() == pytest.approx(1000)
    center = surfaces[2].Sphere().Location()
    assert (center.X(), center.Y(), center.Z()) == pytest.approx(tuple(1000 * CENTER))
    torus = surfaces[3].Torus()
    assert (torus.MajorRadius(), torus.MinorRadius()) == pytest.approx((2000, 1000))
    names = re.findall(r"'([a-z]+ \d)'", path.read_text())
    assert names == ["cylinder 1", "cone 2", "sphere 3", "torus 4", "revolution 5"]
