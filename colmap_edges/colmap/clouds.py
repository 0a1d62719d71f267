"""Reading of dense point clouds: PLY files, COLMAP's .vis files and OpenMVS's lists of views."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import (
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    blocks,
    offsets_of,
    ranges_of,
)
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import read_bytes

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
BLOCK = 1_000_000  # points or numbers that are handled at once, which bounds memory
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


class SeenRows(NamedTuple):
    """The images that see each point, as CSR.

    Attributes:
        offsets: (N + 1,) int64; the images of point i are images[offsets[i]:offsets[i + 1]].
        images: (T,) int32 indices in the order of the model that the cloud was made from.
    """

    offsets: IntArray
    images: Int32Array


class CloudFile(NamedTuple):
    """The content of a point cloud's files.

    Attributes:
        points: (N, 3) float64, world units; some may not be finite.
        colors: (N, 3) uint8; black if the file has none.
        seen: the images that see each point; None if the files do not say.
    """

    points: FloatArray
    colors: ByteArray
    seen: SeenRows | None


class Property(NamedTuple):
    """A property of a PLY's vertices; `length` is the type of a list's length, or empty."""

    name: str
    kind: str
    length: str


def image_names(reconstruction: Any) -> list[str]:
    """Names of a model's images with poses, in the order in which files of clouds count them."""
    return [reconstruction.images[image_id].name for image_id in reconstruction.reg_image_ids()]


