"""Edges of an overexposed face are edges: they are displaced, but do not move with the view."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import EDGES_ALONE

pytest.importorskip("manifold3d", reason="the scene is made with manifold3d")

from zoo.camera import Grid, Place, Rig, look_at, pinhole
from zoo.geometry import Body, unite
from zoo.light import LampLit, Light, Stage, illuminate, plain
from zoo.materials import Material
from zoo.points import posed_model
from zoo.render import Sensor, see, write_image
from zoo.solids import box

import colmap_edges
from colmap_edges.evaluation.metrics import clouds

SIDES = np.array([1.0, 0.7, 0.5])
THRESHOLD = 0.005 * SIDES.max()
SPACING = THRESHOLD / 5


class Bright(LampLit):
    """Rays are hardly clipped, so that light bleeds over its borders and displaces them."""

    max_light = 4.0


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


def write_box(folder, kind, num_views, blur_px):
    """Write images of a box before black in light that is too bright for its top, and poses."""
    x, y, z = SIDES
    stage = Stage(
        bodies=[Body("box", "gray", box((-x / 2, x / 2), (-y / 2, y / 2), (0, z)))],
        materials={"gray": Material(albedo=(0.6, 0.6, 0.6))},
        light=Light(position=np.array([6.0, -10, 30]), radius=2.0, strength=2.0, ambient=0.2),
        place=Place(middle=np.array([0, 0, z / 2]), extent=0.7),
        background=plain((0, 0, 0)),
    )
    camera = pinhole((400, 300), 500.0)
    heights = 0.1 + 0.85 * np.arange(num_views) / num_views
    views = [
        look_at(f"{i:02d}.png", 2.6, 137.5 * i, np.degrees(np.arcsin(height)), (0, 0, z / 2), 0)
        for i, height in enumerate(heights)
    ]
    for part in ("images", "sparse"):
        (folder / part).mkdir()
    posed_model(Rig(camera, views)).write(folder / "sparse")
    lit = kind(**illuminate(stage, unite(stage.bodies), camera).__dict__)
    random, sensor = np.random.default_rng(0), Sensor(blur_px=blur_px, noise=0.5, quality=0)
    white = []
    for view in views:
        light = see(lit, view, Grid.of(camera))
        gray = write_image(folder / "images" / view.name, light, sensor, random)
        white.append((gray == 255).mean())
    assert np.mean(white) > 0.01  # the top


def shares(true, found):
    """(S,) share of each segment (S, 2, 3) near found points, without what ends at its corners."""
    inner = [
        points[len(points) // 20 : -len(points) // 20] for points in map(sampled, true[:, None])
    ]
    if not len(found):
        return np.zeros(len(true))
    return np.array([(clouds.cloud_to_cloud(at, found) < THRESHOLD).mean() for at in inner])


# Glare makes second edges in images; the last value is the largest share of an edge beside which
# such a contour may be.
@pytest.mark.parametrize(
    ("kind", "num_views", "blur_px", "doubled"),
    [(LampLit, 14, 0.5, 0.0), (Bright, 20, 0.65, 0.4)],
    ids=["white", "glare"],
)
def test_edges_of_an_overexposed_face_are_no_contours(tmp_path, kind, num_views, blur_px, doubled):
    write_box(tmp_path, kind, num_views, blur_px)
    found = colmap_edges.reconstruct(tmp_path / "sparse", tmp_path / "images", EDGES_ALONE)
    true = edges_of_box()
    edges, every = points_of(found.edges), sampled(true)
    to_true, to_found = (clouds.cloud_to_cloud(*p) for p in ((edges, every), (every, edges)))
    assert clouds.scores(to_true, to_found, [THRESHOLD])[0]["f_score"] >= 0.95
    top = true[(true[..., 2] == SIDES[2]).all(axis=1)]
    assert len(top) == 4
    assert shares(top, edges).min() > 0.9
    assert shares(top, points_of(found.contours)).max() <= doubled
