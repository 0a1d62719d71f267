"""DTU as MVSNet repackages it: Cameras/, Rectified/scanN_train/, Depths/.

Reference: Yao, Luo, Li, Fang, Quan, MVSNet, ECCV 2018. The images exist in two sizes:
1600 x 1200 pixels (Rectified/scanN or Rectified_raw/scanN, Cameras, Depths_raw/scanN), and crops of
the halved images, 640 x 512 (Rectified/scanN_train, Cameras/train, Depths/scanN_train), whose
cameras and depth maps are those of images of a quarter of that size, 160 x 128. Camera i takes
position i + 1. All lengths in millimetres.
"""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Float32Array, FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.layouts import dtu
from colmap_edges.evaluation.metrics.depth import ReferenceDepth
from colmap_edges.evaluation.scenes import Reference
from colmap_edges.evaluation.triangulation import PosedImage, posed_image
from colmap_edges.images.files import read_picture
from colmap_edges.runtime.input_files import read_bytes, read_text


class Layout(NamedTuple):
    """Paths of a scan's images, and of the cameras and depth maps of their size.

    Attributes:
        images: Folder of the images.
        cameras: Folder of NNNNNNNN_cam.txt.
        depths: Folder of depth_map_NNNN.pfm, which may be missing.
        pixel_factor: Scale factor from the cameras' pixels to the images'.
    """

    images: Path
    cameras: Path
    depths: Path
    pixel_factor: float


def is_layout(root: Path) -> bool:
    """Whether `root` has MVSNet's layout: Cameras/ with *_cam.txt, and no official calibration."""
    cameras = root / "Cameras"
    found = any(cameras.glob("*_cam.txt")) or any((cameras / "train").glob("*_cam.txt"))
    return found and dtu.find_optional(root, "Calibration/cal18") is None


def find_layout(root: Path, scan: int) -> Layout:
    """The layout of a scan; images of full size are preferred to crops.

    Raises:
        ColmapEdgesError: There are none.
    """
    cameras = root / "Cameras"
    for name in ("Rectified_raw", "Rectified"):
        full = root / name / f"scan{scan}"
        if full.is_dir():
            return Layout(full, cameras, root / "Depths_raw" / full.name, 1.0)
    crops = root / "Rectified" / f"scan{scan}_train"
    if not crops.is_dir():
        raise ColmapEdgesError(
            f"{root} holds no Rectified/scan{scan}_train or Rectified/scan{scan}"
        )
    return Layout(crops, cameras / "train", root / "Depths" / crops.name, 4.0)


def posed_images(
    root: Path, scan: int, *, light: str = "", positions: Container[int] = dtu.EVERY_POSITION
) -> tuple[Path, list[PosedImage]]:
    """Images and poses of a scan; arguments and result as those of `dtu.posed_images`.

    Raises:
        ColmapEdgesError: Images or cameras are missing, or are not of the same size.
    """
    layout = find_layout(root, scan)
    images = []
    for position, path in dtu.choose_images(layout.images, light, positions).items():
        camera_path = layout.cameras / f"{position - 1:08d}_cam.txt"
        if not camera_path.is_file():
            raise ColmapEdgesError(f"{camera_path} is missing; it calibrates {path.name}")
        calibration, rotation, translation = read_camera(camera_path)
        calibration[:2] *= layout.pixel_factor
        image = posed_image(path, calibration, rotation, translation)
        check_size(image, camera_path)
        images.append(image)
    return layout.images, images


def check_size(image: PosedImage, camera_path: Path) -> None:
    """Check that the principal point is in the middle half of the image, as in DTU.

    Releases differ in the sizes of their images; cameras of another size violate this.

    Raises:
        ColmapEdgesError: It is not.
    """
    x, y = image.calibration[:2, 2] / (image.width, image.height)
    if not (0.25 < x < 0.75 and 0.25 < y < 0.75):
        raise ColmapEdgesError(
            f"{camera_path} is not for images of {image.width} x {image.height} pixels like "
            f"{image.name}: its principal point is at {x:.2f}, {y:.2f} of their size"
        )


def read_camera(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Calibration (3, 3), rotation (3, 3) and translation (3,) of cam_from_world of a _cam.txt.

    The file holds the word `extrinsic`, a matrix (4, 4) of cam_from_world, `intrinsic`, a matrix
    (3, 3), and a range of depths, which is not used.

    Raises:
        ColmapEdgesError: The file holds something else.
    """
    words = read_text(path).split()
    try:
        if words[0] != "extrinsic" or words[17] != "intrinsic":
            raise ValueError("the words extrinsic and intrinsic are not in their places")
        pose = np.array(words[1:17], dtype=np.float64).reshape(4, 4)
        calibration = np.array(words[18:27], dtype=np.float64).reshape(3, 3)
    except (ValueError, IndexError) as error:
        raise ColmapEdgesError(f"{path} is not a camera of MVSNet's: {error}") from error
    rotation = pose[:3, :3]
    finite = np.isfinite(pose).all() and np.isfinite(calibration).all()
    if not finite or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        raise ColmapEdgesError(
            f"{path} is not a camera of MVSNet's: its rotation is not orthonormal"
        )
    return calibration, rotation, pose[:3, 3]


def reference_of(root: Path, scan: int, model: Model) -> Reference:
    """The depth maps of the scan's images that are in `model`; a note where there are none.

    Raises:
        ColmapEdgesError: A file is damaged.
    """
    folder, depths = find_layout(root, scan).depths, []
    for view in model.views:
        index = int(PurePath(view.name).stem.split("_")[1]) - 1
        path = folder / f"depth_map_{index:04d}.pfm"
        if path.is_file():
            depth = _without_background(read_pfm(path), folder / f"depth_visual_{index:04d}.png")
            scale = depth.shape[1] / view.width
            depths.append(ReferenceDepth(view=view, depth=depth, scale=scale))
    missing = "This scan has neither Points nor Depths: no errors are measured."
    return Reference(depths=depths, notes=[] if depths else [missing])


def _without_background(depth: Float32Array, visual_path: Path) -> Float32Array:
    known = np.isfinite(depth) & (depth > 0)
    if visual_path.is_file():
        visual = read_picture(visual_path).max(axis=2)
        if visual.shape != depth.shape:
            raise ColmapEdgesError(f"{visual_path} has another size than its depth map")
        known &= visual > 10  # as in MVSNet's training code
    return np.where(known, depth, np.float32(0))


def read_pfm(path: Path) -> Float32Array:
    """Read a grayscale portable float map, (H, W), top row first (the file stores it last).

    Raises:
        ColmapEdgesError: The file holds something else.
    """
    # Kind, width, height and scale, each followed by one white space; then the numbers.
    words = read_bytes(path).split(maxsplit=3)
    try:
        kind, width, height, rest = words
        scale, _, content = rest.partition(b"\n")
        if kind != b"Pf":
            raise ValueError(f"it begins with {kind[:8]!r}, not with Pf")
        order = "<f4" if float(scale) < 0 else ">f4"
        shape = (int(height), int(width))
        if min(shape) < 1:
            raise ValueError(f"its size is {shape[1]} x {shape[0]}")
        values = np.frombuffer(content, order, shape[0] * shape[1]).reshape(shape)
    except (ValueError, OverflowError) as error:
        raise ColmapEdgesError(f"{path} is not a grayscale PFM: {error}") from error
    return values[::-1].astype(np.float32)
