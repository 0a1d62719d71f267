"""Data and scripts within the page: arrays as bytes, compressed, read back by page.js."""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import FloatArray

NUM_STEPS = 60_000  # in which a coordinate is given over the length of what is shown
LIFTED = 65535  # instead of a step: no point here, lines are cut
# Types that page.js reads.
TYPES = {"<f4": "f4", "<i4": "i4", "<u2": "u2", "|u1": "u1"}


def coordinates(values: FloatArray) -> dict[str, Any]:
    """Coordinates (N,) as steps of 16 bits over their range; NaN, where lines are cut, stays.

    A coordinate moves by less than 1/100,000 of the range: less than a pixel of the screen.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    step = (high - low) / NUM_STEPS or 1.0
    steps = np.where(np.isfinite(values), np.rint((values - low) / step), LIFTED)
    return {"steps": steps.astype(np.uint16), "low": low, "step": step}


def pack(data: Any) -> bytes:
    """JSON data whose leaves may be flat arrays, as the compressed bytes that page.js reads.

    The bytes are the length of the JSON (4 bytes, little-endian), the JSON, and the arrays. Each
    array stands in the JSON as its type, place and length. Whole numbers are written as
    differences from the one before, and all first bytes before all second ones: both compress.
    """
    parts: list[bytes] = []
    place = 0

    def described(value: Any) -> dict[str, Any]:
        nonlocal place
        if not isinstance(value, np.ndarray):
            raise TypeError(f"{type(value).__name__} cannot be packed")
        little = np.ascontiguousarray(value, value.dtype.newbyteorder("<"))
        entry = {"dtype": TYPES[little.dtype.str], "at": place, "length": little.size}
        parts.append(planes(differences(little.ravel())))
        place += len(parts[-1])
        return entry

    text = json.dumps(data, separators=(",", ":"), allow_nan=False, default=described).encode()
    return compressed(len(text).to_bytes(4, "little") + text + b"".join(parts))


def differences(values: NDArray[Any]) -> NDArray[Any]:
    """Whole numbers as differences from the one before, which wrap; other numbers as they are."""
    if values.dtype.kind == "f":
        return values
    return np.diff(values, prepend=values.dtype.type(0))


def planes(values: NDArray[Any]) -> bytes:
    """All first bytes of the values, then all second ones, and so on."""
    return values.view(np.uint8).reshape(-1, values.dtype.itemsize).T.tobytes()


def compressed(data: bytes) -> bytes:
    """Bytes by gzip, the same at any time."""
    return gzip.compress(data, 6, mtime=0)


def embedded(data: bytes) -> str:
    """Bytes as text that can stand in any element of a page: letters, digits, +, / and =."""
    return base64.b64encode(data).decode("ascii")


def data_uri(kind: str, data: bytes) -> str:
    """A picture within the page."""
    return f"data:image/{kind};base64,{embedded(data)}"
