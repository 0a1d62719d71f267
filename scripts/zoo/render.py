"""Images of lit surfaces: ray casting, anti-aliasing, exposure, blur and noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np

from zoo.camera import Grid, Rig, View
from zoo.casting import Caster
from zoo.geometry import Array, Random, unit

TURN = np.cos(np.radians(10))  # between the normals of neighbouring pixels at a crease
STEP = 0.01  # relative, between the depths of neighbouring pixels at a border
GAMMA = 2.2


@dataclass(frozen=True, kw_only=True)
class Lit:
    """A surface with what decides its light; its kinds say how it looks."""

    caster: Caster  # its triangles
    corners: np.ndarray  # (F, 3) row of `vectors` of each corner of a triangle
    vectors: np.ndarray  # (K, D) what is interpolated over triangles
    # (F,) of each triangle; at borders between labels a pixel is the mean of many rays.
    labels: np.ndarray
    white: float = 1.0  # light that is shown as 255

    precision: ClassVar[type] = np.float64
    offsets: ClassVar[Array] = (np.indices((3, 3)).reshape(2, -1).T + 0.5) / 3 - 0.5  # in a pixel
    # Of each of many rays, so that lights do not bleed over their borders, and of a ray alone.
    max_light: ClassVar[float] = np.inf
    max_alone: ClassVar[float] = np.inf

    def shade(
        self, faces: np.ndarray, centre: Array, rays: np.ndarray, where: np.ndarray
    ) -> tuple[np.ndarray, Any]:
        """Light (N, C) that faces (N,) reflect along rays (N, 3); normals and distances (N, 4).

        Args:
            faces: (N,).
            centre: (3,) that the rays come from.
            rays: (N, 3).
            where: (N, 4) weights of the face's corners, and distances in rays.
        """
        raise NotImplementedError

    def background(self, rays: np.ndarray) -> Any:
        """(N, C) light of unit directions (N, 3) without a surface."""
        raise NotImplementedError

    def is_rough(self, labels: np.ndarray) -> Any:
        """(H, W) pixels that need many rays whatever their neighbours show."""
        return np.zeros(labels.shape, bool)

    def between(self, faces: np.ndarray, where: np.ndarray) -> np.ndarray:
        """(N, D) vectors interpolated."""
        rows = self.corners[faces]
        return np.asarray(sum(where[:, i, None] * self.vectors[rows[:, i]] for i in range(3)))


def trace(lit: Lit, view: View, at: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Light through image coordinates (N, 2): (N, C), labels (N,), -1: none, (N, 4) geometry.

    Geometry is the normal and the distance.
    """
    rays = view.rays(at).astype(lit.precision)
    hit, faces, where = lit.caster.seen(view.centre(), rays)
    label = np.full(len(rays), -1)
    label[hit] = lit.labels[faces]
    shown, seen = lit.shade(faces, view.centre(), rays[hit], where)
    light = np.empty((len(rays), shown.shape[1]), lit.precision)
    light[label < 0] = lit.background(unit(rays[label < 0]))
    light[hit] = shown
    geometry = np.zeros((len(rays), 4), np.float32)
    geometry[hit] = seen
    return light, label, geometry


def see(lit: Lit, view: View, grid: Grid) -> np.ndarray:
    """(H, W, C) light; many rays a pixel where neighbours show another face."""
    light, label, geometry = trace(lit, view, grid.centers)
    light, label = np.minimum(light, lit.max_alone), label.reshape(grid.shape)
    fine = borders(label, geometry.reshape(*grid.shape, 4)) | lit.is_rough(label)
    chosen = np.flatnonzero(fine)
    finer, _, _ = trace(lit, view, grid.within(chosen, lit.offsets))
    finer = np.minimum(finer, lit.max_light).reshape(len(chosen), len(lit.offsets), -1)
    light[chosen] = finer.mean(axis=1)
    return light.reshape(*grid.shape, -1)


def borders(label: np.ndarray, geometry: Array) -> np.ndarray:
    """(H, W) whether a pixel differs from one of its eight neighbours in what it shows.

    A straight border that crosses a pixel beside its centre leaves a neighbour on its other side.
    """
    found = np.zeros(label.shape, bool)
    after, before, every = np.s_[1:], np.s_[:-1], np.s_[:]
    pairs = (
        ((every, after), (every, before)),
        ((after, every), (before, every)),
        ((after, after), (before, before)),
        ((after, before), (before, after)),
    )
    for one, other in pairs:
        a, b = geometry[one], geometry[other]
        differs = np.einsum("ijk,ijk->ij", a[..., :3], b[..., :3]) < TURN
        differs |= np.abs(a[..., 3] - b[..., 3]) > STEP * np.minimum(a[..., 3], b[..., 3])
        differs &= (label[one] >= 0) | (label[other] >= 0)
        differs |= label[one] != label[other]
        found[one] |= differs
        found[other] |= differs
    return found


def typical_light(lit: Lit, rig: Rig, at: Array, percentile: float) -> float:
    """A percentile of the light of all bodies, seen through (N, 2) pixels of every view."""
    seen = []
    for view in rig.views:
        light, label, _ = trace(lit, view, at)
        seen.append(light[label >= 0].mean(axis=1))
    return float(np.percentile(np.concatenate(seen), percentile))


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """How light becomes a file."""

    gain: float = 1.0  # of this view, relative to the others
    blur_px: float = 0.0  # standard deviation of the lens's blur; 0: none
    noise: float  # standard deviation of the noise in dark places, gray levels
    shot_noise: float = 0.0  # the same of the part that grows with light, at white
    quality: int = 95  # of the JPEG; 0: PNG
    soft: bool = False  # bright light saturates slowly, as on film


def write_image(path: Path, light: np.ndarray, sensor: Sensor, random: Random) -> np.ndarray:
    """Blur, expose, add noise and write; returns the gray levels without noise, as `light`."""
    kind = light.dtype
    if sensor.blur_px:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px)
    light = light * sensor.gain
    shown = 1 - np.exp(-1.2 * light) if sensor.soft else np.clip(light, 0, 1)
    gray = 255 * shown ** (1 / GAMMA)
    deviation = np.hypot(sensor.noise, sensor.shot_noise * np.sqrt(gray / 255))
    noisy = gray + random.standard_normal(gray.shape, kind) * deviation
    pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, sensor.quality] if sensor.quality else []
    cv2.imwrite(str(path), pixels[..., ::-1], options)
    return gray
