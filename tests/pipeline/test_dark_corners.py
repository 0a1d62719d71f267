"""Degenerate camera configurations give true edges or none, and a mesh or a one-line error."""

from dataclasses import replace
from functools import cache

import curves as known
import numpy as np
import pycolmap
import pytest
import scenes
from scipy.spatial import cKDTree

from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.chains.tracing import trace_edges
from colmap_edges.edges3d.paper.tracing import trace_edges_paper
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.surfaces.mesher import mesh

OPTIONS = PipelineOptions(refine_poses=False, num_threads=1)
TRACERS = {"chains": trace_edges, "paper": trace_edges_paper}
CURVES = (
    known.circle((0, 0, 0), 0.8),
    known.circle((0.1, 0.1, 0.5), 0.4, (0, 1, 0), (0, 0, 1)),
    known.line((-1, -0.7, 0), (1.1, -0.6, 0.3)),
    known.line((-0.9, -0.8, -0.1), (-0.8, 0.9, 0.2)),
    known.line((0.9, -0.8, 0.4), (1.0, 0.8, -0.2)),
    known.line((-0.7, 0.1, -0.3), (0.6, 0.2, 0.6)),
)
PIXEL = 5 / known.FOCAL  # at the scene's distance


def ring_with(principal_points):
    """The ring with principal points (V, 2), which nothing but the images' frames feels."""
    views = []
    for i, view in enumerate(known.ring(9)):
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", known.FOCAL, 640, 480)
        camera.params = np.array([known.FOCAL, known.FOCAL, *principal_points[i]])
        views.append(replace(view, camera=camera))
    return tuple(views)


def copies(views, count):
    """Each view several times under other names."""
    names = [(v, f"{k}-{v.name}") for k in range(count) for v in views]
    return tuple(replace(v, name=n, image_id=i + 1) for i, (v, n) in enumerate(names))


def rolled_ring(rolls):
    return tuple(
        known.looking(view.center, roll=rolls[i % len(rolls)], index=i)
        for i, view in enumerate(known.ring(9))
    )


def along_the_axis(sideways):
    """Cameras on the way towards the scene, the epipoles inside the images."""
    centers = [(sideways * i * (-1) ** i, -6 + 0.4 * i, 0.8 + sideways * i) for i in range(8)]
    return tuple(known.looking(center, index=i) for i, center in enumerate(centers))


SOLVABLE = {
    "ring": known.ring(9),
    "collinear": known.row(8),
    "collinear, looking at one point": tuple(
        known.looking((-1.4 + 0.4 * i, -4, 2.5), index=i) for i in range(8)
    ),
    "some identical": copies(known.ring(5), 2),
    "upside down": rolled_ring([np.pi]),
    "strongly rolled": rolled_ring([0, 1.57, 3.1, 4.5, 2.2]),
    "mirrored principal points": ring_with([(420 - 200 * (i % 2), 100 + 30 * i) for i in range(9)]),
    "principal points outside": ring_with([(-300, 900)] * 9),
}
POOR = {
    "forward": along_the_axis(0.02),
    "forward, exactly": along_the_axis(0.0),
}
HOPELESS = {
    "pure rotation": tuple(known.looking((0, -4, 2.5), (0.2 * i, 0, 0), i) for i in range(5)),
    "two views": known.ring(2, arc_deg=20),
    "two identical views": copies(known.ring(1), 2),
    "identical views": copies(known.ring(1), 6),
}


def points_on_curves(count=40):
    rng = np.random.default_rng(0)
    return np.concatenate([curve(rng.random(count)) for curve in CURVES])


def trace(views, method, points=None):
    model = known.model_of(views, points_on_curves() if points is None else points)
    graphs = Graphs.of([known.graph_of(view, CURVES) for view in views])
    found, _ = TRACERS[method](model, graphs, OPTIONS)
    return model, found.edges


@cache
def traced_ring(method):
    """The usual ring's model and edges, and their mesh; they must not be changed."""
    model, edges = trace(SOLVABLE["ring"], method)
    return model, edges, mesh(model, edges)


def distances(edges):
    true = np.concatenate([curve(np.linspace(0, 1, 4000)) for curve in CURVES])
    return cKDTree(true).query(edges.points)[0]


def check_edges(edges):
    """Finite, and no edge goes round and round."""
    assert np.isfinite(edges.points).all()
    assert np.isfinite(edges.observations.pixels).all()
    lengths = [
        np.linalg.norm(np.diff(edges.points[a:b], axis=0), axis=1).sum()
        for a, b in zip(edges.edge_offsets[:-1], edges.edge_offsets[1:], strict=True)
    ]
    assert max(lengths, default=0) < 2 * np.pi * 0.8 * 1.1


@pytest.mark.parametrize("method", TRACERS)
@pytest.mark.parametrize("name", SOLVABLE)
def test_true_edges(name, method):
    model, edges = trace(SOLVABLE[name], method)
    check_edges(edges)
    assert edges.num_points > 100
    assert np.mean(distances(edges) < 2 * PIXEL) > 0.95
    assert len(mesh(model, edges).faces) > 500


