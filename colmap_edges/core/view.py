"""A posed image: its camera, its pose, and how points and pixels go between world and image."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, order_of


def lift(view: View, ideal: FloatArray, inverse_depths: FloatArray) -> FloatArray:
    """(N, 3) world points of (N, 2) ideal pixels at (N,) inverse depths."""
    rays = np.column_stack([ideal / view.focal_px, np.ones(len(ideal))])
    points: FloatArray = (rays / inverse_depths[:, None] - view.translation) @ view.rotation
    return points


PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
MAX_LENS_ERROR_PX = 0.1  # of a pixel that is undistorted and distorted again


@dataclass(frozen=True, kw_only=True)
class View:
    """One posed image: COLMAP's image, its camera and its pose.

    Pixels of a view come in two kinds: those of the image as it is (`points2D`, distorted,
    COLMAP's origin) and *ideal* ones: what a pinhole camera of focal length `focal_px` with the
    principal point at (0, 0) would see, of the image upsampled `scale` times. Geometry works in
    ideal pixels.
    """

    image_id: int
    name: str
    width: int
    height: int
    camera: Any  # pycolmap.Camera
    rotation: FloatArray  # (3, 3) of cam_from_world
    translation: FloatArray  # (3,) of cam_from_world
    scale: float = 1.0  # by which the image is enlarged, or below 1 reduced, for detection

    @cached_property
    def focal_px(self) -> float:
        """Mean focal length in pixels of the upsampled image."""
        return self.scale * float(self.camera.mean_focal_length())

    @cached_property
    def center(self) -> FloatArray:
        """(3,) projection centre in world coordinates."""
        center: FloatArray = -self.rotation.T @ self.translation
        return center

    def ideal_from_image(self, points2D: FloatArray) -> FloatArray:
        """Undistort (N, 2) image pixels to ideal pixels; NaN where the camera model cannot.

        That is where its distortion has no inverse, or looks more than 90 degrees aside.
        """
        points2D = np.ascontiguousarray(points2D, np.float64)
        ideal = np.asarray(self.camera.cam_from_img(points2D)).reshape(-1, 2) * self.focal_px
        if self.camera.model.name not in PINHOLES:  # COLMAP gives some pixels rays of others
            off = np.abs(self.image_from_ideal(ideal) - points2D).max(axis=1, initial=0)
            ideal[~(off < MAX_LENS_ERROR_PX)] = np.nan
        return ideal

    def image_from_ideal(self, ideal: FloatArray) -> FloatArray:
        """Distort (N, 2) ideal pixels to image pixels; the inverse of `ideal_from_image`."""
        rays = np.column_stack([np.asarray(ideal) / self.focal_px, np.ones(len(ideal))])
        return np.asarray(self.camera.img_from_cam(rays)).reshape(-1, 2)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """World directions (N, 3) through (N, 2) image pixels, one unit deep; NaN as above."""
        ideal = self.ideal_from_image(pixels) / self.focal_px
        directions: FloatArray = np.column_stack([ideal, np.ones(len(ideal))]) @ self.rotation
        return directions

    def cam_from_world(self, points: FloatArray) -> FloatArray:
        """(N, 3) world points in camera coordinates; z is the depth."""
        return points @ self.rotation.T + self.translation

    def project_ideal(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) ideal pixels and (N,) depths of (N, 3) world points; NaN pixels behind."""
        local = self.cam_from_world(points)
        depths = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            ideal = self.focal_px * local[:, :2] / np.where(depths > 0, depths, np.nan)[:, None]
        return ideal, depths

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) image pixels (COLMAP's origin) and (N,) depths of (N, 3) world points."""
        ideal, depths = self.project_ideal(points)
        return self.image_from_ideal(ideal), depths

    def holds(self, pixels: FloatArray, depths: FloatArray) -> BoolArray:
        """(N,) whether what projects to (N, 2) image pixels at (N,) depths is in the image."""
        inside = (pixels >= 0).all(axis=1) & (pixels < (self.width, self.height)).all(axis=1)
        held: BoolArray = inside & (depths > 0)
        return held


def rows_by_view(track_views: NDArray[np.integer[Any]], num_views: int) -> list[IntArray]:
    """Of each view the rows, ascending, of the (T,) views of observations that are its own."""
    order = order_of(track_views, num_views)
    return np.split(order, np.cumsum(np.bincount(track_views, minlength=num_views))[:-1])


def views_with_rows(
    views: Sequence[View], track_views: NDArray[np.integer[Any]]
) -> Iterator[tuple[View, IntArray]]:
    """Each view with the rows, ascending, of the (T,) views of observations that are its own."""
    return zip(views, rows_by_view(track_views, len(views)), strict=True)


def track_residuals(
    views: Sequence[View],
    points: FloatArray,
    track_views: NDArray[np.integer[Any]],
    track_points2D: FloatArray,
) -> FloatArray:
    """Distances (T,) in pixels of (T, 2) observations from projections of (T, 3) world points.

    NaN where the point lies behind the camera.
    """
    residuals = np.full(len(track_views), np.nan)
    for view, rows in views_with_rows(views, track_views):
        projected, _ = view.project(points[rows])
        residuals[rows] = np.linalg.norm(projected - track_points2D[rows], axis=1)
    return residuals
