"""A posed image with its camera, and the conversions between pixels and world points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray, offsets_of, order_of, parts_of
from colmap_edges.core.polylines import lengths_of


def lift(view: View, undistorted: FloatArray, inverse_depths: FloatArray) -> FloatArray:
    """(N, 3) world points of (N, 2) undistorted pixels at (N,) inverse depths."""
    rays = np.column_stack([undistorted / view.focal_px, np.ones(len(undistorted))])
    return np.asarray((rays / inverse_depths[:, None] - view.translation) @ view.rotation)


# Points that are projected at once: the overhead of a call is small, the arrays stay in the cache.
GROUP_SIZE = 5_000


@dataclass(frozen=True, kw_only=True)
class View:
    """One posed image: COLMAP's image, its camera and its pose.

    A view has two kinds of pixels. Image pixels are those of the given image (distorted, COLMAP's
    origin). Undistorted pixels are those of a pinhole camera of focal length `focal_px` with the
    principal point at (0, 0), of the image upsampled `scale` times.
    Geometry uses undistorted pixels.
    """

    image_id: int
    name: str
    width: int
    height: int
    camera: Any  # pycolmap.Camera
    rotation: FloatArray  # (3, 3) of cam_from_world
    translation: FloatArray  # (3,) of cam_from_world
    scale: float = 1.0  # upsampling factor for detection; below 1 if downsampled

    @cached_property
    def focal_px(self) -> float:
        """Mean focal length in pixels of the upsampled image."""
        return self.scale * float(self.camera.mean_focal_length())

    @cached_property
    def center(self) -> FloatArray:
        """(3,) projection centre in world coordinates."""
        return np.asarray(-self.rotation.T @ self.translation)

    @cached_property
    def fold(self) -> float:
        """The tangent of the angle off axis at which the lens folds back.

        Beyond it, polynomials of the distortion project rays back into the image. Infinite if the
        distance from the principal point grows everywhere, as it does without distortion.
        """
        if self.camera.model.name in ("PINHOLE", "SIMPLE_PINHOLE"):
            return np.inf
        turns, radii = np.arange(8) * np.pi / 4, np.geomspace(1e-2, 1e2, 256)
        rays = np.ones((len(turns), len(radii), 3))
        rays[:, :, :2] = np.column_stack([np.cos(turns), np.sin(turns)])[:, None] * radii[:, None]
        pixels = np.asarray(self.camera.img_from_cam(rays.reshape(-1, 3)))
        center = self.camera.img_from_cam(np.array([[0.0, 0.0, 1.0]]))
        with np.errstate(invalid="ignore"):
            away = np.linalg.norm(pixels.reshape(*rays.shape[:2], 2) - center, axis=2)
            folds = ~(np.diff(away, axis=1) > 0).all(axis=0)
        return float(radii[np.argmax(folds)]) if folds.any() else np.inf

    def undistorted_from_image(self, points2D: FloatArray) -> FloatArray:
        """Undistort (N, 2) image pixels; NaN where the camera model cannot.

        This happens where the distortion has no inverse, or rays are over 90 degrees off axis.
        """
        points2D = np.ascontiguousarray(points2D, np.float64)
        undistorted = np.asarray(self.camera.cam_from_img(points2D)).reshape(-1, 2) * self.focal_px
        if self.camera.model.name not in ("PINHOLE", "SIMPLE_PINHOLE"):
            # COLMAP undistorts some pixels wrongly: distorted again, they are elsewhere.
            x, y = np.abs(self.image_from_undistorted(undistorted) - points2D).T
            undistorted[~((x < 0.1) & (y < 0.1))] = np.nan
        return undistorted

    def image_from_undistorted(self, undistorted: FloatArray) -> FloatArray:
        """Distort (N, 2) undistorted pixels to image pixels; NaN beyond the lens's fold."""
        rays = np.column_stack([np.asarray(undistorted) / self.focal_px, np.ones(len(undistorted))])
        return self.distorted(rays)

    def distorted(self, rays: FloatArray) -> FloatArray:
        """(N, 2) image pixels of (N, 3) rays of depth 1; NaN beyond the lens's fold."""
        pixels = np.asarray(self.camera.img_from_cam(rays)).reshape(-1, 2)
        if np.isfinite(self.fold):
            pixels[rays[:, 0] ** 2 + rays[:, 1] ** 2 >= self.fold**2] = np.nan
        return pixels

    def rays(self, pixels: FloatArray) -> FloatArray:
        """(N, 3) viewing rays in world coordinates, of depth 1, of (N, 2) image pixels; or NaN."""
        return self.rays_of_undistorted(self.undistorted_from_image(pixels))

    def rays_of_undistorted(self, undistorted: FloatArray) -> FloatArray:
        """(..., 3) viewing rays in the world, of depth 1, of (..., 2) undistorted pixels."""
        depths = np.ones((*undistorted.shape[:-1], 1))
        local = np.concatenate([undistorted / self.focal_px, depths], axis=-1)
        return np.asarray(local @ self.rotation)

    def cam_from_world(self, points: FloatArray) -> FloatArray:
        """(N, 3) world points in camera coordinates; z is the depth."""
        return points @ self.rotation.T + self.translation

    def project_undistorted(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) undistorted pixels and (N,) depths of (N, 3) points; NaN behind the camera."""
        x, y, depths = self.cam_from_world(points).T  # one by one: rows of two are slow
        before = np.where(depths > 0, depths, np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            undistorted = np.column_stack([self.focal_px * of / before for of in (x, y)])
        return undistorted, depths

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) image pixels (COLMAP's origin) and (N,) depths of (N, 3) world points."""
        undistorted, depths = self.project_undistorted(points)
        return self.image_from_undistorted(undistorted), depths

    def holds(self, pixels: FloatArray, depths: FloatArray) -> BoolArray:
        """(N,) whether (N, 2) projections with (N,) depths are in front and inside the image."""
        x, y = pixels.T  # one by one: reductions of two elements are slow
        inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return np.asarray(inside & (depths > 0))


