"""Pictures: where photographs are, reading them, their colours; encoding."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from colmap_edges.core.arrays import ByteArray, FloatArray, Picture
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.input_files import open_file

# COLMAP takes pixels as they are stored, whatever the EXIF orientation says.
COLOR = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
# Of masks and edge images the gray counts, however deep it is.
GRAY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def path_of_image(image_path: Path, name: str) -> Path:
    """Path of the image `name` of a model below the folder `image_path`.

    Raises:
        ColmapEdgesError: when the name leads out of the folder.
    """
    relative = PurePosixPath(name)
    if relative.is_absolute() or ".." in relative.parts or not name:
        raise ColmapEdgesError(
            f"image name {name!r} leads out of {image_path}; rename the image in the model"
        )
    return image_path / relative


def first_there(folder: Path, names: Iterable[str]) -> Path | None:
    """Path of the first of these names that is there below a folder, a file or not.

    What is no file is not left out in silence: reading it says so.

    Raises:
        ColmapEdgesError: when a name leads out of the folder.
    """
    found = (path_of_image(folder, name) for name in names)
    return next((path for path in found if os.path.lexists(path)), None)


def check_images_exist(views: Iterable[View], image_path: Path) -> None:
    """Check that the image of every view is there, before work starts.

    Raises:
        ColmapEdgesError: naming the first that is missing and how many are.
    """
    missing = [v.name for v in views if not is_file(path_of_image(image_path, v.name))]
    if missing:
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise ColmapEdgesError(
            f"image {missing[0]}{more} of the model is not in {image_path}; "
            "give the folder the model was made from as --image_path"
        )


def is_file(path: Path) -> bool:
    """Whether a file is there; names that no file can have name none."""
    try:
        return path.is_file()
    except OSError:  # such as a name of more than 255 bytes
        return False


def read_image(view: View, image_path: Path) -> Picture:
    """Read the image of a view, (H, W, 3) uint8 in OpenCV's order of channels (BGR).

    Raises:
        ImageError: when it cannot be read.
        ColmapEdgesError: when it is not of its camera's size.
    """
    path = path_of_image(image_path, view.name)
    return decode_image(read_bytes(path), path, view)


def decode_image(data: ByteArray, path: Path, view: View) -> Picture:
    """Decode the bytes of a view's image; `path` is for messages.

    Raises:
        ImageError: when that cannot be done.
        ColmapEdgesError: when it is not of its camera's size.
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
    """Read any image file, (H, W, 3) uint8 in OpenCV's order of channels (BGR).

    Raises:
        ImageError: when it cannot be read.
    """
    return decode(read_bytes(path), path)


def read_bytes(path: Path) -> ByteArray:
    """Read an image file as it is.

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
        raise ImageError(f"cannot read image {path}: damaged, or no image format known here")
    return np.asarray(image, np.uint8)


def gray_of(image: Picture) -> Picture:
    """The picture (H, W, 3) without colour: (H, W)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def colors_at(image: Picture, points: FloatArray) -> ByteArray:
    """(N, 3) uint8 RGB of a BGR picture (H, W, 3) at (N, 2) image pixels, COLMAP's origin."""
    values = np.rint(_kernels.bilinear(image, points - 0.5)).astype(np.uint8)
    return np.ascontiguousarray(values[:, ::-1])


def square(radius: int) -> ByteArray:
    """(2 radius + 1, 2 radius + 1) ones: what pictures are eroded and dilated by."""
    return np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)


def encoded(kind: str, picture: Picture, options: Sequence[int] = ()) -> bytes:
    """The bytes of an image file.

    Args:
        kind: ending of the file's name, such as `.png`.
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
    """Keep OpenCV from using threads of its own: with an image a thread they wait for each other.

    Their waiting costs a tenth of detection's processor time.
    """
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
