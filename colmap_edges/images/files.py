"""Locating, reading and encoding of image files, and image colours at points."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from colmap_edges.core.arrays import ByteArray, Float32Array, FloatArray, Picture
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.input_files import open_file

# COLMAP ignores the EXIF orientation.
COLOR = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
# Masks and edge images are read as grayscale of any bit depth.
GRAY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


@dataclass(frozen=True)
class CompanionFile:
    """A file that belongs to an image of the model, undecoded: its mask or its edge image.

    Attributes:
        kind: its kind, for messages.
        path: path of the file.
        image_name: name of the image in the model.
        data: (B,) uint8 bytes of the file.
    """

    kind: str
    path: Path
    image_name: str
    data: ByteArray

    @classmethod
    def read(cls, kind: str, path: Path, image_name: str) -> CompanionFile:
        """Read the file.

        Raises:
            ColmapEdgesError: if it cannot be read; not an `ImageError`, which would skip the image.
        """
        try:
            return cls(kind, path, image_name, read_bytes(path))
        except ImageError as error:
            raise cls(kind, path, image_name, np.zeros(0, np.uint8)).unreadable() from error

    def unreadable(self) -> ColmapEdgesError:
        """Make the error for a file that cannot be read or decoded."""
        return ColmapEdgesError(
            f"cannot read {self.kind} {self.path} of image {self.image_name}; replace or delete it"
        )

    def decode(self) -> Picture:
        """Decode the intensities, (H, W) of any unsigned type.

        Raises:
            ColmapEdgesError: if it cannot be decoded.
        """
        picture = cv2.imdecode(self.data, GRAY) if len(self.data) else None
        if picture is None or picture.dtype.kind != "u":  # not an image of integers
            raise self.unreadable()
        return np.asarray(picture)


def path_of_image(image_path: Path, name: str) -> Path:
    """Path of the image `name` of a model below the folder `image_path`.

    Raises:
        ColmapEdgesError: if the name leads out of the folder.
    """
    relative = PurePosixPath(name)
    if relative.is_absolute() or ".." in relative.parts or not name:
        raise ColmapEdgesError(
            f"image name {name!r} leads out of {image_path}; rename the image in the model"
        )
    return image_path / relative


def first_existing(folder: Path, names: Iterable[str]) -> Path | None:
    """Path of the first of these names that exists below a folder; None if none does.

    It need not be a file; reading reports that as an error.

    Raises:
        ColmapEdgesError: if a name leads out of the folder.
    """
    found = (path_of_image(folder, name) for name in names)
    return next((path for path in found if os.path.lexists(path)), None)


def check_images_exist(views: Iterable[View], image_path: Path) -> None:
    """Check that the image of every view exists, before work starts.

    Raises:
        ColmapEdgesError: naming the first missing image and the number of missing ones.
    """
    missing = [v.name for v in views if not is_file(path_of_image(image_path, v.name))]
    if missing:
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise ColmapEdgesError(
            f"image {missing[0]}{more} of the model is not in {image_path}; "
            "give the folder the model was made from as --image_path"
        )


def is_file(path: Path) -> bool:
    """Whether a path is a file; false for invalid names."""
    try:
        return path.is_file()
    except OSError:  # such as a name of more than 255 bytes
        return False


def read_image(view: View, image_path: Path) -> Picture:
    """Read the image of a view, (H, W, 3) uint8 in OpenCV's channel order (BGR).

    Raises:
        ImageError: if it cannot be read.
        ColmapEdgesError: if it does not have its camera's size.
    """
    path = path_of_image(image_path, view.name)
    return decode_image(read_bytes(path), path, view)


def decode_image(data: ByteArray, path: Path, view: View) -> Picture:
    """Decode the bytes of a view's image; `path` is for messages.

    Raises:
        ImageError: if it cannot be decoded.
        ColmapEdgesError: if it does not have its camera's size.
    """
    image = decode(data, path)
    height, width = image.shape[:2]
    if (width, height) != (view.width, view.height):
        raise ColmapEdgesError(
            f"image {path} is {width}x{height}, its camera {view.width}x{view.height}; "
            "give the images the model was made from (undistorted ones for an undistorted model)"
        )
    return image


def read_picture(path: Path) -> Picture:
    """Read any image file, (H, W, 3) uint8 in OpenCV's channel order (BGR).

    Raises:
        ImageError: when it cannot be read.
    """
    return decode(read_bytes(path), path)


def read_bytes(path: Path) -> ByteArray:
    """Read the bytes of an image file.

    Raises:
        ImageError: when it cannot be read.
    """
    try:
        with open_file(path) as file:
            return np.fromfile(file, np.uint8)
    except (OSError, MemoryError) as error:
        raise unreadable(path, error) from error


def unreadable(path: Path, error: Exception) -> ImageError:
    """Make the error for an image that cannot be read or decoded."""
    return ImageError(f"cannot read image {path}: {' '.join(str(error).split())}")


def decode(data: ByteArray, path: Path) -> Picture:
    """Decode the bytes of an image file; `path` is for messages.

    Raises:
        ImageError: when that cannot be done.
    """
    try:
        image = cv2.imdecode(data, COLOR) if len(data) else None
    except (MemoryError, cv2.error) as error:
        raise unreadable(path, error) from error
    if image is None:
        raise ImageError(f"cannot read image {path}: it is damaged or of an unknown format")
    return np.asarray(image, np.uint8)


def gray_of(image: Picture) -> Picture:
    """The image (H, W, 3) in grayscale, (H, W)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def colors_at(image: Picture, points: FloatArray | Float32Array) -> ByteArray:
    """(N, 3) uint8 RGB of a BGR picture (H, W, 3) at (N, 2) image pixels, COLMAP's origin."""
    values = np.rint(_kernels.bilinear(image, points - 0.5)).astype(np.uint8)
    return np.ascontiguousarray(values[:, ::-1])


def square(radius: int) -> ByteArray:
    """(2 radius + 1, 2 radius + 1) ones, the structuring element of morphology."""
    return np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)


def encoded(kind: str, picture: Picture, options: Sequence[int] = ()) -> bytes:
    """The bytes of an image file.

    Args:
        kind: suffix of the file's name, such as `.png`.
        picture: (H, W), (H, W, 3) BGR or (H, W, 4) BGRA.
        options: pairs of OpenCV's flags and values.

    Raises:
        ColmapEdgesError: when it cannot be encoded.
    """
    done, data = cv2.imencode(kind, picture, options)
    if not done:
        raise ColmapEdgesError(f"cannot encode a picture of {picture.shape} as {kind}")
    return bytes(data.tobytes())


@contextmanager
def single_threaded_opencv() -> Iterator[None]:
    """Disable OpenCV's own threads while images are processed in parallel.

    They would wait for each other, which costs a tenth of detection's CPU time.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
