"""A textured, slanted plane seen by a row of pinhole views, with its model and pictures."""

from __future__ import annotations

import numpy as np
import pycolmap

from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.surfaces.faces.grids import make_grid

WIDTH, HEIGHT, FOCAL_PX = 160, 120, 150.0
NORMAL, OFFSET = np.array([0.25, -0.1, 1.0]), 4.0  # NORMAL . X = OFFSET


def texture(points, rng):
    """Gray of (N, 2) places: waves in many directions, finer than a window."""
    gray = np.full(len(points), 120.0)
    for _ in range(12):
        frequency = rng.uniform(15, 45) * np.array(
            [np.cos(angle := rng.uniform(0, np.pi)), np.sin(angle)]
        )
        gray += 18 * np.sin(points @ frequency + rng.uniform(0, 2 * np.pi))
    return np.clip(gray, 0, 255)


def depth_of(center, rays):
    """(N,) depths at which (N, 3) rays of depth 1 meet the plane."""
    return (OFFSET - center @ NORMAL) / (rays @ NORMAL)


def make(num_views=5):
    """The model with a few SfM points on the plane, and the pictures of its views."""
    reconstruction = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        camera_id=1,
        model="PINHOLE",
        width=WIDTH,
        height=HEIGHT,
        params=[FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2],
    )
    reconstruction.add_camera_with_trivial_rig(camera)
    rng = np.random.default_rng(1)
    at = np.column_stack([rng.uniform(-0.7, 0.7, (60, 2)), np.zeros(60)])
    at[:, 2] = (OFFSET - at[:, :2] @ NORMAL[:2]) / NORMAL[2]
    tracks = [[] for _ in at]
    for i in range(num_views):
        center = np.array([0.3 * (i - (num_views - 1) / 2), 0.05 * (-1) ** i, 0.0])
        pixels = FOCAL_PX * (at - center)[:, :2] / (at - center)[:, 2:]
        pixels += (WIDTH / 2, HEIGHT / 2)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.eye(3)), -center)
        image = pycolmap.Image(f"{i}.png", pixels, image_id=i + 1, camera_id=1)
        reconstruction.add_image_with_trivial_frame(image, pose)
        for point, track in enumerate(tracks):
            track.append(pycolmap.TrackElement(i + 1, point))
    for xyz, track in zip(at, tracks, strict=True):
        reconstruction.add_point3D(xyz, pycolmap.Track(track), np.zeros(3, np.uint8))
    model = model_from_reconstruction(reconstruction)
    return model, {
        v: make_grid(view, picture(view), num_columns=WIDTH // 4)
        for v, view in enumerate(model.views)
    }


def picture(view):
    """The image (H, W, 3) of a view, each pixel the mean of 3 by 3 rays."""
    steps = (np.arange(3 * WIDTH) + 0.5) / 3, (np.arange(3 * HEIGHT) + 0.5) / 3
    columns, rows = np.meshgrid(*steps)
    rays = view.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    places = view.center + depth_of(view.center, rays)[:, None] * rays
    gray = texture(places[:, :2], np.random.default_rng(0))
    gray = gray.reshape(HEIGHT, 3, WIDTH, 3).mean(axis=(1, 3))
    return np.repeat(np.rint(gray)[:, :, None], 3, axis=2).astype(np.uint8)
