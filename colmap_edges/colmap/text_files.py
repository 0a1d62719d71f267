"""Reading of COLMAP's text model files: faults are named by file and line, results are binary.

pycolmap reports faults of text files by its internals, ends image names at their first space, and
needs an empty line after the pose of an image without points.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from colmap_edges.colmap.binary_files import (
    CAMERA_HEAD,
    CAMERA_SENSOR,
    COUNT,
    DATA_ID,
    IMAGE_HEAD,
    MODEL_NAMES,
    NO_POINT3D,
    POINT2D,
    check_listed_images,
    damaged,
)
from colmap_edges.colmap.text_lines import POSE, Line, integer, is_number, lines_of

IMAGE_WORDS = 10  # of a pose: image id, quaternion, translation, camera id, name
POINT3D_WORDS = 8  # before the track: id, position, color, error
REMEDY_OF_TRACKS = (
    "write the model again with its points2D, or delete the points3D and run `colmap "
    "point_triangulator`"
)


@dataclass(frozen=True)
class TextImage:
    """An image of images.txt.

    Attributes:
        line: number of the line of its pose.
        record: its bytes in images.bin.
        point3D_ids: the point3D ids of its points2D, -1 for none.
    """

    line: int
    record: bytes
    point3D_ids: array[int]


def is_text(folder: Path) -> bool:
    """Whether a folder holds a text model."""
    return all((folder / f"{name}.txt").is_file() for name in ("cameras", "images", "points3D"))


def write_as_binary(
    folder: Path, target: Path, camera_models: Mapping[str, tuple[int, int]]
) -> None:
    """Write the text model in `folder` as binary files to `target`.

    Args:
        folder: folder of cameras.txt, images.txt and points3D.txt.
        target: an existing folder.
        camera_models: id and number of parameters by the name of COLMAP's camera models.

    Raises:
        ColmapEdgesError: naming file and line of the first fault.
        OSError: if a file cannot be read or written.
    """
    cameras = cameras_of(lines_of(folder / "cameras.txt"), camera_models)
    has_frames = all((folder / f"{name}.txt").is_file() for name in ("rigs", "frames"))
    lines = lines_of(folder / "images.txt", with_empty=True)
    images = images_of(lines, cameras, folder / "cameras.txt")
    points3D = points3D_of(lines_of(folder / "points3D.txt"), images, folder / "images.txt")
    records = {
        "cameras": list(cameras.values()),
        "images": [image.record for image in images.values()],
        "points3D": points3D,
    }
    if has_frames:
        records["rigs"] = [rig_record(line) for line in lines_of(folder / "rigs.txt")]
        records["frames"] = frame_records(folder / "frames.txt", images)
    for name in MODEL_NAMES:
        if name in records:
            data = COUNT.pack(len(records[name])) + b"".join(records[name])
            (target / f"{name}.bin").write_bytes(data)


def cameras_of(
    lines: Iterator[Line], camera_models: Mapping[str, tuple[int, int]]
) -> dict[int, bytes]:
    """The records of cameras.bin by camera id."""
    cameras: dict[int, bytes] = {}
    for line in lines:
        line.need(4, "a camera's id, model, width, height and parameters")
        camera_id, name = line.whole(0, "camera id"), line.words[1].decode("utf-8", "replace")
        if camera_id in cameras:
            line.fail(f"a second camera has the id {camera_id}; give it another")
        if name not in camera_models:
            line.fail(f"{name!r} is no camera model of COLMAP; convert the camera to one of its")
        model, count = camera_models[name]
        if len(line.words) != 4 + count:
            line.fail(
                f"camera {camera_id} has {len(line.words) - 4} parameters, but {name} needs "
                f"{count}; write the model again"
            )
        size = line.whole(2, "width", 2**63 - 1), line.whole(3, "height", 2**63 - 1)
        params = line.reals(4, count, "camera's parameter")
        cameras[camera_id] = CAMERA_HEAD.pack(camera_id, model, *size) + struct.pack(
            f"<{count}d", *params
        )
    return cameras


def images_of(
    lines: Iterator[Line], cameras: Mapping[int, bytes], cameras_path: Path
) -> dict[int, TextImage]:
    """The images of images.txt by image id; the line of points2D may be missing after a pose.

    Args:
        lines: the lines of images.txt, with empty ones.
        cameras: cameras by id.
        cameras_path: path of cameras.txt, for messages.
    """
    images: dict[int, TextImage] = {}
    line = next_pose(lines)
    while line:
        if len(line.words) < IMAGE_WORDS:
            line.fail(
                f"it has {len(line.words)} values, but the pose of an image needs {IMAGE_WORDS}: "
                "image id, quaternion, translation, camera id and name; write the model again"
            )
        image_id, camera_id = line.whole(0, "image id"), line.whole(8, "camera id")
        if image_id in images:
            line.fail(f"a second image has the id {image_id}; give it another")
        if camera_id not in cameras:
            line.fail(f"camera {camera_id} is not in {cameras_path}; write the model again")
        # Names may have spaces; `maxsplit` leaves the rest of the line as it is.
        name = line.text.split(maxsplit=IMAGE_WORDS - 1)[-1]
        head = IMAGE_HEAD.pack(image_id, *POSE.unpack(line.pose(1)), camera_id) + name + b"\0"
        following = next(lines, None)
        is_next = following is not None and is_pose(following.words)
        points, ids = points2D_of(following) if following and not is_next else (b"", array("q"))
        images[image_id] = TextImage(line.number, head + COUNT.pack(len(ids)) + points, ids)
        line = following if is_next else next_pose(lines)
    return images


def next_pose(lines: Iterator[Line]) -> Line | None:
    """The next line that is not empty."""
    return next((line for line in lines if line.words), None)


def is_pose(words: list[bytes]) -> bool:
    """Whether these are the words of an image's pose, not of points2D, which may be missing.

    A pose has an image id first, a camera id ninth, and then a name, which may have spaces.
    Points2D are three numbers each.
    """
    if len(words) < IMAGE_WORDS or not (words[0].isdigit() and words[8].isdigit()):
        return False
    return len(words) % 3 > 0 or not all(map(is_number, [*words[9:12], words[-1]]))


def points2D_of(line: Line) -> tuple[bytes, array[int]]:
    """The `POINT2D` records of a line of points2D, and their point3D ids, -1 for none."""
    words = line.words
    if len(words) % 3:
        line.fail(
            f"it has {len(words)} values, but points2D have three each: x, y and point3D id; "
            "write the model again"
        )
    try:
        pixels = np.array([words[0::3], words[1::3]], bytes).astype(np.float64)
        ids = array("q", map(int, words[2::3]))
    except (ValueError, OverflowError):
        fail_at_point2D(line)
    records = np.empty(len(ids), POINT2D)
    records["xy"] = pixels.T
    signed = np.frombuffer(ids, np.int64)
    records["point3D_id"] = np.where(signed < 0, NO_POINT3D, signed.astype(np.uint64))
    if not np.isfinite(pixels).all():
        line.fail("a point2D is not finite; write the model again")
    return records.tobytes(), ids


def fail_at_point2D(line: Line) -> NoReturn:
    """Raise the error for a line of points2D with a value that is not a number."""
    for first in range(0, len(line.words), 3):
        line.reals(first, 2, f"pixel of point2D {first // 3}")
        line.number_at(first + 2, f"point3D id of point2D {first // 3}", integer)
    line.fail("a point3D id is too large; write the model again")


def points3D_of(
    lines: Iterator[Line], images: Mapping[int, TextImage], images_path: Path
) -> list[bytes]:
    """The records of points3D.bin; tracks must be of points2D that observe their point.

    Args:
        lines: the lines of points3D.txt.
        images: images by id.
        images_path: path of images.txt, for messages.
    """
    records, known = [], set()
    for line in lines:
        line.need(POINT3D_WORDS, "a point's id, position, color, error and track")
        point3D_id, track = line.whole(0, "point3D id", 2**63 - 1), line.words[POINT3D_WORDS:]
        if point3D_id in known:
            line.fail(f"a second point has the id {point3D_id}; give it another")
        known.add(point3D_id)
        xyz, color = line.reals(1, 3, "position"), [line.whole(i, "color", 255) for i in (4, 5, 6)]
        if not np.isfinite(xyz).all():
            line.fail(f"point3D {point3D_id} is not finite; delete it")
        if len(track) % 2:
            line.fail(
                f"its track has {len(track)} values, but two each are needed: image id and "
                "point2D index; write the model again"
            )
        elements = track_of(line, point3D_id, images, images_path)
        head = (point3D_id, *xyz, *color, *line.reals(7, 1, "error"), len(track) // 2)
        records.append(struct.Struct("<Q3d3BdQ").pack(*head) + elements)
    return records


def track_of(
    line: Line, point3D_id: int, images: Mapping[int, TextImage], images_path: Path
) -> bytes:
    """The track elements of a line of points3D.txt as in points3D.bin."""
    try:
        elements = array("q", map(int, line.words[POINT3D_WORDS:]))
    except (ValueError, OverflowError):
        line.fail("its track has a value that is no image id or point2D index")
    for image_id, index in zip(elements[0::2], elements[1::2], strict=True):
        image = images.get(image_id)
        if image is None:
            line.fail(
                f"the track of point3D {point3D_id} names image {image_id}, which is not in "
                f"{images_path}; delete the image's observations, too"
            )
        if not 0 <= index < len(image.point3D_ids):
            line.fail(
                f"the track of point3D {point3D_id} names point2D {index} of image {image_id}, "
                f"which has {len(image.point3D_ids)} points2D ({images_path}, line {image.line}); "
                f"{REMEDY_OF_TRACKS}"
            )
        if image.point3D_ids[index] != point3D_id:
            line.fail(
                f"the track of point3D {point3D_id} names point2D {index} of image {image_id}, "
                f"which observes point3D {image.point3D_ids[index]} ({images_path}, line "
                f"{image.line}); {REMEDY_OF_TRACKS}"
            )
    return np.frombuffer(elements, np.int64).astype(np.uint32).tobytes()


def rig_record(line: Line) -> bytes:
    """The record of rigs.bin of a line of rigs.txt."""
    line.need(2, "a rig's id and number of sensors")
    rig_id, count = line.whole(0, "rig id"), line.whole(1, "number of sensors")
    record, at = struct.pack("<II", rig_id, count), 2
    for sensor in range(count):
        line.need(at + 2 + (sensor > 0), f"{count} sensors")
        record += struct.pack("<iI", line.sensor(at), line.whole(at + 1, "sensor id"))
        at += 2
        if sensor:  # the first is the reference, whose pose is the rig's
            has_pose = line.whole(at, "mark of a pose", 1)
            line.need(at + 1 + 7 * has_pose, "a sensor's pose")
            record += bytes([has_pose]) + (line.pose(at + 1) if has_pose else b"")
            at += 1 + 7 * has_pose
    return record


def frame_records(path: Path, images: Mapping[int, TextImage]) -> list[bytes]:
    """The records of frames.bin; frames.txt must list the images of images.txt."""
    records, listed = [], set()
    for line in lines_of(path):
        record, image_ids = frame_record(line)
        records.append(record)
        listed |= image_ids
    check_listed_images(path, listed, set(images))
    return records


def frame_record(line: Line) -> tuple[bytes, set[int]]:
    """The record of frames.bin of a line of frames.txt, and the ids of its images."""
    line.need(10, "a frame's id, rig id, pose and number of data ids")
    count = line.whole(9, "number of data ids")
    line.need(10 + 3 * count, f"{count} data ids of three values each")
    ids, image_ids = struct.pack("<II", line.whole(0, "frame id"), line.whole(1, "rig id")), set()
    record = ids + line.pose(2) + struct.pack("<I", count)
    for at in range(10, 10 + 3 * count, 3):
        kind, data_id = line.sensor(at), line.whole(at + 2, "data id")
        record += DATA_ID.pack(kind, line.whole(at + 1, "sensor id"), data_id)
        if kind == CAMERA_SENSOR:
            image_ids.add(data_id)
    return record, image_ids


def check_text_files(folder: Path, num_records: dict[str, int]) -> None:
    """Check that text files of a model hold all records, and complete ones.

    Args:
        folder: folder of the .txt files.
        num_records: records by file name without suffix; an image is two lines, else it is one.

    Raises:
        ColmapEdgesError: if a file is truncated.
    """
    for name, count in num_records.items():
        path = folder / f"{name}.txt"
        with path.open("rb") as file:
            lines = [line[-1:] for line in file if not line.startswith(b"#")]
        if len(lines) != count * (2 if name == "images" else 1) or b"".join(lines).strip(b"\n"):
            raise damaged(path, "it is truncated")
