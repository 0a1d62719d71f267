"""Images of a lit room: anti-aliased, slightly blurred, with sensor noise, as JPEG."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from demo_scene.cameras import TrueCamera
from numpy.typing import NDArray

from rooms.light import LitSurface
from rooms.materials import MATERIALS

RAYS = 3  # through a pixel at borders and on textures, along each of its sides
FOCAL = 430 / 640  # of the image's width: 73 degrees across
BLUR = 0.45  # pixels, of the lens
NOISE, SHOT = 0.5, 0.9  # gray levels: of the sensor, and of the light at white
SKY = 3.0  # light of directions without a surface
MIDDLE = 0.45  # light, of 1 at white, that the typical pixel is exposed to
TYPICAL = 60  # percentile of that pixel


@dataclass(frozen=True, kw_only=True)
class Pinhole:
    """A camera with its principal point in the middle; pixels."""

    width: int
    height: int

    @property
    def focal(self) -> float:
        """Focal length."""
        return FOCAL * self.width

    def rays(self, camera: TrueCamera, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 3) rays of unit depth through pixels (N, 2), in the world."""
        at = (pixels - (self.width / 2, self.height / 2)) / self.focal
        return np.column_stack([at, np.ones(len(at))]) @ camera.cam_from_world[:, :3]

    def centers(self, step: int = 1) -> NDArray[np.float64]:
        """Centres of every `step`th pixel, row by row."""
        rows, columns = np.indices((self.height, self.width))[:, ::step, ::step]
        return np.column_stack([columns.ravel(), rows.ravel()]) + 0.5


def write_images(
    surface: LitSurface, cameras: list[TrueCamera], pinhole: Pinhole, folder: Path, seed: int = 0
) -> None:
    """Render and write the images of the cameras."""
    folder.mkdir(parents=True, exist_ok=True)
    white = exposure(surface, cameras, pinhole)
    for number, camera in enumerate(cameras):
        random = np.random.default_rng([seed, number])
        light = cv2.GaussianBlur(see(surface, camera, pinhole, white), (0, 0), BLUR)
        gray = 255 * (1 - np.exp(-1.2 * light)) ** (1 / 2.2)
        gray += random.normal(size=gray.shape) * np.hypot(NOISE, SHOT * np.sqrt(gray / 255))
        pixels = np.clip(np.rint(gray), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / camera.name), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])


def exposure(surface: LitSurface, cameras: list[TrueCamera], pinhole: Pinhole) -> float:
    """Light that is exposed to `MIDDLE`; the same for all views, as with a locked exposure."""
    seen = []
    pixels = pinhole.centers(step=max(1, pinhole.width // 32))
    for camera in cameras:
        light, label = trace(surface, camera, pinhole, pixels, 1.0)
        seen.append(light[label >= 0].mean(axis=1))
    return float(np.percentile(np.concatenate(seen), TYPICAL) / MIDDLE)


def see(
    surface: LitSurface, camera: TrueCamera, pinhole: Pinhole, white: float
) -> NDArray[np.float64]:
    """(H, W, 3) light; several rays a pixel where neighbours differ or are textured."""
    pixels = pinhole.centers()
    light, label = trace(surface, camera, pinhole, pixels, white)
    shape = (pinhole.height, pinhole.width)
    shown = label.reshape(shape).astype(np.float32)
    window = np.ones((3, 3), np.uint8)
    fine = cv2.dilate(shown, window) != cv2.erode(shown, window)
    textured = np.array([MATERIALS[name].contrast > 0.1 for name in surface.materials])
    fine |= (textured[label % len(textured)] & (label >= 0)).reshape(shape)
    chosen = np.flatnonzero(fine)
    offsets = (np.indices((RAYS, RAYS)).reshape(2, -1).T + 0.5) / RAYS - 0.5
    inner = (pixels[chosen][:, None] + offsets).reshape(-1, 2)
    finer, _ = trace(surface, camera, pinhole, inner, white)
    # Each ray is clipped, as by a saturated sensor, so that lamps do not bleed over their borders.
    light[chosen] = np.minimum(finer, SKY).reshape(len(chosen), RAYS**2, 3).mean(axis=1)
    return light.reshape(*shape, 3)


def trace(
    surface: LitSurface,
    camera: TrueCamera,
    pinhole: Pinhole,
    pixels: NDArray[np.float64],
    white: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Light (N, 3) through pixels, and smooth face and body (N,) shown by them; -1: the sky."""
    rays = pinhole.rays(camera, pixels)
    starts = np.broadcast_to(camera.centre(), rays.shape)
    faces, distance = surface.caster.hits(starts, rays)
    hit = np.flatnonzero(faces >= 0)
    light = np.full((len(rays), 3), SKY)
    places = starts[hit] + distance[hit, None] * rays[hit]
    light[hit] = surface.radiance(faces[hit], places) / white
    light[hit] += surface.emission(faces[hit])[:, None]
    label = np.full(len(rays), -1, np.int64)
    bodies = len(surface.materials)
    label[hit] = surface.group[faces[hit]].astype(np.int64) * bodies + surface.face_body[faces[hit]]
    return light, label
