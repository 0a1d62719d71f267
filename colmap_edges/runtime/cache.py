"""Cache of results on disk, keyed by a digest of everything that they depend on.

The key includes images, poses, options, this package's code and the versions of its libraries.
Entries are therefore never outdated, and the folder can be deleted at any time.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import re
import stat
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import read_bytes

logger = logging.getLogger(__name__)

Arrays = dict[str, NDArray[Any]]
Record = TypeVar("Record")
HEAD_LENGTH = struct.Struct("<Q")
ALIGNMENT = 16  # bytes at multiples of which arrays start
DIGEST_BYTES = hashlib.sha256().digest_size
NOT_AN_ENTRY = (
    *(ColmapEdgesError, KeyError, ValueError, TypeError),
    *(OverflowError, RecursionError, struct.error),
)
FORGOTTEN_S = 24 * 3600  # unfinished files older than this were left by killed runs


class Cache:
    """Arrays in a folder, by kind and key; safe for concurrent processes."""

    def __init__(self, folder: Path) -> None:
        """Use `folder`, created if missing; it may be read-only.

        Raises:
            ColmapEdgesError: if it cannot be created or read.
        """
        self.folder = folder
        self.has_warned = False
        self.unfinished = folder / "unfinished"
        try:
            make_own_folder(self.unfinished)
            remove_forgotten(self.unfinished)
        except OSError as error:
            if error.errno == errno.ELOOP or not can_be_entered(folder):
                raise ColmapEdgesError(f"cannot use cache {folder}: {error.strerror}") from error

    def path(self, kind: str, key: str) -> Path:
        """The path of an entry."""
        return self.folder / kind / key[:2] / f"{key}.entry"

    def load(self, kind: str, key: str, read: Callable[[Arrays], Record]) -> Record | None:
        """The result that `read` decodes from an entry; None if it is missing or damaged.

        The checksum reveals damage, but not who wrote the entry. `read` therefore checks the arrays
        and raises one of `NOT_AN_ENTRY` if they cannot be the result for this key.
        """
        path = self.path(kind, key)
        try:
            data = read_bytes(path)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            logger.warning("cannot read cache entry %s (%s); it is made again", path, error)
            return None
        with suppress(OSError):  # of another user, or read-only
            os.utime(path)  # marks the entry as recently used
        if seal(kind, key, memoryview(data)[DIGEST_BYTES:]) == data[:DIGEST_BYTES]:
            with suppress(*NOT_AN_ENTRY):
                return read(unpacked(bytearray(data)[DIGEST_BYTES:]))
        logger.warning("cache entry %s is damaged; it is made again", path)
        return None

    def save(self, kind: str, key: str, arrays: Arrays) -> bool:
        """Write arrays as an entry, atomically; returns False, with a warning, on failure."""
        data = packed(arrays)
        path = self.path(kind, key)
        unfinished = self.unfinished / uuid4().hex
        try:
            make_own_folder(path.parent.parent)
            make_own_folder(path.parent)
            with unfinished.open("xb") as file:
                file.write(seal(kind, key, data))
                file.write(data)
            unfinished.replace(path)
        except OSError as error:
            with suppress(OSError):  # read-only folders also refuse to remove missing files
                unfinished.unlink()
            return self.not_kept(path, error)
        return True

    def not_kept(self, path: Path, error: OSError) -> bool:
        """Warn once that entries cannot be written."""
        level = logging.DEBUG if self.has_warned else logging.WARNING
        self.has_warned = True
        logger.log(
            level,
            "cannot write cache entry %s (%s); the run continues without it",
            path,
            error.strerror,
        )
        return False


def packed(arrays: Arrays) -> bytes:
    """Names, types and shapes of arrays as JSON, and their bytes; npz is five times slower."""
    rows = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
    head = json.dumps(rows).encode()
    parts = [HEAD_LENGTH.pack(len(head)), head, *(array.tobytes() for array in arrays.values())]
    return b"".join(part + bytes(-len(part) % ALIGNMENT) for part in parts)


def unpacked(data: bytearray) -> Arrays:
    """The inverse of `packed`; arrays share the memory of `data`.

    Raises:
        ValueError, TypeError, OverflowError, RecursionError, struct.error: if the bytes are not
            from `packed`.
    """
    (length,) = HEAD_LENGTH.unpack_from(data)
    at = ALIGNMENT + length + -length % ALIGNMENT
    arrays: Arrays = {}
    for name, kind, shape in json.loads(data[ALIGNMENT : ALIGNMENT + length]):
        if not re.fullmatch("[<|=>][biufU][0-9]+", kind):
            raise ValueError("only numbers and text are read: bytes of objects would be addresses")
        array: NDArray[Any] = np.ndarray(shape, np.dtype(kind), data, at)
        arrays[name] = array
        at += array.nbytes + -array.nbytes % ALIGNMENT
    return arrays


def can_be_entered(folder: Path) -> bool:
    """Whether files in a folder can be opened by name."""
    try:
        os.stat(f"{folder}/.")  # noqa: PTH116, as a Path drops the dot
    except OSError:
        return False
    return True


def seal(kind: str, key: str, data: bytes | memoryview) -> bytes:
    """The checksum at the start of an entry, which reveals damage."""
    found = hashlib.sha256(f"{kind} {key} ".encode())
    found.update(data)
    return found.digest()


def make_own_folder(folder: Path) -> None:
    """Make a folder of the cache; links are rejected, since they may lead to other folders.

    Raises:
        OSError: if the folder cannot be made or is a link.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if folder.is_symlink():
        raise OSError(errno.ELOOP, f"{folder} is a link")


def remove_forgotten(folder: Path) -> None:
    """Remove unfinished entries of killed runs; files with other names stay."""
    for path in folder.iterdir():
        try:
            status = path.lstat()
            ours = stat.S_ISREG(status.st_mode) and re.fullmatch("[0-9a-f]{32}", path.name)
            if ours and time.time() - status.st_mtime > FORGOTTEN_S:
                path.unlink()
        except OSError:
            continue  # another run was faster


def key_of(*parts: Any) -> str:
    """The key of a result computed from `parts` by this version of the code.

    Args:
        parts: bytes, arrays, dataclasses of options, and values that JSON can hold.
    """
    found = hashlib.sha256(code_version().encode())
    for part in parts:
        kind, data = described(part)
        found.update(f"{kind} {len(data)}\n".encode())
        found.update(data)
    return found.hexdigest()


def described(part: Any) -> tuple[str, bytes]:
    """Type and bytes of a part of a key."""
    if isinstance(part, bytes):
        return "bytes", part
    if isinstance(part, np.ndarray):
        return f"{part.dtype.str} {part.shape}", part.tobytes()
    plain = asdict(part) if is_dataclass(part) and not isinstance(part, type) else part
    return "json", json.dumps(plain, sort_keys=True).encode()


@cache
def code_version() -> str:
    """Digest of this package's code and the versions of its numerical libraries.

    Any change of the code changes the digest, since its effect on results is unknown.
    """
    package = Path(__file__).parents[1]
    found = hashlib.sha256()
    for path in sorted([*package.rglob("*.py"), *package.glob("kernels/_kernels*")]):
        name = path.relative_to(package).as_posix()
        found.update(f"{name} ".encode() + hashlib.sha256(path.read_bytes()).digest())
    for name in ("numpy", "scipy", "opencv-contrib-python-headless", "pycolmap"):
        found.update(f"{name} {library_version(name)}\n".encode())
    return found.hexdigest()


def library_version(name: str) -> str:
    """Version of a library; empty if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
