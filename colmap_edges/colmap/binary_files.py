"""Validation and reading of COLMAP's binary model files without pycolmap.

pycolmap hangs or crashes on some damaged files, and takes seconds where numpy reads in
milliseconds. The formats are simple and fixed.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import (
    IntArray,
    offsets_of,
    ranks_of,
)
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.input_files import open_file, read_bytes

POINT2D = np.dtype([("xy", "<f8", 2), ("point3D_id", "<u8")])
POINT3D = np.dtype(
    [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track_length", "<u8")]
)
TRACK_ELEMENT = np.dtype([("image_id", "<u4"), ("point2D_idx", "<u4")])
IMAGE_HEAD = struct.Struct("<I7dI")  # image id, quaternion, translation, camera id
NO_POINT3D = np.iinfo(np.uint64).max  # id of a point2D without point3D
CAMERA_HEAD = struct.Struct("<IiQQ")  # camera id, model, width, height
COUNT = struct.Struct("<Q")
DATA_ID = struct.Struct("<iIQ")  # of a frame: sensor type, sensor id, data id (of an image)
CAMERA_SENSOR = 0  # COLMAP's type of sensors that are cameras
MODEL_NAMES = ("cameras", "images", "points3D", "rigs", "frames")


@dataclass(frozen=True)
class ImageSpan:
    """Byte range of an image in images.bin; its points2D are at points_start:end."""

    image_id: int
    start: int
    points_start: int
    end: int
    num_points2D: int


@dataclass(frozen=True)
class ModelPoints:
    """The points of a model, as stored in its files.

    Attributes:
        points2D: by image id, (n,) `POINT2D` records of its points2D.
        points3D: (N,) `POINT3D` records, ids ascending.
    """

    points2D: dict[int, NDArray[np.void]]
    points3D: NDArray[np.void]


def check_are_files(folder: Path) -> None:
    """Check that a model's files are regular files; pycolmap blocks on pipes.

    Raises:
        OSError: if one cannot be opened.
    """
    for name, suffix in product(MODEL_NAMES, (".bin", ".txt")):
        if os.path.lexists(folder / (name + suffix)):
            open_file(folder / (name + suffix)).close()


def is_binary(folder: Path) -> bool:
    """Whether a folder holds a binary model, which pycolmap prefers to a text model."""
    return all((folder / f"{name}.bin").is_file() for name in ("cameras", "images", "points3D"))


def read_points(folder: Path) -> ModelPoints:
    """Read the points of the binary model in a folder.

    Raises:
        ColmapEdgesError: if a file is truncated or too long.
    """
    images, points3D = folder / "images.bin", folder / "points3D.bin"
    data = read_bytes(images)
    points2D = points2D_of(data, image_records(data, images))
    data = read_bytes(points3D)
    return ModelPoints(points2D, by_id(gather(data, point3D_records(data, points3D)[0], POINT3D)))


def points2D_of(data: bytes, images: list[ImageSpan]) -> dict[int, NDArray[np.void]]:
    """By image id, (n,) `POINT2D` records in the bytes of images.bin."""
    return {
        image.image_id: np.frombuffer(data, POINT2D, image.num_points2D, image.points_start)
        for image in images
    }


def by_id(heads: NDArray[np.void]) -> NDArray[np.void]:
    """(N,) `POINT3D` records, ids ascending."""
    ids = heads["id"]
    return heads if (ids[1:] > ids[:-1]).all() else heads[np.argsort(ids)]


def read_checked(folder: Path, parameters_of_model: dict[int, int]) -> ModelPoints | None:
    """Check sizes, counts and references of a binary model, and read its points.

    Args:
        folder: folder of cameras.bin, images.bin and points3D.bin.
        parameters_of_model: number of parameters by COLMAP's camera model id.

    Returns:
        The points; None for a text model, which is not checked.

    Raises:
        ColmapEdgesError: if a file is truncated, too long, or has invalid references.
    """
    if not is_binary(folder):
        return None
    check_rigs_and_frames(folder)
    check_small_files(folder, parameters_of_model)
    path = folder / "images.bin"
    data = read_bytes(path)
    images = image_records(data, path)
    points2D = points2D_of(data, images)
    check_image_points(images, points2D, path)
    if (folder / "frames.bin").is_file():
        frames = folder / "frames.bin"
        check_listed_images(frames, check_frames(frames), set(points2D))
    else:
        for image in images:
            check_rotation(IMAGE_HEAD.unpack_from(data, image.start)[1:5], path)
    return ModelPoints(points2D, read_points3D(folder / "points3D.bin", images, points2D))


def check_rigs_and_frames(folder: Path) -> None:
    """Check that there are rigs and frames, or neither.

    Raises:
        ColmapEdgesError: if one is missing.
    """
    rigs, frames = folder / "rigs.bin", folder / "frames.bin"
    if rigs.is_file() != frames.is_file():
        left, missing = (rigs, frames) if rigs.is_file() else (frames, rigs)
        raise ColmapEdgesError(
            f"{left} needs {missing.name} beside it; copy that, too, or delete {left.name}, as "
            "images.bin holds the poses, too"
        )


def check_complete(folder: Path, parameters_of_model: dict[int, int]) -> None:
    """Check that files of a binary model that pycolmap wrote are not truncated.

    `append_points` checks images.bin.

    Raises:
        ColmapEdgesError: if one is.
    """
    check_small_files(folder, parameters_of_model)
    point3D_records(read_bytes(folder / "points3D.bin"), folder / "points3D.bin")


def check_small_files(folder: Path, parameters_of_model: dict[int, int]) -> None:
    """Check the cameras, rigs and frames of a binary model."""
    check_cameras(folder / "cameras.bin", parameters_of_model)
    for name, check in (("rigs", check_rigs), ("frames", check_frames)):
        if (folder / f"{name}.bin").is_file():
            check(folder / f"{name}.bin")


def damaged(path: Path, why: str) -> ColmapEdgesError:
    """Make the error for a damaged file."""
    return ColmapEdgesError(f"{path} is damaged: {why}; copy or write the model again")


class Reader:
    """Reads consecutive little-endian fields and detects truncated files."""

    def __init__(self, path: Path, data: bytes | None = None) -> None:
        """Read the whole file, unless its bytes are given."""
        self.path = path
        self.data = read_bytes(path) if data is None else data
        self.at = 0

    def take(self, layout: struct.Struct) -> tuple[int, ...]:
        """Unpack the next fields."""
        self.skip(layout.size)
        return layout.unpack_from(self.data, self.at - layout.size)

    def skip_text(self) -> None:
        """Move on behind the next zero byte."""
        end = self.data.find(b"\0", self.at)
        self.skip(end + 1 - self.at if end >= 0 else len(self.data) + 1)

    def skip(self, size: int) -> None:
        """Move on by `size` bytes."""
        self.at += size
        if self.at > len(self.data):
            raise damaged(self.path, f"it ends after {len(self.data)} bytes, within a record")

    def end(self) -> None:
        """Check that the end of the file is reached."""
        if self.at != len(self.data):
            raise damaged(self.path, f"{len(self.data) - self.at} bytes follow its last record")


def check_cameras(path: Path, parameters_of_model: dict[int, int]) -> None:
    """Check that cameras.bin holds the stated number of cameras, of known models."""
    reader = Reader(path)
    for _ in range(reader.take(COUNT)[0]):
        camera_id, model, _width, _height = reader.take(CAMERA_HEAD)
        if model not in parameters_of_model:
            raise damaged(path, f"camera {camera_id} has the unknown model {model}")
        reader.skip(8 * parameters_of_model[model])
    reader.end()


def check_rigs(path: Path) -> None:
    """Check that rigs.bin holds the stated numbers of rigs and sensors."""
    reader = Reader(path)
    for _ in range(reader.take(COUNT)[0]):
        num_sensors = reader.take(struct.Struct("<II"))[1]
        reader.skip(8 if num_sensors else 0)  # the reference sensor
        for _ in range(num_sensors - 1):
            has_pose = reader.take(struct.Struct("<iIB"))[2]
            reader.skip(56 if has_pose else 0)
    reader.end()


def check_frames(path: Path) -> set[int]:
    """Check that frames.bin holds the stated numbers of frames and data ids.

    Returns:
        The ids of the images that it lists.
    """
    reader, images = Reader(path), set()
    for _ in range(reader.take(COUNT)[0]):
        frame = reader.take(struct.Struct("<II7dI"))
        check_rotation(frame[2:6], path)
        for _ in range(frame[-1]):
            kind, _, data_id = reader.take(DATA_ID)
            if kind == CAMERA_SENSOR:
                images.add(data_id)
    reader.end()
    return images


def check_listed_images(frames: Path, listed: set[int], image_ids: set[int]) -> None:
    """Check that a frames file lists the images of the images file.

    Raises:
        ColmapEdgesError: if a program that does not know frames has deleted or added images.
    """
    images, rigs = (frames.with_stem(name).name for name in ("images", "rigs"))
    if listed != image_ids:
        gone = sorted(listed - image_ids)
        fault = (
            f"lists image {gone[0]}, which is not in {images}"
            if gone
            else f"does not list image {min(image_ids - listed)}, which is in {images}"
        )
        raise ColmapEdgesError(
            f"{frames} {fault}: a program that does not know frames has changed the model; delete "
            f"{frames.name} and {rigs}, as {images} holds the poses, too"
        )


def check_rotation(quaternion: tuple[float, ...], path: Path) -> None:
    """Check that a quaternion is not zero, which COLMAP silently reads as the identity."""
    if not any(quaternion):
        raise damaged(path, "a pose has a rotation of zeros")


def image_records(data: bytes, path: Path) -> list[ImageSpan]:
    """Find every image in the bytes of images.bin; `path` is for messages.

    Raises:
        ColmapEdgesError: if the data is truncated or too long.
    """
    records, reader = [], Reader(path, data)
    for _ in range(reader.take(COUNT)[0]):
        start = reader.at
        image_id = reader.take(IMAGE_HEAD)[0]
        reader.skip_text()  # the name
        num_points2D = reader.take(COUNT)[0]
        points_start = reader.at
        reader.skip(num_points2D * POINT2D.itemsize)
        records.append(ImageSpan(image_id, start, points_start, reader.at, num_points2D))
    reader.end()
    return records


def check_image_points(
    images: list[ImageSpan], points2D: dict[int, NDArray[np.void]], path: Path
) -> None:
    """Check that image ids are unique and that every point2D is a finite pixel."""
    if len(points2D) != len(images):
        raise damaged(path, "two images have the same id")
    for image_id, points in points2D.items():
        if not np.isfinite(points["xy"]).all():
            raise damaged(path, f"image {image_id} has a point2D that is not finite")


def read_points3D(
    path: Path, images: list[ImageSpan], points2D: dict[int, NDArray[np.void]]
) -> NDArray[np.void]:
    """(N,) `POINT3D` records of points3D.bin, ids ascending; tracks must be of their points2D.

    Raises:
        ColmapEdgesError: if the file is damaged.
    """
    data = read_bytes(path)
    starts, lengths = point3D_records(data, path)
    heads = by_id(gather(data, starts, POINT3D))
    if (heads["id"][1:] == heads["id"][:-1]).any():
        raise damaged(path, "two points have the same id")
    if not np.isfinite(heads["xyz"]).all():
        raise damaged(path, "a point is not finite")
    ids = np.array(sorted((image.image_id, image.num_points2D) for image in images), np.int64)
    ids, counts = np.ascontiguousarray(ids.reshape(-1, 2).T)
    every = np.frombuffer(data, np.uint8)
    fault = _kernels.check_tracks(every, starts, lengths, POINT3D.itemsize, ids, counts)
    if fault:
        named = "an image that is not in images.bin", "a point2D that its image does not have"
        raise damaged(path, f"a track names {named[fault - 1]}")
    check_track_points(path, data, starts, lengths, points2D)
    return heads


def check_track_points(
    path: Path,
    data: bytes,
    starts: IntArray,
    lengths: IntArray,
    points2D: dict[int, NDArray[np.void]],
) -> None:
    """Check that the points2D of tracks observe the points of the tracks.

    Args:
        path: points3D.bin, for messages.
        data: its bytes.
        starts: (N,) offsets of the points in `data`.
        lengths: (N,) track lengths.
        points2D: `POINT2D` records by image id, with all of the tracks' points2D.

    Raises:
        ColmapEdgesError: if one observes another point or none.
    """
    places = np.repeat(starts + POINT3D.itemsize, lengths)
    tracks = gather(data, places + TRACK_ELEMENT.itemsize * ranks_of(lengths), TRACK_ELEMENT)
    owners = np.repeat(gather(data, starts, POINT3D)["id"], lengths)
    image_ids = np.array(sorted(points2D), np.uint32)
    ids = [np.zeros(0, np.uint64), *(points2D[image_id]["point3D_id"] for image_id in image_ids)]
    offsets = offsets_of(np.array([len(of) for of in ids[1:]], np.int64))
    first = offsets[np.searchsorted(image_ids, tracks["image_id"])]
    wrong = np.flatnonzero(np.concatenate(ids)[first + tracks["point2D_idx"]] != owners)
    if len(wrong):
        image_id, index = tracks[wrong[0]].tolist()
        raise damaged(
            path,
            f"the track of point3D {owners[wrong[0]]} names point2D {index} of image {image_id}, "
            "which observes another point or none",
        )


def point3D_records(data: bytes, path: Path) -> tuple[IntArray, IntArray]:
    """(N,) byte offsets of the points in points3D.bin, and their (N,) track lengths."""
    reader = Reader(path, data)
    count, sizes = reader.take(COUNT)[0], (POINT3D.itemsize, TRACK_ELEMENT.itemsize)
    every = np.frombuffer(data, np.uint8)
    starts, lengths, end = _kernels.walk_records(every, reader.at, count, *sizes)
    reader.skip(end - reader.at)
    reader.end()
    return starts, lengths


def gather(data: bytes, offsets: IntArray, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """(N,) records of `dtype` at (N,) byte `offsets` of `data`."""
    if len(offsets) == 0:
        return np.empty(0, dtype)
    count = len(data) - dtype.itemsize + 1  # one record from each byte on, over each other
    every: NDArray[np.void] = np.ndarray(count, dtype, data, strides=1)
    return every[offsets]
