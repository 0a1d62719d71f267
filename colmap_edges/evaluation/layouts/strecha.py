"""Strecha's multi-view benchmark: `.camera` and `K.txt` files (Strecha et al., CVPR 2008)."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.poses import TrueCameras
from colmap_edges.evaluation.scenes import Scene, reference_of
from colmap_edges.evaluation.triangulation import PosedImage, posed_image
from colmap_edges.runtime.input_files import read_text


def find_folders(folder: Path) -> tuple[Path, Path]:
    """Folders of a scene's images and of its NAME.camera files.

    Images are in `folder` or in its images/; cameras are in the same folder, in `folder`, or in a
    folder of it, such as gt_dense_cameras/.

    Raises:
        ColmapEdgesError: There is no NAME.camera.
    """
    if not folder.is_dir():
        raise ColmapEdgesError(
            f"{folder} is not a folder; give a folder with a scene's images and cameras"
        )
    image_path = folder / "images" if (folder / "images").is_dir() else folder
    others = sorted(path for path in folder.iterdir() if path.is_dir())
    for camera_path in (image_path, folder, *others):
        if any(camera_path.glob("*.camera")):
            return image_path, camera_path
    raise ColmapEdgesError(f"{folder} holds no NAME.camera, and no folder in it does")


def folder_scene(folder: Path, reference_path: Path) -> Scene:
    """The scene of a folder, named as the folder.

    Args:
        folder: See `find_folders`; K.txt, if there is one, lies beside the images.
        reference_path: See `scenes.reference_of`.

    Raises:
        ColmapEdgesError: No image has a camera, or one cannot be read.
    """
    image_path, camera_path = find_folders(folder)
    return Scene(
        name=folder.resolve().name,
        image_path=image_path,
        posed=posed_images(image_path, camera_path),
        load_reference=partial(reference_of, reference_path, ()),
        unit="m",
    )


def posed_images(image_path: Path, camera_path: Path | None = None) -> list[PosedImage]:
    """Images with a NAME.camera file in the same folder or in `camera_path`.

    Raises:
        ColmapEdgesError: No image has one, or one cannot be read.
    """
    camera_path = camera_path or image_path
    calibration = read_calibration(image_path / "K.txt")
    images = []
    for path in sorted(image_path.iterdir()):
        camera = camera_path / f"{path.name}.camera"
        if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".ppm") and camera.is_file():
            images.append(posed_image(path, *read_camera(camera, calibration)))
    if not images:
        raise ColmapEdgesError(f"{camera_path} holds no NAME.camera for the images of {image_path}")
    return images


def load_true_poses(camera_path: Path) -> TrueCameras:
    """The poses of a folder's NAME.camera files.

    Raises:
        ColmapEdgesError: There are none, or one cannot be read.
    """
    paths = sorted(camera_path.glob("*.camera"))
    if not paths:
        raise ColmapEdgesError(f"{camera_path} holds no NAME.camera")
    cameras = {path.stem: read_camera(path, np.eye(3)) for path in paths}
    poses = {name: np.column_stack([turn, shift]) for name, (_, turn, shift) in cameras.items()}
    return TrueCameras(cam_from_world=poses)


def read_calibration(path: Path) -> FloatArray | None:
    """The matrix (3, 3) of a K.txt, None where there is no such file."""
    if not path.is_file():
        return None
    values = _numbers(path)
    if len(values) != 9:
        raise ColmapEdgesError(f"{path} holds {len(values)} numbers; a calibration has 9")
    return values.reshape(3, 3)


def read_camera(
    path: Path, calibration: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Calibration (3, 3), rotation (3, 3) and translation (3,) of cam_from_world of a .camera file.

    The file holds K, a row of zeros, the rotation world_from_cam, the centre and the size of the
    image. Without K and the zeros in it, `calibration` (of K.txt) is taken.

    Raises:
        ColmapEdgesError: The file holds something else.
    """
    values = _numbers(path)
    if len(values) == 26:
        calibration, values = values[:9].reshape(3, 3), values[12:]
    if calibration is None or len(values) != 14:
        raise ColmapEdgesError(f"{path} is not a .camera file of K, 0 0 0, R, centre, size")
    rotation = values[:9].reshape(3, 3).T
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        raise ColmapEdgesError(f"{path}: the rotation is not orthonormal")
    return calibration, rotation, -rotation @ values[9:12]


def _numbers(path: Path) -> FloatArray:
    try:
        return np.array(read_text(path).replace(",", " ").split(), dtype=np.float64)
    except ValueError as error:
        raise ColmapEdgesError(f"{path} must hold numbers only: {error}") from error
