"""Scalar elements of PLY files, such as the `edge` element that mesh readers reject or drop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import read_bytes

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_Element = tuple[str, int, list[tuple[str, str]]]


def read_ply(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Read elements `names` as structured arrays, one field a property.

    Elements of lists (faces) may only follow the elements asked for.

    Raises:
        ColmapEdgesError: The file is not a PLY, is cut short or has lists where none can be read.
    """
    content = read_bytes(path)
    end = content.find(b"end_header")
    if not content.startswith(b"ply") or end < 0:
        raise ColmapEdgesError(f"{path} is not a PLY file")
    header = content[:end].decode("ascii", "replace").splitlines()
    try:
        order, elements = _parse_header(header, path)
    except (ValueError, IndexError) as error:
        raise ColmapEdgesError(f"{path} has a damaged PLY header: {error}") from error
    body = content[end:].partition(b"\n")[2]
    tables: dict[str, NDArray[Any]] = {}
    position, lines = 0, body.splitlines() if order == "ascii" else []
    for name, count, properties in elements:
        if set(names) <= set(tables):
            break
        if any(kind == "list" for _, kind in properties):
            if count:
                break
            continue
        fields = [(field, _ORDERS[order] + _TYPES[kind]) for field, kind in properties]
        try:
            dtype = np.dtype(fields)
            if order == "ascii":
                rows = [tuple(line.split()) for line in lines[position : position + count]]
                tables[name] = np.array(rows, dtype=dtype)
                position += count
            else:
                tables[name] = np.frombuffer(body, dtype, count, position)
                position += count * dtype.itemsize
        except (ValueError, OverflowError) as error:
            raise ColmapEdgesError(f"{path} is damaged in element '{name}': {error}") from error
        if len(tables[name]) != count:
            raise ColmapEdgesError(f"{path} is cut short in element '{name}'")
    return tables


def _parse_header(lines: list[str], path: Path) -> tuple[str, list[_Element]]:
    order = ""
    elements: list[_Element] = []
    for line in lines:
        words = line.split()
        if words[:1] == ["format"]:
            order = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"] and elements:
            elements[-1][2].append((words[-1], words[1]))
    known = {"list", *_TYPES}
    if order not in _ORDERS or any(kind not in known for e in elements for _, kind in e[2]):
        raise ColmapEdgesError(f"{path} has a PLY header this reader does not know")
    return order, elements
