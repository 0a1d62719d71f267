"""Locating, reading and encoding of image files, and image colours at points."""

from __future__ import annotations

import hashlib
import os
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np

from colmap_edges.core.arrays import ByteArray, Float32Array, FloatArray, Picture
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.input_files import open_file

JPEG, PNG = b"\xff\xd8", b"\x89PNG"  # first bytes of files
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
            f"{where_image_is(image_path, missing[0])}"
        )


def where_image_is(image_path: Path, name: str) -> str:
    """The remedy for a missing image: it may be nearby, or have nearly the same name."""
    near = near_name(image_path, name)
    if near:
        return f"{near!a} is there: rename it to the model's {PurePosixPath(name).name!a}"
    inside = (folder for folder in sorted(image_path.iterdir()) if folder.is_dir())
    parts = PurePosixPath(name).parts
    outside = [image_path.parent] if parts[0] == image_path.name else []
    for folder in (*outside, *inside):
        if is_file(path_of_image(folder, name)):
            return f"it is in {folder}: give that as --image_path"
    return "give the folder the model was made from as --image_path"


def near_name(image_path: Path, name: str) -> str | None:
    """The file in the folder of an image whose name differs in case, suffix or Unicode form."""
    path = path_of_image(image_path, name)
    with suppress(OSError):
        others = sorted(other.name for other in path.parent.iterdir() if other.is_file())
        for key in (plain_name, lambda text: PurePosixPath(plain_name(text)).stem):
            found = next((other for other in others if key(other) == key(path.name)), None)
            if found:
                return found
    return None


def plain_name(name: str) -> str:
    """A name without case, in one Unicode form."""
    return unicodedata.normalize("NFC", name).casefold()


def is_file(path: Path) -> bool:
    """Whether a path is a file; false for invalid names."""
    try:
        return path.is_file()
    except OSError:  # such as a name of more than 255 bytes
        return False


def count_images(folder: Path) -> int:
    """Number of image files below a folder, by their suffixes."""
    return sum(
        Path(name).suffix.lower()
        in {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".heic", ".heif"}
        for _, _, names in os.walk(folder)
        for name in names
    )


def same_files(views: Sequence[View], image_path: Path) -> list[list[int]]:
    """Groups of indices of views whose image files have the same bytes.

    Files that cannot be read are left out. Of files of different sizes, nothing is read.
    """
    groups = [list(range(len(views)))]
    for key in (file_size, middle_bytes, digest):
        groups = [group for former in groups for group in equal_by(key, former, views, image_path)]
    return groups


def equal_by(
    key: Callable[[Path], Any], rows: list[int], views: Sequence[View], image_path: Path
) -> list[list[int]]:
    """Groups of two or more of the rows whose image files have equal keys."""
    found: dict[Any, list[int]] = {}
    for row in rows:
        with suppress(OSError, ColmapEdgesError):
            found.setdefault(key(path_of_image(image_path, views[row].name)), []).append(row)
    return [group for group in found.values() if len(group) > 1]


def file_size(path: Path) -> int:
    """The size of a file in bytes."""
    return path.stat().st_size


def middle_bytes(path: Path) -> bytes:
    """Some bytes in the middle of a file, which tell most images apart."""
    with open_file(path) as file:
        file.seek(file_size(path) // 2)
        return file.read(4096)


def digest(path: Path) -> bytes:
    """A digest of all bytes of a file."""
    with open_file(path) as file:
        return hashlib.sha256(file.read()).digest()


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
        remedy = (
            "give the images the model was made from (undistorted ones for an undistorted model)"
        )
        if (height, width) == (view.width, view.height):
            remedy = (
                "the image was rotated by a quarter turn after mapping, or before it by a program "
                "that heeds the EXIF orientation, which COLMAP does not: give the images as mapped"
            )
        raise ColmapEdgesError(
            f"image {path} is {width}x{height}, its camera {view.width}x{view.height}; {remedy}"
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
    color = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION  # as COLMAP does
    try:
        image = cv2.imdecode(data, color) if len(data) else None
    except (MemoryError, cv2.error) as error:
        raise unreadable(path, error) from error
    if image is None:
        if bytes(data[4:8]) == b"ftyp":
            raise ImageError(
                f"cannot read image {path}: it is HEIC or AVIF; convert it to JPEG or PNG under "
                "the same name, for instance with heif-convert"
            )
        raise ImageError(f"cannot read image {path}: it is damaged or of an unknown format")
    return np.asarray(image, np.uint8)


def alpha_of(data: ByteArray) -> Picture | None:
    """The alpha channel (H, W) in the bytes of an image file; None if all pixels are opaque."""
    # Bytes that hold the head of a PNG file: kind of colours, palette, transparency.
    head = data[:65536].tobytes()
    is_png = head.startswith(PNG)
    if head.startswith(JPEG) or (is_png and head[25] not in (4, 6) and b"tRNS" not in head):
        return None  # decoding takes longer
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except (MemoryError, cv2.error):
        return None  # whoever decodes the colours reports it
    if image is None or image.ndim < 3 or image.shape[2] < 4 or image[..., 3].all():
        return None
    return np.asarray(image[..., 3])


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