@pytest.mark.parametrize("method", TRACERS)
@pytest.mark.parametrize("name", POOR)
def test_few_edges_but_none_far_off(name, method):
    model, edges = trace(POOR[name], method)
    check_edges(edges)
    assert edges.num_points == 0 or np.median(distances(edges)) < PIXEL / 4
    if method == "chains":  # what SfM points tell of depths takes nothing away
        _, alone = trace(POOR[name], method, np.zeros((0, 3)))
        assert edges.num_points > 0.9 * alone.num_points
        assert min(edges.num_points, alone.num_points) > 300
    assert len(mesh(model, edges).faces) > 200


@pytest.mark.parametrize("method", TRACERS)
@pytest.mark.parametrize("name", HOPELESS)
@pytest.mark.parametrize("with_points", [True, False])
def test_no_edges_without_parallax(name, method, with_points):
    points = None if with_points else np.zeros((0, 3))
    model, edges = trace(HOPELESS[name], method, points)
    assert edges.num_edges == edges.num_points == 0
    if with_points:
        assert len(mesh(model, edges).faces) > 200
    else:
        with pytest.raises(ColmapEdgesError, match="nothing to mesh"):
            mesh(model, edges)


@pytest.mark.parametrize("method", TRACERS)
def test_points_behind_cameras_change_no_truth(method):
    """Half of the points lie where no camera can see them though the tracks say so."""
    views = SOLVABLE["ring"]
    model, expected, _ = traced_ring(method)
    behind = points_on_curves()[::2] + 40 * np.mean([view.center for view in views], axis=0)
    assert all((view.cam_from_world(behind)[:, 2] < 0).all() for view in views)
    both = np.concatenate([model.points3D_xyz, behind])
    count, num_views = len(behind), len(views)
    model = replace(
        model,
        points3D_xyz=both,
        point3D_ids=np.arange(1, len(both) + 1),
        points3D_rgb=np.zeros((len(both), 3), np.uint8),
        track_offsets=np.arange(len(both) + 1) * num_views,
        track_views=np.tile(np.arange(num_views, dtype=np.int32), len(both)),
        track_points2D=np.concatenate(
            [model.track_points2D, np.full((count * num_views, 2), 200.0)]
        ),
    )
    graphs = Graphs.of([known.graph_of(view, CURVES) for view in views])
    edges = TRACERS[method](model, graphs, OPTIONS)[0].edges
    check_edges(edges)
    assert np.mean(distances(edges) < 2 * PIXEL) > 0.95
    assert edges.num_points > 0.5 * expected.num_points
    assert len(mesh(model, edges).faces) > 500


def similar(model, rotation, scale, offset):
    """The model after x -> scale rotation x + offset of the world."""
    views = []
    for view in model.views:
        turned = view.rotation @ rotation.T
        views.append(
            replace(view, rotation=turned, translation=scale * view.translation - turned @ offset)
        )
    points = scale * model.points3D_xyz @ rotation.T + offset
    return replace(model, views=tuple(views), points3D_xyz=points)


TURN, _ = scenes.look_at(np.array([1.0, 2, 3]), np.array([0.3, -1, 0.2]), 0.4)
SIMILARITIES = {
    "turned": (TURN, 1.0, (0, 0, 0)),
    "tiny": (np.eye(3), 1e-6, (0, 0, 0)),
    "huge": (TURN, 1e6, (0, 0, 0)),
    "UTM": (np.eye(3), 1.0, (5e5, 5.4e6, 300)),
    "turned UTM in millimetres": (TURN, 1e3, (5e8, 5.4e9, 3e5)),
}


@pytest.mark.parametrize("method", TRACERS)
@pytest.mark.parametrize("name", SIMILARITIES)
def test_results_go_with_the_world(name, method):
    """Edges are those of the model before, transformed; so is the mesh, up to rounding."""
    rotation, scale, offset = SIMILARITIES[name]
    views = SOLVABLE["ring"]
    model, expected, plain = traced_ring(method)
    moved = similar(model, rotation, scale, np.array(offset, float))
    graphs = Graphs.of([known.graph_of(view, CURVES) for view in views])
    edges = TRACERS[method](moved, graphs, OPTIONS)[0].edges
    back = (edges.points - offset) @ rotation / scale
    assert abs(edges.num_edges - expected.num_edges) <= 1
    assert edges.num_points == pytest.approx(expected.num_points, rel=0.01)
    nearest = cKDTree(expected.points).query(back)[0]
    assert np.mean(nearest < 1e-4 * PIXEL + 1e-9 * np.abs(offset).max() / scale) > 0.98
    there = mesh(moved, edges)
    assert len(there.faces) == pytest.approx(len(plain.faces), rel=0.03)
