"""Sparse COLMAP model of images with known poses: SIFT, matching, triangulation by pycolmap."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.distance import cdist

from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.files import read_picture


@dataclass(frozen=True, kw_only=True)
class PosedImage:
    """An undistorted image with its calibration and pose.

    Attributes:
        name: Path of the image below the image folder.
        width: In pixels.
        height: In pixels.
        calibration: (3, 3) matrix K; its skew is ignored.
        rotation: (3, 3) of cam_from_world.
        translation: (3,) of cam_from_world.
    """

    name: str
    width: int
    height: int
    calibration: FloatArray
    rotation: FloatArray
    translation: FloatArray

    @property
    def center(self) -> FloatArray:
        """(3,) projection centre in world coordinates."""
        return np.asarray(-self.rotation.T @ self.translation)


def posed_image(
    path: Path, calibration: FloatArray, rotation: FloatArray, translation: FloatArray
) -> PosedImage:
    """The image file `path` at a known pose.

    Raises:
        ColmapEdgesError: if the file is not an image.
    """
    height, width = read_picture(path).shape[:2]
    return PosedImage(
        name=path.name,
        width=width,
        height=height,
        calibration=calibration,
        rotation=rotation,
        translation=translation,
    )


def triangulate(
    images: Sequence[PosedImage],
    image_path: Path,
    output_path: Path,
    *,
    num_neighbors: int = 12,
    num_threads: int = -1,
    random_seed: int = 0,
) -> Any:
    """Triangulate SIFT points at known poses and write the model to `output_path`.

    Each image is matched with the `num_neighbors` images whose centres are nearest. Poses and
    calibrations stay as given.

    Returns:
        The pycolmap.Reconstruction written.

    Raises:
        ColmapEdgesError: if there are fewer than two images, or one is missing.
    """
    if len(images) < 2:
        raise ColmapEdgesError(
            f"{image_path}: {len(images)} images with poses; triangulation needs at least two"
        )
    missing = [image.name for image in images if not (image_path / image.name).is_file()]
    if missing:
        raise ColmapEdgesError(
            f"{image_path} holds no image {missing[0]}, which has a pose; give the folder that does"
        )
    pycolmap.set_random_seed(random_seed)
    output_path.mkdir(parents=True, exist_ok=True)
    posed = posed_reconstruction(images)
    with tempfile.TemporaryDirectory() as scratch, quiet_colmap():
        database_path = Path(scratch) / "database.db"
        write_database(posed, database_path)
        match(images, image_path, database_path, num_neighbors, num_threads)
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = num_threads
        options.random_seed = random_seed
        return pycolmap.triangulate_points(
            posed, database_path, image_path, output_path, options=options
        )


@contextmanager
def quiet_colmap() -> Iterator[None]:
    """Keep COLMAP's information lines off the terminal; warnings stay."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.WARNING.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def posed_reconstruction(images: Sequence[PosedImage]) -> Any:
    """A reconstruction of the images with a PINHOLE camera each, without points."""
    reconstruction = pycolmap.Reconstruction()
    for number, image in enumerate(images, start=1):
        k = image.calibration
        camera = pycolmap.Camera(
            camera_id=number,
            model="PINHOLE",
            width=image.width,
            height=image.height,
            params=[k[0, 0], k[1, 1], k[0, 2], k[1, 2]],
        )
        reconstruction.add_camera_with_trivial_rig(camera)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(image.rotation), image.translation)
        reconstruction.add_image_with_trivial_frame(
            pycolmap.Image(name=image.name, camera_id=number, image_id=number), pose
        )
    return reconstruction


def write_database(reconstruction: Any, path: Path) -> None:
    """Write a new database of the cameras and images of a reconstruction."""
    with pycolmap.Database.open(path) as database:
        for kind in ("camera", "rig", "frame", "image"):
            write = getattr(database, f"write_{kind}")
            for record in getattr(reconstruction, f"{kind}s").values():
                write(record, True)  # with its own id


def match(
    images: Sequence[PosedImage],
    image_path: Path,
    database_path: Path,
    num_neighbors: int,
    num_threads: int,
) -> None:
    """Find SIFT features of the images of a database, and match those of nearest neighbours."""
    extraction = pycolmap.FeatureExtractionOptions()
    matching = pycolmap.FeatureMatchingOptions()
    for options in (extraction, matching):
        options.num_threads = num_threads
        options.use_gpu = False
    pycolmap.extract_features(
        database_path,
        image_path,
        image_names=[image.name for image in images],
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(database_path.with_name("pairs.txt"))
    rows = [f"{images[a].name} {images[b].name}" for a, b in neighbor_pairs(images, num_neighbors)]
    Path(pairing.match_list_path).write_text("\n".join(rows) + "\n")
    pycolmap.match_image_pairs(
        database_path,
        matching_options=matching,
        pairing_options=pairing,
        device=pycolmap.Device.cpu,
    )


def neighbor_pairs(images: Sequence[PosedImage], num_neighbors: int) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, of images at least one of which is a nearest neighbour of the other."""
    centers = np.array([image.center for image in images])
    distances = cdist(centers, centers)
    np.fill_diagonal(distances, -1.0)  # first of its own neighbours
    nearest = np.argsort(distances, axis=1, kind="stable")[:, 1 : num_neighbors + 1]
    pairs = {(min(a, b), max(a, b)) for a, row in enumerate(nearest.tolist()) for b in row}
    return sorted(pairs)
