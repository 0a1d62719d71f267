"""Rejection of implausible cameras, poses and points.

Such values would otherwise show up much later, as overflows or empty results.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.core.checks import MAX_COORDINATE
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError

MAX_POINT3D_ID = 2**62  # larger ids leave none for edge points


def check_camera(camera: Any, name: str) -> None:
    """Check that a pycolmap.Camera is plausible and supported.

    Raises:
        ColmapEdgesError: if it is not; `name` is the name of one of its images.
    """
    if not (0 < camera.width < 2**31 and 0 < camera.height < 2**31):
        raise ColmapEdgesError(
            f"the camera of image {name} has the impossible size {camera.width}x{camera.height}; "
            "write the model again"
        )
    params = np.asarray(camera.params)
    focal_lengths = params[camera.focal_length_idxs()]
    if len(focal_lengths) == 0:
        raise ColmapEdgesError(
            f"the camera of image {name} is {camera.model.name}, which has no focal length; cut "
            "panoramas into perspective images of a rig and map those, as COLMAP's "
            "python/examples/panorama_sfm.py does"
        )
    if not np.isfinite(params).all() or not (focal_lengths > 0).all():
        raise ColmapEdgesError(
            f"the camera of image {name} has the parameters {camera.params_to_string()}; they "
            "must be finite and the focal length > 0"
        )
    # In image sides, fisheye lenses have 0.2, telescopes 1e4.
    ratios = focal_lengths / max(camera.width, camera.height)
    if np.abs(params).max() > 1e12 or not ((ratios >= 1e-3) & (ratios <= 1e6)).all():
        raise ColmapEdgesError(
            f"the camera of image {name}, {camera.width}x{camera.height}, has implausible "
            f"parameters: {camera.params_to_string()}; calibrate it again or deregister the image"
        )


def check_lens(view: View) -> None:
    """Check that the distortion of a view's camera can be undone, on its axis and in the image.

    Raises:
        ColmapEdgesError: if it cannot.
    """
    steps = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])  # undistorted pixels
    moved = view.image_from_undistorted(steps) - view.image_from_undistorted(np.zeros((1, 2)))
    # Relative to the focal length, lenses have 1, COLMAP's FOV model a little more. It is negative
    # or huge for parameters beyond their range.
    magnification = (moved * steps).sum(axis=1)
    is_plain = (magnification >= 0.2) & (magnification <= 5)
    sides = (np.linspace(0, side, 9) for side in (view.width, view.height))
    pixels = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    if not is_plain.all() or not np.isfinite(view.rays(pixels)).all(axis=1).any():
        raise ColmapEdgesError(
            f"the distortion of the camera of image {view.name}, {view.camera.model.name} "
            f"{view.camera.params_to_string()}, cannot be undone; calibrate it again"
        )


def check_pose(cam_from_world: Any, name: str) -> None:
    """Check that a pycolmap.Rigid3d is a plausible pose.

    Raises:
        ColmapEdgesError: if it is not; `name` is the image's name.
    """
    matrix = np.asarray(cam_from_world.matrix())
    if not np.isfinite(matrix).all():
        raise ColmapEdgesError(f"the pose of image {name} is not finite; deregister it")
    if np.abs(matrix[:, 3]).max() > MAX_COORDINATE:
        raise ColmapEdgesError(
            f"the pose of image {name} has the implausible translation {matrix[:, 3].tolist()}; "
            "deregister it"
        )
    length = float(np.linalg.norm(cam_from_world.rotation.quat))
    if (
        abs(length - 1) > 1e-3
    ):  # COLMAP replaces quaternions that it cannot normalise by the identity
        raise ColmapEdgesError(
            f"the rotation of image {name} is a quaternion of length {length:g}, not 1; "
            "deregister it"
        )


def check_ids(point3D_ids: NDArray[np.uint64]) -> None:
    """Check that (N,) point ids leave room for those of edge points.

    Raises:
        ColmapEdgesError: if they do not.
    """
    largest = int(point3D_ids.max(initial=0))
    if largest > MAX_POINT3D_ID:
        raise ColmapEdgesError(
            f"point3D {largest} of the model leaves no ids for edge points, which need larger; "
            f"give the points ids up to {MAX_POINT3D_ID}"
        )


def within_reach(points: FloatArray, centers: FloatArray) -> BoolArray:
    """(N,) whether (N, 3) world points are closer than infinity, given (V, 3) camera centres.

    Points at infinity have no defined depth, and their coordinates would cost precision.
    """
    near = np.asarray((np.abs(points) <= MAX_COORDINATE).all(axis=1), bool)
    if not near.any() or not len(centers):
        return near
    middle = np.median(centers, axis=0)
    distances = np.linalg.norm(points[near] - middle, axis=1)
    extent = np.linalg.norm(centers - middle, axis=1).max()
    # Beyond it, viewing rays are parallel up to a hundredth of a pixel.
    near[near] = distances <= 1e6 * max(float(extent), float(np.median(distances)))
    return near
