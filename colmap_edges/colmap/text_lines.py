"""Lines of COLMAP's text model files, whose faults are named by file and line."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn, TypeVar

from colmap_edges.colmap.binary_files import CAMERA_SENSOR
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import read_bytes

SENSORS = {b"CAMERA": CAMERA_SENSOR, b"IMU": 1}  # COLMAP's sensor types
POSE = struct.Struct("<7d")

Value = TypeVar("Value")


@dataclass(frozen=True)
class Line:
    """A line of a text file that is not a comment.

    Attributes:
        path: the file.
        number: its number, from 1.
        words: its words.
        text: its text without spaces at the ends.
    """

    path: Path
    number: int
    text: bytes
    words: list[bytes] = field(init=False)

    def __post_init__(self) -> None:
        """Split the line into words."""
        object.__setattr__(self, "words", self.text.split())

    def fail(self, why: str) -> NoReturn:
        """Raise the error for this line."""
        raise ColmapEdgesError(f"{self.path}, line {self.number}: {why}")

    def need(self, count: int, what: str) -> None:
        """Check that the line has at least `count` words."""
        if len(self.words) < count:
            self.fail(f"it has {len(self.words)} values, but needs {what}; write the model again")

    # By default up to the largest id; COLMAP reserves the next.
    def whole(self, at: int, what: str, most: int = 2**32 - 2) -> int:
        """The word `at` as an integer from 0 to `most`."""
        value = self.number_at(at, what, integer)
        if not 0 <= value <= most:
            self.fail(f"the {what} is {value}; it must be an integer from 0 to {most}")
        return value

    def reals(self, first: int, count: int, what: str) -> tuple[float, ...]:
        """`count` words from `first` on as numbers."""
        return tuple(self.number_at(first + i, what, float) for i in range(count))

    def pose(self, first: int) -> bytes:
        """Quaternion and translation from the word `first` on, as in binary files."""
        pose = self.reals(first, 7, "pose")
        if not any(pose[:4]):
            self.fail("the pose has a rotation of zeros; write the model again")
        return POSE.pack(*pose)

    def sensor(self, at: int) -> int:
        """The word `at` as the number of a sensor type."""
        if self.words[at] not in SENSORS:
            self.fail(f"{shown(self.words[at])} is no type of a sensor; it must be CAMERA or IMU")
        return SENSORS[self.words[at]]

    def number_at(self, at: int, what: str, kind: Callable[[bytes], Value]) -> Value:
        """The word `at` as a number."""
        try:
            return kind(self.words[at])
        except (ValueError, OverflowError):
            number = "a number" if kind is float else "an integer"
            self.fail(f"the {what} is {shown(self.words[at])}, which is not {number}")


def shown(word: bytes) -> str:
    """A word in quotes, for messages."""
    return repr(word.decode("utf-8", "backslashreplace"))


def lines_of(path: Path, with_empty: bool = False) -> Iterator[Line]:
    """The lines of a file without comments.

    Args:
        path: the file.
        with_empty: also yield empty lines.

    Raises:
        ColmapEdgesError: if it is not a text of bytes.
    """
    # Editors of Windows write byte order marks.
    data = read_bytes(path).removeprefix(b"\xef\xbb\xbf")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ColmapEdgesError(f"{path} is in UTF-16; save it as UTF-8")
    for number, text in enumerate(data.split(b"\n"), 1):
        line = Line(path, number, text.strip())
        if b"\0" in text:
            line.fail("it has a zero byte, so the file is damaged; write the model again")
        if not text.startswith(b"#") and (with_empty or line.words):
            yield line


def is_number(word: bytes) -> bool:
    """Whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def integer(word: bytes) -> int:
    """A word as an integer, which some programs write as 255.0.

    Raises:
        ValueError: if it is none.
    """
    try:
        return int(word)
    except ValueError:
        value = float(word)
        if not value.is_integer():
            raise
        return int(value)
