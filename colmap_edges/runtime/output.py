"""Atomic output: folders and files that appear complete or not at all."""

from __future__ import annotations

import errno
import logging
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import KINDS
from colmap_edges.runtime.ownership import OUTPUT, Kind, check_ours, foreign_entries
from colmap_edges.runtime.platform import is_own

logger = logging.getLogger(__name__)

# Entries of a run's work folder: the lock of the process that uses it, the unfinished output, and
# the output that it replaces.
LOCK, NEW, PREVIOUS = "lock", "new", "previous"


def check_output_path(output: Path, inputs: list[Path], overwrite: bool) -> None:
    """Check that `output` is free or may be replaced, and overlaps no input.

    Raises:
        ColmapEdgesError: otherwise.
    """
    check_apart("output_path", output, inputs)
    with one_line("cannot write to", output):
        check_replaceable(output, OUTPUT, overwrite)


def check_apart(what: str, path: Path, inputs: list[Path]) -> None:
    """Check that `path` overlaps no input; `what` names it in errors.

    Raises:
        ColmapEdgesError: otherwise.
    """
    for source in inputs:
        if path == source or source in path.parents or path in source.parents:
            relation = "the same as" if path == source else "inside or around"
            raise ColmapEdgesError(
                f"{what} {path} is {relation} the input {source}; choose another folder"
            )


def check_replaceable(output: Path, kind: Kind, overwrite: bool) -> None:
    """Check that there is no output yet, or that it may be replaced.

    Raises:
        ColmapEdgesError: otherwise.
        OSError: if the output cannot be inspected.
    """
    check_free(output, overwrite)
    if output.exists() and any(output.iterdir()):
        check_ours(output, kind)


def check_free(output: Path, overwrite: bool) -> None:
    """Check that `output` does not exist, is empty, or is to be overwritten.

    Raises:
        ColmapEdgesError: otherwise.
        OSError: if the output cannot be inspected.
    """
    if not output.parent.is_dir():
        raise ColmapEdgesError(f"cannot write {output}: {output.parent} is not a folder; create it")
    if output.is_symlink():
        raise ColmapEdgesError(
            f"cannot write {output}: it is a link to {output.readlink()}; give the folder itself"
        )
    if not output.exists():
        return
    if not output.is_dir():
        raise ColmapEdgesError(
            f"cannot write {output}: a file of that name exists; choose another folder"
        )
    if os.path.ismount(output):
        raise ColmapEdgesError(
            f"cannot write {output}: it is a mount point; give a folder inside it"
        )
    if any(output.iterdir()) and not overwrite:
        raise ColmapEdgesError(f"{output} exists already; choose another or add --overwrite")


@contextmanager
def one_line(what: str, path: Path) -> Iterator[None]:
    """Turn OSError into a one-line error that starts with `what` and the path."""
    try:
        yield
    except OSError as error:
        raise ColmapEdgesError(f"{what} {path}: {error.strerror or error}") from error


@contextmanager
def new_folder(output: Path, kind: Kind = OUTPUT, overwrite: bool = False) -> Iterator[Path]:
    """Yield a hidden folder next to `output` that replaces it when the block succeeds.

    On an error the hidden folder is removed and `output` is unchanged. Remains of killed runs are
    removed by the next run. Two runs cannot write to the same output at the same time.

    Args:
        output: folder to make.
        kind: determines which files of an existing output are ours; others are not deleted.
        overwrite: replace an existing output.

    Raises:
        ColmapEdgesError: if the folder cannot be made, must not be replaced, or another run
            writes there.
    """
    # Errors of inputs are reported where they are read.
    with one_line("cannot write to", output), work_folder(output, kind) as work:
        check_replaceable(output, kind, overwrite)
        (work / NEW).mkdir()
        yield work / NEW
        check_free(output, overwrite)
        if output.exists():
            output.rename(work / PREVIOUS)
        (work / NEW).rename(output)