def read_visibility(path: Path) -> SeenRows:
    """Read COLMAP's fused.ply.vis.

    It holds a 64-bit number of points, and of each point a 32-bit number of images and their 32-bit
    indices.

    Raises:
        ColmapEdgesError: if it cannot be read or is damaged.
    """
    data = read_bytes(path)
    words = np.frombuffer(data, "<u4", len(data) // 4)
    count = int(np.frombuffer(data, "<u8", 1)[0]) if len(data) >= 8 else -1
    if len(data) % 4 or not 0 <= count <= len(words):
        raise ColmapEdgesError(f"{path} is no visibility of a point cloud; give a fused.ply.vis")
    starts = track_starts(path, words, count)
    is_image = np.ones(len(words), bool)
    is_image[:2] = is_image[starts] = False
    return SeenRows(offsets_of(words[starts].astype(np.int64)), words[is_image].astype(np.int32))


def track_starts(path: Path, words: NDArray[np.uint32], count: int) -> IntArray:
    """(count,) places of the numbers of images among the words of a file of visibility.

    Raises:
        ColmapEdgesError: if they do not end where the file ends.
    """
    starts, row, end = np.empty(count, np.int64), 0, 2
    for part in blocks(len(words), BLOCK):  # as a list, which is read faster, but is large
        lengths = words[part].tolist()
        while end < part.stop and row < count:
            starts[row] = end
            end += 1 + lengths[end - part.start]
            row += 1
    if row < count or end != len(words):
        raise damaged(path, row, count)
    return starts


def damaged(path: Path, row: int, count: int) -> ColmapEdgesError:
    """The error for a file whose size does not fit its number of points."""
    return ColmapEdgesError(
        f"{path} is damaged: its size does not fit {count:,} points, as read up to point "
        f"{row:,}; copy it again or make it again"
    )


def read_cloud(path: Path) -> CloudFile:
    """Read a point cloud: the vertices of a PLY file of COLMAP, OpenMVS or any other program.

    OpenMVS's list `view_indices` tells which images see a point.

    Raises:
        ColmapEdgesError: if it cannot be read, is damaged or has no coordinates.
    """
    data = read_bytes(path)
    order, count, properties, start = read_header(path, data)
    names = [entry.name for entry in properties]
    if not {"x", "y", "z"} <= set(names):
        raise ColmapEdgesError(f"{path} has no vertices with x, y and z; give a point cloud")
    if order == "=":
        columns, seen = ascii_columns(path, data[start:], count, properties), None
    else:
        columns, seen = binary_columns(path, data[start:], count, properties, order)
    points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
    colors = np.zeros((count, 3), np.uint8)
    if {"red", "green", "blue"} <= set(names):
        rgb = np.column_stack([columns[name] for name in ("red", "green", "blue")])
        scale = 255 if rgb.dtype.kind == "f" and rgb.max(initial=0) <= 1 else 1
        colors = np.clip(np.nan_to_num(rgb * scale), 0, 255).astype(np.uint8)
    return CloudFile(points, colors, seen)


def read_header(path: Path, data: bytes) -> tuple[str, int, list[Property], int]:
    """The byte order ("=" for text), number and properties of vertices, and where they begin.

    Raises:
        ColmapEdgesError: if it is no PLY, or other elements come before the vertices.
    """
    end = re.search(rb"end_header\r?\n", data[:100_000])
    if not data.startswith(b"ply") or not end:
        raise ColmapEdgesError(f"{path} is not a PLY file; convert the cloud to PLY")
    lines = data[: end.start()].decode("ascii", "replace").splitlines()
    words = [line.split() for line in lines if line.split()]
    order = next((ORDERS.get(w[1], "") for w in words if w[0] == "format" and len(w) > 1), "")
    elements = [at for at, w in enumerate(words) if w[0] == "element"]
    first = words[elements[0]] if elements else []
    if not order or len(first) != 3 or first[1] != "vertex" or not first[2].isdecimal():
        raise ColmapEdgesError(f"{path}: its header names no format or no vertices; mend it")
    last = elements[1] if len(elements) > 1 else len(words)
    properties = []
    for at in range(elements[0] + 1, last):
        if words[at][0] == "property":
            properties.append(read_property(path, words[at]))
    return order, int(first[2]), properties, end.end()


def read_property(path: Path, words: Sequence[str]) -> Property:
    """A property from the words of its line.

    Raises:
        ColmapEdgesError: if it has an unknown type.
    """
    *kinds, name = [word for word in words[1:] if word != "list"]
    if len(kinds) != 1 + (words[1] == "list") or any(kind not in TYPES for kind in kinds):
        raise ColmapEdgesError(f"{path}: cannot read {' '.join(words)!r} in its header; mend it")
    return Property(name, TYPES[kinds[-1]], TYPES[kinds[0]] if len(kinds) > 1 else "")


def ascii_columns(
    path: Path, data: bytes, count: int, properties: Sequence[Property]
) -> dict[str, FloatArray]:
    """The columns of a PLY in text.

    Raises:
        ColmapEdgesError: if it is damaged, or has lists.
    """
    if any(entry.length for entry in properties):
        raise ColmapEdgesError(f"{path} is text with lists; convert it to a binary PLY")
    words = data.split(None, count * len(properties))[: count * len(properties)]
    try:
        values = np.array(words, np.float64).reshape(count, len(properties))
    except ValueError as error:
        raise damaged(path, len(words) // max(len(properties), 1), count) from error
    return {entry.name: values[:, at] for at, entry in enumerate(properties)}


def binary_columns(
    path: Path, data: bytes, count: int, properties: Sequence[Property], order: str
) -> tuple[dict[str, NDArray[Any]], SeenRows | None]:
    """The columns of a binary PLY, and the images of OpenMVS's list.

    Rows with lists differ in size: a first pass finds where their parts begin.

    Raises:
        ColmapEdgesError: if it is damaged.
    """
    parts, row_bytes = split_at_lists(properties, order)
    starts = part_starts(path, data, count, parts, row_bytes, order)
    if starts is None:
        table = np.frombuffer(data, parts[0][0], count)
        return {name: table[name] for name in table.dtype.names or ()}, None
    content, seen = np.frombuffer(data, np.uint8), None
    columns: dict[str, NDArray[Any]] = {}
    for at, (dtype, listed) in enumerate(parts):
        table = gathered(content, starts[:, at], dtype)
        columns |= {name: table[name] for name in dtype.names or ()}
        # OpenMVS's list property.
        if listed and listed.name == "view_indices":
            kinds = np.dtype(order + listed.length), np.dtype(order + listed.kind)
            seen = listed_rows(content, starts[:, at] + dtype.itemsize, *kinds)
    return columns, seen


def gathered(content: ByteArray, starts: IntArray, dtype: np.dtype[Any]) -> NDArray[Any]:
    """(N,) values of a type that begin at (N,) places of bytes."""
    values = np.empty((len(starts), dtype.itemsize), np.uint8)
    for rows in blocks(len(starts), BLOCK):
        values[rows] = content[starts[rows, None] + np.arange(dtype.itemsize)]
    return values.view(dtype)[:, 0] if dtype.itemsize else np.zeros(len(starts), dtype)


def listed_rows(
    content: ByteArray, starts: IntArray, length: np.dtype[Any], kind: np.dtype[Any]
) -> SeenRows:
    """Lists of images that begin with their lengths, at (N,) places of bytes."""
    numbers = gathered(content, starts, length).astype(np.int64)
    starts = starts + length.itemsize
    parts = [np.zeros(0, np.int32)]
    for rows in blocks(len(starts), BLOCK):
        ends = starts[rows] + numbers[rows] * kind.itemsize
        images = content[ranges_of(starts[rows], ends)].view(kind)
        parts.append(images.astype(np.int32))
    return SeenRows(offsets_of(numbers), np.concatenate(parts))


def split_at_lists(
    properties: Sequence[Property], order: str
) -> tuple[list[tuple[np.dtype[Any], Property | None]], int]:
    """Parts of properties of fixed size, each with the list after it, and the least row size."""
    parts: list[tuple[np.dtype[Any], Property | None]] = []
    fixed: list[tuple[str, str]] = []
    for entry in properties:
        if entry.length:
            parts.append((np.dtype(fixed), entry))
            fixed = []
        else:
            fixed.append((entry.name, order + entry.kind))
    parts.append((np.dtype(fixed), None))
    least = sum(dtype.itemsize for dtype, _ in parts)
    return parts, least + sum(np.dtype(e.length).itemsize for _, e in parts if e)


def part_starts(
    path: Path,
    data: bytes,
    count: int,
    parts: Sequence[tuple[np.dtype[Any], Property | None]],
    row_bytes: int,
    order: str,
) -> IntArray | None:
    """(N, B) byte at which each part of each row begins; None without lists, row after row.

    Raises:
        ColmapEdgesError: if the data ends before.
    """
    if count * row_bytes > len(data):
        raise damaged(path, len(data) // max(row_bytes, 1), count)
    if len(parts) == 1:
        return None
    starts, end = np.empty((count, len(parts)), np.int64), 0
    byte_order = "little" if order == "<" else "big"
    sizes = [
        (d.itemsize, np.dtype(e.length).itemsize, np.dtype(e.kind).itemsize) if e else
        (d.itemsize, 0, 0)
        for d, e in parts
    ]  # fmt: skip
    for row in range(count):
        for at, (fixed, head, item) in enumerate(sizes):
            starts[row, at] = end
            end += fixed
            if head:
                end += head + item * int.from_bytes(data[end : end + head], byte_order)  # type: ignore[arg-type]
        if end > len(data):
            raise damaged(path, row, count)
    return starts
