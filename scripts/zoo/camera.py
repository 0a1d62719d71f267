"""The camera of a scene with its distortion, and the paths along which views are taken."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from demo_scene.cameras import TrueCamera
from rooms.plans import looking

from zoo.stage import Array, Place, Random

PATHS = ("ring", "two_heights", "walk", "hand_held")
MODELS = ("PINHOLE", "SIMPLE_RADIAL", "OPENCV")


def draw_camera(random: Random, size: tuple[int, int], wide: bool) -> pycolmap.Camera:
    """A camera of random model, focal length, principal point and distortion."""
    width, height = size
    focal = width * (random.uniform(0.62, 0.8) if wide else random.uniform(0.8, 1.6))
    middle = (np.array(size) / 2 + random.normal(0, 0.005 * width, 2)).tolist()
    model = MODELS[random.integers(len(MODELS))]
    k = random.uniform(-0.12, 0.06)
    tangential = random.normal(0, 5e-4, 2).tolist()
    parameters = {
        "PINHOLE": [focal, focal, *middle],
        "SIMPLE_RADIAL": [focal, *middle, k],
        "OPENCV": [focal, focal * random.uniform(0.998, 1.002), *middle, k, -0.3 * k, *tangential],
    }[model]
    return pycolmap.Camera(camera_id=1, model=model, width=width, height=height, params=parameters)


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Undistorted image coordinates (H * W, 2) of pixel centres, and their steps to the next ones.

    Attributes:
        centers: (H * W, 2).
        across: (H * W, 2) change over a pixel to the right.
        down: (H * W, 2) change over a pixel down.
    """

    centers: Array
    across: Array
    down: Array

    @classmethod
    def of(cls, camera: pycolmap.Camera) -> Grid:
        """The grid of a camera, whose first pixel has its centre at (0.5, 0.5)."""
        shape = (camera.height, camera.width)
        rows, columns = np.indices(shape)
        pixels = np.column_stack([columns.ravel(), rows.ravel()]) + 0.5
        centers = np.asarray(camera.cam_from_img(pixels))
        down, across = np.gradient(centers.reshape(*shape, 2), axis=(0, 1))
        return cls(centers=centers, across=across.reshape(-1, 2), down=down.reshape(-1, 2))

    def within(self, chosen: np.ndarray, offsets: Array) -> Array:
        """(N * K, 2) coordinates of (K, 2) offsets from the centres of (N,) pixels."""
        steps = np.stack([self.across[chosen], self.down[chosen]], axis=1)
        return (self.centers[chosen][:, None] + offsets @ steps).reshape(-1, 2)


def draw_views(
    random: Random, place: Place, camera: pycolmap.Camera, path: str, count: int
) -> list[TrueCamera]:
    """Views along a path; their names end in .jpg."""
    if place.spots:
        chosen = np.sort(random.choice(len(place.spots), count, len(place.spots) < count))
        poses = [place.spots[i] for i in chosen]
    else:
        half = min(camera.width / camera.focal_length_x, camera.height / camera.focal_length_y) / 2
        distance = place.extent / np.sin(np.arctan(half)) * random.uniform(0.8, 1.15)
        poses = on_path(random, place, distance, path, count)
    shake = 6.0 if path == "hand_held" else 1.0
    return [
        looking(i, tuple(position), tuple(target), float(random.normal(0, shake)))
        for i, (position, target) in enumerate(poses)
    ]


def on_path(
    random: Random, place: Place, distance: float, path: str, count: int
) -> list[tuple[Array, Array]]:
    """Positions and targets around a place."""
    low, high = place.azimuth_deg
    full = high - low >= 360
    azimuth = np.linspace(low, high, count, endpoint=not full) + random.uniform(0, 360) * full
    bottom, top = place.elevation_deg
    elevation = np.full(count, random.uniform(bottom, top))
    away, target = np.full(count, distance), np.tile(place.middle, (count, 1))
    if path == "two_heights":
        elevation = np.where(np.arange(count) % 2, bottom, top) + random.uniform(0, 0.2, count)
    elif path == "walk":
        away *= 1 + 0.2 * np.cos(np.linspace(0, 4, count) + random.uniform(0, 6))
        elevation += (top - bottom) / 4 * np.sin(np.linspace(0, 3, count))
    elif path == "hand_held":
        azimuth += random.normal(0, 0.15 * (high - low) / count, count)
        elevation = random.uniform(bottom, top, count)
        away *= random.uniform(0.85, 1.1, count)
        target += random.normal(0, 0.06 * place.extent, (count, 3))
    azimuth, elevation = np.radians(azimuth), np.radians(np.clip(elevation, bottom, top))
    back = np.column_stack(
        [np.cos(elevation) * np.sin(azimuth), -np.cos(elevation) * np.cos(azimuth),
         np.sin(elevation)]
    )  # fmt: skip
    return list(zip(target + away[:, None] * back, target, strict=True))


def moved(view: TrueCamera, scale: float, rotation: Array, translation: Array) -> TrueCamera:
    """The view in the world that x_new = scale * rotation @ x + translation gives."""
    turned = view.cam_from_world[:, :3] @ rotation.T
    shifted = scale * view.cam_from_world[:, 3] - turned @ translation
    return replace(view, cam_from_world=np.column_stack([turned, shifted]))
