"""A plain room of rectangles, exact: no texture but its edges, and a door that stands open."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pycolmap
from curves import make_view

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations

SPACING = 0.04
DOOR = (1.5, 2.5, 2.0)  # from, to, height, in the wall y = 3
# Corner, two sides, gray: floor, ceiling, left, right, behind, the wall around the door, and what
# is behind it: a wall with a picture, the floor there.
RECTANGLES = [
    ((0, 0, 0), (4, 0, 0), (0, 6, 0), 90),
    ((0, 0, 2.5), (4, 0, 0), (0, 6, 0), 200),
    ((0, 0, 0), (0, 6, 0), (0, 0, 2.5), 150),
    ((4, 0, 0), (0, 6, 0), (0, 0, 2.5), 170),
    ((0, 0, 0), (4, 0, 0), (0, 0, 2.5), 130),
    ((0, 3, 0), (1.5, 0, 0), (0, 0, 2.5), 120),
    ((2.5, 3, 0), (1.5, 0, 0), (0, 0, 2.5), 120),
    ((1.5, 3, 2), (1, 0, 0), (0, 0, 0.5), 120),
    ((0, 6, 0), (4, 0, 0), (0, 0, 2.5), 180),
    ((1.3, 5.99, 0.7), (1.4, 0, 0), (0, 0, 0.8), 60),
]
# Of the room, the door, the picture and the floor behind.
LINES = [
    *(((0, y, z), (4, y, z)) for y in (0, 3) for z in (0, 2.5)),
    *(((x, 0, z), (x, 3, z)) for x in (0, 4) for z in (0, 2.5)),
    *(((x, y, 0), (x, y, 2.5)) for x in (0, 4) for y in (0, 3)),
    ((1.5, 3, 0), (1.5, 3, 2)),
    ((2.5, 3, 0), (2.5, 3, 2)),
    ((1.5, 3, 2), (2.5, 3, 2)),
    *(((1.3, 5.99, z), (2.7, 5.99, z)) for z in (0.7, 1.5)),
    *(((x, 5.99, 0.7), (x, 5.99, 1.5)) for x in (1.3, 2.7)),
    ((0.5, 6, 0), (3.5, 6, 0)),
]


def room_views():
    """Views from inside the room, all around."""
    camera = pycolmap.Camera(model="PINHOLE", width=160, height=120, params=[90, 90, 80, 60])
    views = []
    for i in range(24):
        angle = 2 * np.pi * (i // 2) / 12
        center = np.array([2 + 0.7 * np.cos(3 * angle), 1.3 + 0.6 * np.sin(2 * angle), 1.2])
        center += (0.25 * (i % 2), 0.1, 0.2 * (i % 2))
        forward = (np.sin(angle), np.cos(angle), 0.15 * (-1) ** (i // 2))
        views.append(upright_view(i, camera, center, forward))
    return tuple(views)


def upright_view(index, camera, center, forward):
    """A view from a centre in a direction, upright: z is up."""
    forward = np.array(forward) / np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    return make_view(rotation, -rotation @ center, index, camera)


def cast(center, directions):
    """How far (N, 3) directions go until a rectangle, in their lengths, and its gray."""
    nearest, gray = np.full(len(directions), np.inf), np.zeros(len(directions))
    for corner, one, other, shade in RECTANGLES:
        corner, one, other = (np.array(x, float) for x in (corner, one, other))
        normal = np.cross(one, other)
        slopes = directions @ normal
        slopes[np.abs(slopes) < 1e-12] = 1e-12
        far = ((corner - center) @ normal) / slopes
        at = center + far[:, None] * directions - corner
        u, v = at @ one / (one @ one), at @ other / (other @ other)
        hit = (far > 1e-9) & (far < nearest) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        nearest[hit], gray[hit] = far[hit], shade
    return nearest, gray


def render(view, cast=cast):
    """The image (H, W, 3) of a view, in which `cast` gives the gray along directions."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    _, gray = cast(view.center, view.rays(np.column_stack([x.ravel(), y.ravel()])))
    gray = gray.reshape(view.height, view.width).astype(np.uint8)
    return np.repeat(gray[..., None], 3, axis=2)


def room_edges(views):
    """The edges of the room that at least three views see."""
    points, offsets, rows, tracks = [], [0], [], [0]
    for start, end in LINES:
        start, end = np.array(start, float), np.array(end, float)
        count = int(np.linalg.norm(end - start) / SPACING)
        at = start + np.linspace(0, 1, count)[:, None] * (end - start)
        sees = np.array([sees_points(view, at) for view in views])
        kept = sees.sum(axis=0) >= 3
        points.append(at[kept])
        offsets.append(offsets[-1] + kept.sum())
        for column in np.flatnonzero(kept):
            rows.append(np.flatnonzero(sees[:, column]))
            tracks.append(tracks[-1] + len(rows[-1]))
    at = np.concatenate(points)
    seen_by = np.concatenate(rows).astype(np.int32)
    observations = Observations.of_pixels(
        np.array(tracks, np.int64), seen_by, np.zeros((len(seen_by), 2))
    )
    return Edges3D.of_polylines(at, np.diff(offsets), observations)


def sees_points(view, points):
    """(N,) whether a view sees (N, 3) points."""
    pixels, depths = view.project(points)
    far, _ = cast(view.center, points - view.center)
    return view.holds(pixels, depths) & (far > 0.99)


def model_of(views):
    """A model without SfM points, as far as faces need it."""
    return SimpleNamespace(
        views=views,
        points3D_xyz=np.zeros((0, 3)),
        track_offsets=np.zeros(1, np.int64),
        track_views=np.zeros(0, np.int32),
        track_points2D=np.zeros((0, 2)),
        camera_centers=np.array([view.center for view in views]),
    )


def distance_to_room(points):
    """(N,) distances of points from the nearest rectangle."""
    nearest = np.full(len(points), np.inf)
    for corner, one, other, _ in RECTANGLES:
        corner, one, other = (np.array(x, float) for x in (corner, one, other))
        u = np.clip((points - corner) @ one / (one @ one), 0, 1)
        v = np.clip((points - corner) @ other / (other @ other), 0, 1)
        on = corner + u[:, None] * one + v[:, None] * other
        nearest = np.minimum(nearest, np.linalg.norm(points - on, axis=1))
    return nearest
