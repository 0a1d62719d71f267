"""The true cameras of the demo scene."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT, FOCAL = 1024, 768, 1100.0  # pixels


@dataclass(frozen=True, kw_only=True)
class TrueCamera:
    """A pinhole view; `cam_from_world` (3, 4) in COLMAP's axes: x right, y down, z forward."""

    name: str
    cam_from_world: NDArray[np.float64]

    def centre(self) -> NDArray[np.float64]:
        """Return the centre of projection in the world, shape (3,)."""
        return -self.cam_from_world[:, :3].T @ self.cam_from_world[:, 3]


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """Size and focal length of the true pinhole cameras, pixels; `scale` 1 is full size."""

    scale: float = 1.0

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height, cut to whole pixels as Blender does."""
        return int(WIDTH * self.scale), int(HEIGHT * self.scale)

    @property
    def focal(self) -> float:
        """Return the focal length."""
        return FOCAL * self.size[0] / WIDTH

    @property
    def centre(self) -> tuple[float, float]:
        """Return the principal point."""
        return self.size[0] / 2, self.size[1] / 2


def make_cameras() -> list[TrueCamera]:
    """Return two arcs of views around the scene and a few closer, higher and tilted ones."""
    middle = (0.0, 0.0, 0.6)
    poses = [(12.3, azimuth, 17.0, middle, 0.0) for azimuth in np.linspace(-80, 80, 11)]
    poses += [(12.0, azimuth, 40.0, middle, 0.0) for azimuth in np.linspace(-70, 70, 8)]
    poses += [
        (8.0, -28.0, 26.0, (-1.5, 0.2, 0.7), 0.0),
        (8.0, 30.0, 30.0, (1.6, 0.0, 0.5), 0.0),
        (12.0, 5.0, 66.0, (0.0, 0.2, 0.0), 90.0),
        (11.5, -12.0, 9.0, middle, 12.0),
        (10.5, 48.0, 55.0, middle, -15.0),
    ]
    return [look_at(f"view{i:02d}.jpg", *pose) for i, pose in enumerate(poses)]


def look_at(
    name: str,
    distance: float,
    azimuth_deg: float,
    elevation_deg: float,
    target: tuple[float, float, float],
    roll_deg: float,
) -> TrueCamera:
    """Return the view from a point on a sphere about `target`; azimuth 0 is the front."""
    azimuth, elevation, roll = np.radians([azimuth_deg, elevation_deg, roll_deg])
    back = np.array(
        [
            np.cos(elevation) * np.sin(azimuth),
            -np.cos(elevation) * np.cos(azimuth),
            np.sin(elevation),
        ]
    )
    right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    down = -np.cross(back, right)
    turned = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    rotation = np.vstack([*turned, -back])
    centre = np.asarray(target) + distance * back
    return TrueCamera(name=name, cam_from_world=np.column_stack([rotation, -rotation @ centre]))


def write_cameras(path: Path, cameras: list[TrueCamera], intrinsics: Intrinsics) -> None:
    """Write intrinsics and poses as JSON."""
    data = {
        "model": "PINHOLE",
        "width": intrinsics.size[0],
        "height": intrinsics.size[1],
        "params": [intrinsics.focal, intrinsics.focal, *intrinsics.centre],
        "cam_from_world": {c.name: c.cam_from_world.tolist() for c in cameras},
    }
    path.write_text(json.dumps(data, indent=1) + "\n")
