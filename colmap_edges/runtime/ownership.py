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

REPORT_NAME = "report.json"
PROGRAM = "colmap-edges"
NOTHING = re.compile(r"(?!)")


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of output folder.

    Attributes:
        record: name of its JSON file that holds the program, the version and the files.
        kept: names of entries of other commands, which are kept when the folder is replaced.
    """

    record: str
    kept: re.Pattern[str] = NOTHING


OUTPUT = Kind(
    record=REPORT_NAME, kept=re.compile(r"evaluation|\.evaluation\.colmap-edges-[0-9a-f]+")
)
EVALUATION = Kind(record="evaluation.json")
STRUCTURES = Kind(record="colmap-edges.json")


def file_sizes(folder: Path) -> dict[str, int]:
    """Sizes in bytes of all files below a folder, by relative name, for its record.

    Raises:
        OSError: if a folder cannot be listed.
    """
    return {name: status.st_size for name, status in files_below(folder)}


def files_below(folder: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Sorted relative names of all files below `folder`; links are not followed.

    Raises:
        OSError: if a folder cannot be listed.
    """
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        status = entry.stat(follow_symlinks=False)
        if stat.S_ISDIR(status.st_mode):
            for name, found in files_below(folder / entry.name):
                yield f"{entry.name}/{name}", found
        else:
            yield entry.name, status


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


def foreign_entries(folder: Path, kind: Kind, ours: dict[str, int]) -> Iterator[Path]:
    """Entries of a folder that this program did not write, or whose size has changed.

    Args:
        folder: the folder.
        kind: its kind; its record counts as ours.
        ours: sizes of our files by name.

    Yields:
        Files, links and whole folders, starting with those in `folder` itself.

    Raises:
        OSError: if a folder cannot be listed.
    """
    folders = {str(parent) for name in ours for parent in PurePosixPath(name).parents}

    def walk(below: str) -> Iterator[Path]:
        inner = []
        for entry in sorted(os.scandir(folder / below), key=lambda entry: entry.name):
            name = f"{below}/{entry.name}" if below else entry.name
            status = entry.stat(follow_symlinks=False)
            if stat.S_ISDIR(status.st_mode) and name in folders:
                inner.append(name)
            elif not stat.S_ISREG(status.st_mode) or (
                name != kind.record and ours.get(name) != status.st_size
            ):
                yield folder / name
        for name in inner:
            yield from walk(name)

    return walk("")


def check_ours(folder: Path, kind: Kind) -> None:
    """Check that a folder was written by this program alone, and can be replaced.

    Raises:
        ColmapEdgesError: naming an entry that cannot be replaced.
        OSError: if a folder cannot be listed.
    """
    ours = files_of(folder, kind)
    if ours is None:
        raise ColmapEdgesError(
            f"{folder} holds no {kind.record} of {PROGRAM}, so it is not an output of {PROGRAM} "
            "and is not overwritten; choose another folder"
        )
    for entry in foreign_entries(folder, kind, ours):
        if not kind.kept.fullmatch(entry.relative_to(folder).as_posix()):
            raise ColmapEdgesError(
                f"{entry} was not written by {PROGRAM}, or was changed since, so {folder} is not "
                "overwritten; move it away or choose another folder"
            )
    for place, _, _ in os.walk(folder):
        if not os.access(place, os.W_OK | os.X_OK):
            raise ColmapEdgesError(
                f"cannot replace {folder}: {place} is not writable; change its permissions"
            )
