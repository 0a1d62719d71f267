"""Errors of poses against true cameras, and models with simulated pose errors."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import read_text


@dataclass(frozen=True, kw_only=True)
class TrueCameras:
    """The true poses of a scene and, where it is known, the camera that all images share.

    Attributes:
        cam_from_world: (3, 4) pose by name of image.
        camera: The pycolmap.Camera, or None.
    """

    cam_from_world: dict[str, Any]
    camera: Any = None

    def pose(self, name: str) -> Any:
        """The pycolmap.Rigid3d of an image.

        Raises:
            ColmapEdgesError: if it has none.
        """
        if name not in self.cam_from_world:
            raise ColmapEdgesError(f"the true cameras hold no pose of image {name}")
        return pycolmap.Rigid3d(np.array(self.cam_from_world[name]))


def load_true_cameras(path: Path) -> TrueCameras:
    """Read `true_cameras.json`: model, width, height and params of the camera, and poses.

    Raises:
        ColmapEdgesError: if it is not such a file.
    """
    try:
        data = json.loads(read_text(path))
        values = {name: data[name] for name in ("model", "width", "height", "params")}
        camera = pycolmap.Camera(camera_id=1, **values)
        return TrueCameras(cam_from_world=data["cam_from_world"], camera=camera)
    except (KeyError, OSError, RuntimeError, TypeError, ValueError) as error:
        raise ColmapEdgesError(f"{path} holds no true cameras ({error})") from error


def images_of(reconstruction: Any) -> list[Any]:
    """The images with poses, sorted by name."""
    posed = [image for image in reconstruction.images.values() if image.has_pose]
    return sorted(posed, key=lambda image: image.name)


def pose_errors(reconstruction: Any, truth: TrueCameras) -> tuple[float, float]:
    """Errors of the poses after the similarity that fits their centres to the true ones best.

    Returns:
        Root mean squares of the distances of the centres, world units, and of the angles between
        the rotations, degrees.
    """
    images = images_of(reconstruction)
    true = [truth.pose(image.name) for image in images]
    found = np.array([image.projection_center() for image in images])
    expected = np.array([pose.inverse().translation for pose in true])
    similarity = pycolmap.estimate_sim3d(found, expected)
    if similarity is None:
        raise ColmapEdgesError(
            f"{len(images)} camera centres do not determine a similarity; give at least 3"
        )
    moved = np.array([similarity * center for center in found])
    turns = [
        image.cam_from_world().rotation * similarity.rotation.inverse() * pose.rotation.inverse()
        for image, pose in zip(images, true, strict=True)
    ]
    distances = np.linalg.norm(moved - expected, axis=1)
    angles = np.degrees([turn.angle() for turn in turns])
    return float(np.sqrt(np.mean(distances**2))), float(np.sqrt(np.mean(angles**2)))


def at_true_cameras(reconstruction: Any, truth: TrueCameras, names: list[str] | None = None) -> Any:
    """A model of the true cameras, with the SfM observations triangulated again.

    Args:
        reconstruction: the model with the observations and approximate points; not changed.
        truth: cameras and poses.
        names: images to keep; all when not given.
    """
    result = pycolmap.Reconstruction()
    result.add_camera_with_trivial_rig(truth.camera)
    images = [i for i in images_of(reconstruction) if names is None or i.name in names]
    for image in images:
        points2D = [pycolmap.Point2D(point.xy) for point in image.points2D]
        bare = pycolmap.Image(image.name, points2D, 1, image.image_id)
        result.add_image_with_trivial_frame(bare, truth.pose(image.name))
    kept = {image.image_id for image in images}
    for point in reconstruction.points3D.values():
        elements = [e for e in point.track.elements if e.image_id in kept]
        if len({element.image_id for element in elements}) >= 2:
            result.add_point3D(point.xyz, pycolmap.Track(elements), point.color)
    adjust_by_colmap(result, poses=False)
    return result


def with_pose_noise(reconstruction: Any, noise_px: float, random_seed: int) -> Any:
    """A copy with noisy poses, and points triangulated again.

    Every image is rotated and shifted at random, in equal parts, so that the projections of its
    points move by `noise_px` (root mean square).
    """
    rng = np.random.default_rng(random_seed)
    result = pycolmap.Reconstruction(reconstruction)
    for image in images_of(result):
        frame = result.frames[image.frame_id]
        frame.rig_from_world = noisy_pose(result, image, noise_px, rng)
    adjust_by_colmap(result, poses=False)
    return result


def noisy_pose(reconstruction: Any, image: Any, noise_px: float, rng: np.random.Generator) -> Any:
    """The pose of one image with noise."""
    ids = [point.point3D_id for point in image.points2D if point.has_point3D()]
    points = np.array([reconstruction.points3D[i].xyz for i in ids])
    pose, focal = image.cam_from_world(), image.camera.mean_focal_length()
    depth = np.median((pose * points)[:, 2])
    turn, shift = rng.normal(size=(2, 3)) / focal

    def moved(scale: float) -> Any:
        rotation = Rotation.from_rotvec(scale * turn).as_matrix()
        return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), scale * shift * depth) * pose

    before, after = (image.camera.img_from_cam(p * points) for p in (pose, moved(1.0)))
    return moved(noise_px / np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1))))


def adjust_by_colmap(reconstruction: Any, *, poses: bool, robust: bool = False) -> None:
    """COLMAP's own bundle adjustment in place; intrinsics stay, and poses unless `poses`."""
    config = pycolmap.BundleAdjustmentConfig()
    for image in images_of(reconstruction):
        config.add_image(image.image_id)
    for camera_id in reconstruction.cameras:
        config.set_constant_cam_intrinsics(camera_id)
    if poses:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    else:
        for frame_id in reconstruction.frames:
            config.set_constant_rig_from_world_pose(frame_id)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    if robust:
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
