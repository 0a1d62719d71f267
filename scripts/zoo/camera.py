"""The camera of a scene with its distortion, its views, and their paths."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zoo.geometry import Array, Random

Size = tuple[int, int]
PATHS = ("ring", "two_heights", "walk", "hand_held")
MODELS = ("PINHOLE", "SIMPLE_RADIAL", "OPENCV")


@dataclass(frozen=True, kw_only=True)
class View:
    """An image's name and pose (3, 4) in COLMAP's axes: x right, y down, z forward."""

    name: str
    cam_from_world: Array

    def centre(self) -> Array:
        """(3,) centre of projection in the world."""
        return -self.cam_from_world[:, :3].T @ self.cam_from_world[:, 3]

    def local(self, points: Array) -> Array:
        """Points (..., 3) of the world in the camera's frame."""
        return points @ self.cam_from_world[:, :3].T + self.cam_from_world[:, 3]

    def rays(self, at: Array) -> Array:
        """(N, 3) rays of unit depth through undistorted image coordinates (N, 2), in the world."""
        return np.column_stack([at, np.ones(len(at))]) @ self.cam_from_world[:, :3]

    def moved(self, scale: float, rotation: Array, translation: Array) -> View:
        """The view in the world that x_new = scale * rotation @ x + translation gives."""
        turned = self.cam_from_world[:, :3] @ rotation.T
        shifted = scale * self.cam_from_world[:, 3] - turned @ translation
        return replace(self, cam_from_world=np.column_stack([turned, shifted]))


@dataclass(frozen=True, kw_only=True)
class Place:
    """Places of cameras: around `middle`, or at `spots` that each look at a target."""

    middle: Array  # (3,) point that views look at
    extent: float  # radius around it that they show
    # Span of directions that they look from; 0 is the front, towards -y.
    azimuth_deg: tuple[float, float] = (0.0, 360.0)
    elevation_deg: tuple[float, float] = (10.0, 50.0)  # span of elevations
    # Positions and targets where there is no free circle around the scene.
    spots: list[tuple[Array, Array]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Undistorted image coordinates of pixel centres, and their steps to the next ones."""

    centers: Array  # (H * W, 2)
    across: Array  # (H * W, 2) change over a pixel to the right
    down: Array  # (H * W, 2) change over a pixel down
    shape: tuple[int, int]  # H, W

    @classmethod
    def of(cls, camera: pycolmap.Camera) -> Grid:
        """The grid of a camera, whose first pixel has its centre at (0.5, 0.5)."""
        shape = (camera.height, camera.width)
        rows, columns = np.indices(shape)
        pixels = np.column_stack([columns.ravel(), rows.ravel()]) + 0.5
        centers = np.asarray(camera.cam_from_img(pixels))
        down, across = np.gradient(centers.reshape(*shape, 2), axis=(0, 1))
        down, across = down.reshape(-1, 2), across.reshape(-1, 2)
        return cls(centers=centers, across=across, down=down, shape=shape)

    def within(self, chosen: np.ndarray, offsets: Array) -> Array:
        """(N * K, 2) coordinates of (K, 2) offsets from the centres of (N,) pixels."""
        steps = np.stack([self.across[chosen], self.down[chosen]], axis=1)
        return (self.centers[chosen][:, None] + offsets @ steps).reshape(-1, 2)


@dataclass(frozen=True)
class Rig:
    """A camera and the views that it takes."""

    camera: pycolmap.Camera
    views: list[View]


def pinhole(size: Size, focal: float) -> pycolmap.Camera:
    """A camera without distortion; pixels."""
    width, height = size
    parameters = [focal, focal, width / 2, height / 2]
    return pycolmap.Camera(
        camera_id=1, model="PINHOLE", width=width, height=height, params=parameters
    )


def draw_camera(random: Random, size: Size, wide: bool) -> pycolmap.Camera:
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


def look_at(
    name: str, distance: float, azimuth_deg: float, elevation_deg: float, target: Any, roll_deg: Any
) -> View:
    """The view from a point on a sphere about `target` (3,); azimuth 0 is the front."""
    azimuth, elevation, roll = np.radians([azimuth_deg, elevation_deg, roll_deg])
    back = direction(azimuth, elevation)
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    down = -np.cross(back, right)
    turned = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    rotation = np.vstack([*turned, -back])
    centre = np.asarray(target) + distance * back
    return View(name=name, cam_from_world=np.column_stack([rotation, -rotation @ centre]))


def direction(azimuth: Any, elevation: Any) -> Array:
    """(..., 3) unit vectors at angles (...,) in radians; azimuth 0 is the front, towards -y."""
    return np.stack(
        [np.cos(elevation) * np.sin(azimuth), -np.cos(elevation) * np.cos(azimuth),
         np.sin(elevation)], axis=-1,
    )  # fmt: skip


def looking(number: int, position: Any, target: Any, roll_deg: float) -> View:
    """A view from `position` (3,) towards `target` (3,)."""
    back = np.subtract(position, target)
    distance = float(np.linalg.norm(back))
    azimuth = np.degrees(np.arctan2(back[0], -back[1]))
    elevation = np.degrees(np.arcsin(back[2] / distance))
    return look_at(f"view{number:02d}.jpg", distance, azimuth, elevation, target, roll_deg)


def draw_views(
    random: Random, place: Place, camera: pycolmap.Camera, path: str, count: int
) -> list[View]:
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
        looking(i, position, target, float(random.normal(0, shake)))
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
    back = direction(np.radians(azimuth), np.radians(np.clip(elevation, bottom, top)))
    return list(zip(target + away[:, None] * back, target, strict=True))


def write_cameras(path: Path, rig: Rig) -> dict[str, Any]:
    """Write intrinsics and poses as JSON; returns the intrinsics."""
    camera = rig.camera
    size = {"width": camera.width, "height": camera.height}
    intrinsics = {"model": camera.model_name, **size, "params": camera.params.tolist()}
    poses = {view.name: view.cam_from_world.tolist() for view in rig.views}
    path.write_text(json.dumps({**intrinsics, "cam_from_world": poses}, indent=1) + "\n")
    return intrinsics
