"""Edges of an overexposed face are edges: they are displaced, but do not move with the view."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("manifold3d", reason="the scene is made with manifold3d")

from zoo.camera import Grid, Place, Rig, look_at, pinhole
from zoo.geometry import Body, unite
from zoo.light import Light, Stage, illuminate, plain
from zoo.materials import Material
from zoo.points import posed_model
from zoo.render import Sensor, see, write_image
from zoo.solids import box

import colmap_edges
from colmap_edges.evaluation.metrics import clouds

SIDES = np.array([1.0, 0.7, 0.5])
THRESHOLD = 0.005 * SIDES.max()
SPACING = THRESHOLD / 5
NUM_VIEWS = 16


def edges_of_box():
    """Ends (11, 2, 3) of the edges that are seen: all but that between the faces in the shade."""
    ends = []
    for axis in range(3):
        a, b = np.delete(np.arange(3), axis)
        for i, j in np.ndindex(2, 2):
            start = np.zeros(3)
            start[[a, b]] = (i, j) * SIDES[[a, b]]
            end = start.copy()
            end[axis] = SIDES[axis]
            if axis < 2 or (i, j) != (0, 1):
                ends.append((start, end))
    return np.array(ends) - (*SIDES[:2] / 2, 0)


def sampled(ends):
    """Points (N, 3) every `SPACING` on segments (S, 2, 3)."""
    counts = np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / SPACING).astype(int) + 1
    return np.concatenate([np.linspace(*pair, n) for pair, n in zip(ends, counts, strict=True)])


def points_of(edges):
    """Points on all segments of `Edges3D`."""
    ends = [
        np.stack([points[:-1], points[1:]], axis=1)
        for points in np.split(edges.points, edges.edge_offsets[1:-1])
    ]
    return sampled(np.concatenate(ends)) if len(edges.points) else np.empty((0, 3))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Folder of a box before black, in light that is too bright for its top; without points."""
    x, y, z = SIDES
    solid = box((-x / 2, x / 2), (-y / 2, y / 2), (0, z))
    lamp = 20 * np.array([0.3, -0.5, 1.5])
    stage = Stage(
        bodies=[Body("box", "gray", solid)],
        materials={"gray": Material(albedo=(0.6, 0.6, 0.6))},
        light=Light(position=lamp, radius=2.0, strength=1.8, ambient=0.2),
        place=Place(middle=np.array([0, 0, z / 2]), extent=0.7),
        background=plain((0, 0, 0)),
    )
    camera = pinhole((400, 300), 500.0)
    views = [
        look_at(f"{i:02d}.png", 2.6, 360 * i / NUM_VIEWS, (20, 40)[i % 2], (0, 0, z / 2), 0)
        for i in range(NUM_VIEWS)
    ]
    folder = tmp_path_factory.mktemp("box")
    for part in ("images", "sparse"):
        (folder / part).mkdir()
    posed_model(Rig(camera, views)).write(folder / "sparse")
    lit, random = illuminate(stage, unite(stage.bodies), camera), np.random.default_rng(0)
    sensor = Sensor(blur_px=0.5, noise=0.5, quality=0)
    white = []
    for view in views:
        light = see(lit, view, Grid.of(camera))
        gray = write_image(folder / "images" / view.name, light, sensor, random)
        white.append((gray == 255).mean())
    assert np.mean(white) > 0.01  # the top
    return folder


def test_edges_of_an_overexposed_face_are_no_contours(scene):
    found = colmap_edges.reconstruct(scene / "sparse", scene / "images")
    true = edges_of_box()
    edges, every = points_of(found.edges), sampled(true)
    to_true, to_found = (clouds.cloud_to_cloud(*p) for p in ((edges, every), (every, edges)))
    score = clouds.scores(to_true, to_found, [THRESHOLD])[0]
    assert score.f_score >= 0.95
    for top in true[(true[..., 2] == SIDES[2]).all(axis=1)]:
        points = sampled(top[None])
        assert (clouds.cloud_to_cloud(points, edges) < THRESHOLD).mean() > 0.9
        contours = points_of(found.contours)
        assert not (clouds.cloud_to_cloud(points, contours) < THRESHOLD).any()
