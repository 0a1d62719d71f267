"""Opening of input files; rejects pipes, devices and folders, which could block a run."""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from colmap_edges.errors import ColmapEdgesError, NotAFileError
from colmap_edges.runtime.platform import open_plain

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}

# Exceptions raised for damaged files.
DAMAGE = (
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    OverflowError,
    RecursionError,
)


def open_file(path: Path) -> BinaryIO:
    """Open a regular file to read its bytes.

    Opening a pipe blocks until another process writes, and a device may never end.

    Raises:
        NotAFileError: if the path is not a regular file.
        OSError: if it cannot be opened.
    """
    try:
        descriptor = open_plain(path, os.O_RDONLY, follow=True)
    except OSError as error:
        if error.errno == errno.ENXIO:  # raised for sockets
            raise not_a_file(path, "a socket") from error
        raise
    kind = stat.S_IFMT(os.fstat(descriptor).st_mode)
    if kind != stat.S_IFREG:
        os.close(descriptor)
        raise not_a_file(path, KINDS.get(kind, "something else"))
    return os.fdopen(descriptor, "rb")


def not_a_file(path: Path, kind: str) -> NotAFileError:
    """Make the error for a path that is not a regular file."""
    return NotAFileError(f"{path} is {kind}, not a file; give a regular file")


def read_bytes(path: Path) -> bytes:
    """All bytes of a regular file.

    Raises:
        OSError: if it cannot be read; `NotAFileError` if it is not a regular file.
    """
    with open_file(path) as file:
        return file.read()


def read_text(path: Path) -> str:
    """The text of a regular file in UTF-8.

    Raises:
        OSError: if it cannot be read; `NotAFileError` if it is not a regular file.
        ValueError: if it is not UTF-8.
    """
    return read_bytes(path).decode("utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object written by this package.

    Raises:
        ColmapEdgesError: if it cannot be read or is none.
    """
    try:
        return dict(json.loads(read_text(path)))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise ColmapEdgesError(f"cannot read {path}: {error}") from error
