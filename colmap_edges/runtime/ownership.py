"""Records which files of an output folder this program wrote; it never deletes others."""

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
    """A kind of folder that a command writes.

    Attributes:
        record: name of the JSON file in it that names this program, its version, and the files.
        known: names of the files of early versions, whose record lists none.
        kept: names in it that belong to other commands and go over to what replaces it.
    """

    record: str
    known: re.Pattern[str] = NOTHING
    kept: re.Pattern[str] = NOTHING


OUTPUT = Kind(
    record=REPORT_NAME,
    known=re.compile(
        r"sparse/(cameras|images|points3D|rigs|frames)\.(bin|txt)|edges\.(ply|obj|glb|dxf|json)"
        r"|mesh\.(ply|obj|glb)|report\.html|edge_graphs/.+\.npz|overlays/.+\.png",
        re.DOTALL,
    ),
    kept=re.compile(r"evaluation|\.evaluation\.colmap-edges-[0-9a-f]+"),
)
EVALUATION = Kind(record="evaluation.json")


def file_sizes(folder: Path) -> dict[str, int]:
    """Sizes in bytes of all files below a folder, by their names from there on, for its record.

    Raises:
        OSError: when a folder cannot be looked into.
    """
    return {name: status.st_size for name, status in files_below(folder)}


def files_below(folder: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Names from `folder` on of all that is below it but folders, in order; links are not followed.

    Raises:
        OSError: when a folder cannot be looked into.
    """
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        status = entry.stat(follow_symlinks=False)
        if stat.S_ISDIR(status.st_mode):
            for name, found in files_below(folder / entry.name):
                yield f"{entry.name}/{name}", found
        else:
            yield entry.name, status


def files_of(folder: Path, kind: Kind) -> dict[str, int] | None:
    """Sizes of the files that this program wrote into a folder, by name, as its record tells.

    Returns:
        None when the folder has no record by this program.

    Raises:
        OSError: when the folder cannot be looked into.
    """
    try:
        record = read_record(folder / kind.record)
        if not isinstance(record["versions"][PROGRAM], str):
            return None
    except (ValueError, KeyError, TypeError):
        return None
    if "files" not in record:
        found = file_sizes(folder).items()
        return {name: size for name, size in found if kind.known.fullmatch(name)}
    files = record["files"]
    return files if isinstance(files, dict) else None


def read_record(path: Path) -> Any:
    """Read a record; nothing but a plain file is one.

    Raises:
        ValueError: when it is none.
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
    """What is in a folder besides what this program wrote, or has another size by now.

    Args:
        folder: the folder.
        kind: its kind; its record is ours, too.
        ours: sizes of our files by name.

    Yields:
        Files, links and whole folders, first those in `folder` itself.

    Raises:
        OSError: when a folder cannot be looked into.
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
    """Check that all of a folder is ours to replace, and can be.

    Raises:
        ColmapEdgesError: naming what is not.
        OSError: when a folder cannot be looked into.
    """
    ours = files_of(folder, kind)
    if ours is None:
        raise ColmapEdgesError(
            f"{folder} holds no {kind.record} of {PROGRAM}, so it is no output of {PROGRAM} and is "
            "not overwritten; choose another folder"
        )
    for entry in foreign_entries(folder, kind, ours):
        if not kind.kept.fullmatch(entry.relative_to(folder).as_posix()):
            raise ColmapEdgesError(
                f"{entry} is not as {PROGRAM} wrote it, or not by it at all, so {folder} is not "
                "overwritten; move it away or choose another folder"
            )
    for place, _, _ in os.walk(folder):
        if not os.access(place, os.W_OK | os.X_OK):
            raise ColmapEdgesError(f"cannot replace {folder}: {place} cannot be written to")