@contextmanager
def work_folder(output: Path, kind: Kind) -> Iterator[Path]:
    """Yield the locked work folder next to `output`, after what a killed run left is settled.

    Raises:
        ColmapEdgesError: if another run writes to `output`, or the folder is not this program's.
        OSError: if it cannot be made.
    """
    from filelock import FileLock, Timeout  # which imports much

    work = output.with_name(f".{output.name}.colmap-edges")
    with suppress(FileExistsError):
        work.mkdir()
    check_work(work)
    lock = FileLock(work / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise ColmapEdgesError(
            f"another run is writing to {output}; wait for it or choose another folder"
        ) from None
    try:
        settle(work, output, kind)
        yield work
    finally:
        settle(work, output, kind)
        with suppress(OSError):  # Windows removes it when it is released
            (work / LOCK).unlink()
        lock.release()
        with suppress(OSError):
            work.rmdir()


def check_work(work: Path) -> None:
    """Check that a work folder is empty, or one of this program and user.

    Raises:
        ColmapEdgesError: otherwise.
        OSError: if it cannot be listed.
    """
    status = work.lstat()
    if stat.S_ISDIR(status.st_mode) and is_own(status):
        names = {path.name for path in work.iterdir()}
        if not names or {LOCK} <= names <= {LOCK, NEW, PREVIOUS}:
            return
    raise ColmapEdgesError(
        f"{work} is in the way of the output and not a work folder of yours; move it away"
    )


def settle(work: Path, output: Path, kind: Kind) -> None:
    """Finish the work, complete or not: remove it, or give back what it would have replaced."""
    previous = work / PREVIOUS
    shutil.rmtree(work / NEW, ignore_errors=True)
    try:
        if previous.is_symlink() or not previous.is_dir():
            return
        if os.path.lexists(output):
            discard(previous, output, kind)
        else:
            previous.rename(output)
    except OSError as error:
        logger.warning("cannot remove %s: %s", work, error.strerror)


def discard(previous: Path, output: Path, kind: Kind) -> None:
    """Delete a replaced output; files that this program did not write move to the new one.

    If one cannot be moved there, the replaced output is kept beside the new one.
    """
    try:
        for entry in list(foreign_entries(previous, kind)):
            target = output / entry.relative_to(previous)
            if os.path.lexists(target):
                raise FileExistsError(errno.EEXIST, f"{target} was changed while it was replaced")
            target.parent.mkdir(parents=True, exist_ok=True)
            entry.rename(target)
            logger.warning("%s is kept; it belongs to the earlier output", target)
    except OSError as error:
        kept = output.with_name(f"{output.name}.earlier-{secrets.token_hex(4)}")
        previous.rename(kept)
        logger.warning("%s; the earlier output is kept in %s", error.strerror, kept)
    else:
        previous.rename(previous.with_name(NEW))  # which a run that is killed here leaves to remove
        shutil.rmtree(previous.with_name(NEW), ignore_errors=True)


def write_whole(path: Path, data: bytes, what: str, *, overwrite: bool = True) -> None:
    """Write a file so that it appears complete, or not at all; an earlier one is kept until then.

    Args:
        path: the file.
        data: the content.
        what: name of the file's content in errors.
        overwrite: replace an existing file.

    Raises:
        ColmapEdgesError: if it cannot be written, must not be replaced, or is not a file.
    """
    unfinished = path.parent / f".{secrets.token_hex(16)}.colmap-edges"
    try:
        check_file(path, overwrite)
        if not path.parent.is_dir():
            raise ColmapEdgesError(
                f"cannot write the {what} to {path}: {path.parent} is not a folder; create it"
            )
        with unfinished.open("xb") as file:
            file.write(data)
        check_file(path, overwrite)
        unfinished.replace(path)
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the path
        reason = getattr(error, "strerror", None) or error
        raise ColmapEdgesError(f"cannot write the {what} to {finished(path)}: {reason}") from error
    finally:
        with suppress(OSError, ValueError):
            unfinished.unlink(missing_ok=True)


def check_file(path: Path, overwrite: bool) -> None:
    """Check that there is nothing at `path`, or a file that is to be overwritten.

    Raises:
        ColmapEdgesError: otherwise; links, folders, pipes and devices are never replaced.
        OSError: if the place cannot be inspected.
    """
    try:
        kind = stat.S_IFMT(path.lstat().st_mode)
    except FileNotFoundError:
        return
    if kind == stat.S_IFLNK:
        raise ColmapEdgesError(
            f"cannot write {path}: it is a link to {path.readlink()}; give the file itself"
        )
    if kind != stat.S_IFREG:
        raise ColmapEdgesError(
            f"cannot write {path}: it is {KINDS.get(kind, 'something else')}, not a file; "
            "choose another name"
        )
    if not overwrite:
        raise ColmapEdgesError(f"{path} exists already; choose another path or add --overwrite")


def finished(path: Path) -> str:
    """The place of a file when the run is complete that writes it to a work folder."""
    return re.sub(r"\.([^/\\]+)\.colmap-edges[/\\]new", r"\1", str(path))
