"""Records of the files that this program wrote to an output folder; others are never deleted."""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.platform import open_plain

PROGRAM = "colmap-edges"


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of output folder.

    Attributes:
        record: name of its JSON file that holds the program, the version and the files.
        kept: expression of the names of entries of other commands, which are kept when the folder
            is replaced.
    """

    record: str
    kept: str = ""


OUTPUT = Kind(record="report.json", kept=r"evaluation|\.evaluation\.colmap-edges")
EVALUATION = Kind(record="evaluation.json")
STRUCTURES = Kind(record="colmap-edges.json")


def file_sizes(folder: Path) -> dict[str, int]:
    """Sizes in bytes of all files below a folder, by relative name, for its record."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_symlink() or not path.is_dir())
    return {path.relative_to(folder).as_posix(): path.lstat().st_size for path in paths}


def files_of(folder: Path, kind: Kind) -> dict[str, int] | None:
    """Sizes of the files that this program wrote into a folder, by name, from its record.

    Returns:
        None if the folder has no record of this program.

    Raises:
        OSError: if the folder cannot be listed.
    """
    try:
        record = read_record(folder / kind.record)
        version, files = record["versions"][PROGRAM], record["files"]
    except (ValueError, KeyError, TypeError):
        return None
    return files if isinstance(version, str) and isinstance(files, dict) else None


def read_record(path: Path) -> Any:
    """Read a record, which must be a regular file.

    Raises:
        ValueError: if it is not a record.
    """
    try:
        descriptor = open_plain(path, os.O_RDONLY, follow=False)
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise ValueError("no file")
            return json.loads(file.read())
    except (OSError, RecursionError) as error:
        raise ValueError(str(error)) from error


def foreign_entries(folder: Path, kind: Kind) -> Iterator[Path]:
    """Entries of a folder that this program did not write, or whose size has changed.

    Yields:
        Files, links and whole folders; those of a folder before those of its own folders.

    Raises:
        OSError: if a folder cannot be listed.
    """
    ours = files_of(folder, kind) or {}
    parents = {str(parent) for name in ours for parent in PurePosixPath(name).parents}
    for place, folders, files in os.walk(folder, onerror=reraise):
        below = Path(place).relative_to(folder)
        inner, folders[:] = folders.copy(), []
        for name in sorted([*inner, *files]):
            relative, status = (below / name).as_posix(), Path(place, name).lstat()
            if stat.S_ISDIR(status.st_mode) and relative in parents:
                folders.append(name)
            elif not stat.S_ISREG(status.st_mode) or (
                ours.get(relative) != status.st_size and relative != kind.record
            ):
                yield folder / relative


def reraise(error: OSError) -> None:
    """Raise the error of a folder that `os.walk` would pass over."""
    raise error


def check_ours(folder: Path, kind: Kind) -> None:
    """Check that a folder was written by this program alone, and can be replaced.

    Raises:
        ColmapEdgesError: naming an entry that cannot be replaced.
        OSError: if a folder cannot be listed.
    """
    if files_of(folder, kind) is None:
        raise ColmapEdgesError(
            f"{folder} holds no {kind.record} of {PROGRAM}, so it is not an output of {PROGRAM} "
            "and is not overwritten; choose another folder"
        )
    for entry in foreign_entries(folder, kind):
        if not re.fullmatch(kind.kept, entry.relative_to(folder).as_posix()):
            raise ColmapEdgesError(
                f"{entry} was not written by {PROGRAM}, or was changed since, so {folder} is not "
                "overwritten; move it away or choose another folder"
            )
    for place, _, _ in os.walk(folder):
        if not os.access(place, os.W_OK | os.X_OK):
            raise ColmapEdgesError(
                f"cannot replace {folder}: {place} is not writable; change its permissions"
            )
