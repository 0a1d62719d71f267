"""COLMAP models as arrays, for evaluation alone; gives way to `colmap_edges.model`."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.errors import ColmapEdgesError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class View:
    """One posed image; pixel coordinates are COLMAP's (first pixel's centre at 0.5, 0.5)."""

    name: str
    width: int
    height: int
    rotation: FloatArray
    translation: FloatArray
    camera: Any

    @property
    def center(self) -> FloatArray:
        """Centre of projection in the world, (3,)."""
        return -self.rotation.T @ self.translation

    @property
    def focal_px(self) -> float:
        """Mean focal length in pixels."""
        return float(self.camera.mean_focal_length())

    def depth(self, points: FloatArray) -> FloatArray:
        """Depths (N,) along the optical axis of world points (N, 3)."""
        return np.asarray(points @ self.rotation[2] + self.translation[2])

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (N, 2) of world points (N, 3); NaN behind the camera."""
        in_camera = points @ self.rotation.T + self.translation
        pixels = np.full((len(points), 2), np.nan)
        ahead = in_camera[:, 2] > 0
        if ahead.any():
            pixels[ahead] = self.camera.img_from_cam(in_camera[ahead])
        return pixels

    def unproject(self, pixels: FloatArray) -> FloatArray:
        """Normalised image coordinates (N, 2) of pixels (N, 2)."""
        return np.asarray(self.camera.cam_from_img(pixels), dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class Model:
    """Views sorted by name, points sorted by id and their observations sorted by point.

    Attributes:
        views: The registered images.
        point_ids: (P,) COLMAP ids.
        points: (P, 3) positions.
        observation_points: (O,) index of the point of each observation.
        observation_views: (O,) index of its view.
        observation_pixels: (O, 2) where the view sees it.
    """

    views: tuple[View, ...]
    point_ids: IntArray
    points: FloatArray
    observation_points: IntArray
    observation_views: IntArray
    observation_pixels: FloatArray

    def select(self, keep: NDArray[np.bool_]) -> Model:
        """The model with only the points where `keep` (P,) is true."""
        kept = keep[self.observation_points]
        renumbered = np.cumsum(keep) - 1
        return Model(
            views=self.views,
            point_ids=self.point_ids[keep],
            points=self.points[keep],
            observation_points=renumbered[self.observation_points[kept]],
            observation_views=self.observation_views[kept],
            observation_pixels=self.observation_pixels[kept],
        )


def load_model(path: Path) -> Model:
    """Read the COLMAP model in folder `path`.

    Raises:
        ColmapEdgesError: The folder holds no readable model.
    """
    import pycolmap

    if not any((path / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
        raise ColmapEdgesError(f"{path} holds no cameras.bin or cameras.txt; give a COLMAP model")
    try:
        reconstruction = pycolmap.Reconstruction(path)
    except (ValueError, IndexError, RuntimeError) as error:
        raise ColmapEdgesError(f"{path} is not a readable COLMAP model: {error}") from error
    images = sorted(
        (image for image in reconstruction.images.values() if image.has_pose),
        key=lambda image: image.name,
    )
    ids = np.array(sorted(reconstruction.points3D), dtype=np.int64)
    points = np.array([reconstruction.points3D[i].xyz for i in ids.tolist()]).reshape(-1, 3)
    point, view, pixel = _observations(images, ids)
    return Model(
        views=tuple(_view(image) for image in images),
        point_ids=ids,
        points=points,
        observation_points=point,
        observation_views=view,
        observation_pixels=pixel,
    )


def _view(image: Any) -> View:
    pose = image.cam_from_world()
    return View(
        name=image.name,
        width=image.camera.width,
        height=image.camera.height,
        rotation=np.array(pose.rotation.matrix()),
        translation=np.array(pose.translation),
        camera=copy.copy(image.camera),  # the reconstruction owns the original
    )


def _observations(images: list[Any], ids: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    seen, views, pixels = [], [], []
    for index, image in enumerate(images):
        observed = image.get_observation_points2D()
        seen += [point.point3D_id for point in observed]
        views += [index] * len(observed)
        pixels += [point.xy for point in observed]
    point = np.searchsorted(ids, np.array(seen, dtype=np.int64))
    order = np.argsort(point, kind="stable")
    pixel = np.array(pixels, dtype=np.float64).reshape(-1, 2)
    return point[order], np.array(views, dtype=np.int64)[order], pixel[order]