def cells_seen(
    view: View, points: FloatArray, shape: tuple[int, ...]
) -> tuple[IntArray, IntArray, IntArray]:
    """Indices of the (N, 3) points in an image, their rows and columns in its (h, w) picture."""
    pixels, depths = view.project(points)
    seen = np.flatnonzero(view.holds(pixels, depths))
    scale = np.array(shape[1::-1]) / (view.width, view.height)
    columns, rows = np.floor(pixels[seen] * scale).astype(np.int64).T
    return seen, rows, columns


def in_images(views: Sequence[View], points: FloatArray) -> BoolArray:
    """(V, N) whether (N, 3) world points are in the images of V views.

    Views of one camera are projected together, since each call of pycolmap has an overhead.
    """
    inside = np.zeros((len(views), len(points)), bool)
    cameras = np.array([view.camera.camera_id for view in views], np.int64)
    most = max(GROUP_SIZE // max(len(points), 1), 1)
    for camera in np.unique(cameras):
        alike = np.flatnonzero(cameras == camera)
        for first in range(0, len(alike), most):
            rows = alike[first : first + most]
            group = [views[row] for row in rows.tolist()]
            turned = np.concatenate([view.rotation for view in group]) @ points.T
            local = turned.reshape(len(rows), 3, -1).transpose(0, 2, 1)
            local = (local + np.array([view.translation for view in group])[:, None]).reshape(-1, 3)
            depths = local[:, 2]
            with np.errstate(divide="ignore", invalid="ignore"):
                rays = local / np.where(depths > 0, depths, np.nan)[:, None]
            pixels = group[0].distorted(rays)
            inside[rows] = group[0].holds(pixels, depths).reshape(len(rows), -1)
    return inside


def rows_by_view(track_views: NDArray[np.integer[Any]], num_views: int) -> list[IntArray]:
    """The ascending rows of each view among the (T,) views of observations."""
    order = order_of(track_views, num_views)
    return parts_of(order, offsets_of(np.bincount(track_views, minlength=num_views)))


def views_with_rows(
    views: Sequence[View], track_views: NDArray[np.integer[Any]]
) -> Iterator[tuple[View, IntArray]]:
    """Pairs of each view and its ascending rows among the (T,) views of observations."""
    return zip(views, rows_by_view(track_views, len(views)), strict=True)


def nearest_pixel_sizes(
    views: Sequence[View],
    points: FloatArray,
    owners: IntArray,
    track_views: NDArray[np.integer[Any]],
) -> FloatArray:
    """(N,) length of an image pixel at points, in the nearest view that observes each.

    Infinite where no view observes a point from its front.

    Args:
        views: the views.
        points: (N, 3) world units.
        owners: (T,) observed points.
        track_views: (T,) views that observe them.
    """
    sizes = np.full(len(points), np.inf)
    for view, rows in views_with_rows(views, track_views):
        own = owners[rows]
        depths = view.cam_from_world(points[own])[:, 2]
        size = np.where(depths > 0, depths, np.inf) / (view.focal_px / view.scale)
        sizes[own] = np.minimum(sizes[own], size)
    return sizes


def track_residuals(
    views: Sequence[View],
    points: FloatArray,
    track_views: NDArray[np.integer[Any]],
    track_points2D: FloatArray,
) -> FloatArray:
    """(T,) reprojection errors in pixels of (T, 2) observations of (T, 3) world points.

    NaN for points behind the camera.
    """
    residuals = np.full(len(track_views), np.nan)
    for view, rows in views_with_rows(views, track_views):
        projected, _ = view.project(points[rows])
        residuals[rows] = lengths_of(projected - track_points2D[rows])
    return residuals
