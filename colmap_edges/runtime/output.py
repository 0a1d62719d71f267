"""Atomic output: folders and files that appear complete or not at all."""

from __future__ import annotations

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
from colmap_edges.runtime import platform
from colmap_edges.runtime.input_files import KINDS
from colmap_edges.runtime.ownership import (
    OUTPUT,
    Kind,
    check_ours,
    files_below,
    files_of,
    foreign_entries,
)

logger = logging.getLogger(__name__)

# Entries of a run's work folder: the lock that identifies its owner, the unfinished output, and
# the output that it replaces.
LOCK, NEW, PREVIOUS = "lock", "new", "previous"
HIDDEN = re.compile(r"\.([^/\\]+)\.colmap-edges-[0-9a-f]{32}[/\\]" + NEW)  # unfinished output


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
    """Yield a locked work folder next to `output`, after removing those of killed runs.

    Raises:
        ColmapEdgesError: if another run writes to `output`.
        OSError: if it cannot be made.
    """
    work, lock = make_work_folder(output)
    try:
        for other in abandoned(output, work):
            settle(other, output, kind)
        yield work
    finally:
        lock = released_to_remove(lock)
        settle(work, output, kind)
        released(lock)


def make_work_folder(output: Path) -> tuple[Path, int]:
    """Make a folder with a random name; returns it and the descriptor of its lock."""
    while True:
        token = secrets.token_hex(16)
        work = output.with_name(f".{output.name}.colmap-edges-{token}")
        work.mkdir()
        try:
            lock = platform.make_own(work / LOCK)
        except FileNotFoundError:
            continue  # another run took it for that of a killed run
        try:
            platform.lock(lock)
            os.write(lock, lock_text(token))
        except OSError:
            os.close(lock)
            remove_empty(work)
            raise
        if (work / LOCK).exists():
            return work, lock
        os.close(lock)


def remove_empty(work: Path) -> None:
    """Remove a work folder without contents."""
    with suppress(OSError):
        (work / LOCK).unlink(missing_ok=True)
        work.rmdir()


def lock_text(token: str) -> bytes:
    """The content of the lock file in the work folder with `token` in its name."""
    return f"colmap-edges {token}\n".encode()


def abandoned(output: Path, own: Path) -> Iterator[Path]:
    """Work folders next to `output` left by killed runs, each locked while it is yielded.

    Only folders of this user with a lock file of this program count; links do not.

    Raises:
        ColmapEdgesError: if a running process holds the lock of one.
    """
    pattern = re.compile(re.escape(f".{output.name}.colmap-edges-") + "([0-9a-f]{32})")
    for entry in list(os.scandir(output.parent)):
        found = pattern.fullmatch(entry.name)
        work = output.with_name(entry.name)
        if not found or work == own or not entry.is_dir(follow_symlinks=False):
            continue
        if not platform.is_own(entry.stat(follow_symlinks=False)):
            continue
        try:
            lock = platform.open_plain(work / LOCK, os.O_RDWR, follow=False)
        except OSError:
            with suppress(OSError):
                work.rmdir()  # killed before it contained anything
            continue
        try:
            platform.try_lock(lock)
            text = os.read(lock, 100)
            if text == lock_text(found[1]):
                lock = released_to_remove(lock)
                yield work
            elif not text:
                lock = released_to_remove(lock)
                remove_empty(work)
        except BlockingIOError:
            raise ColmapEdgesError(
                f"another run is writing to {output}; wait for it or choose another folder"
            ) from None
        finally:
            released(lock)


def released_to_remove(lock: int) -> int:
    """Close a lock where open files cannot be removed; returns -1 if it is closed.

    Another run may then remove the same folder, too, which does no harm.
    """
    return lock if platform.removes_open_files() else released(lock)


def released(lock: int) -> int:
    """Close a lock unless it is closed already (-1)."""
    if lock >= 0:
        os.close(lock)
    return -1


def settle(work: Path, output: Path, kind: Kind) -> None:
    """Finish a work folder, complete or not, and remove it.

    An output that was moved aside is restored if nothing replaced it. Otherwise its files are
    deleted, and files that this program did not write move to the new output.
    """
    try:
        previous = work / PREVIOUS
        moved = previous.is_dir() and not previous.is_symlink()
        if moved and not os.path.lexists(output):
            previous.rename(output)
        elif moved:
            discard(previous, output, kind)
        shutil.rmtree(work / NEW, ignore_errors=True)
        if [path.name for path in work.iterdir()] == [LOCK]:  # removed last
            (work / LOCK).unlink()
            work.rmdir()
    except FileNotFoundError:
        return  # another run was faster
    except OSError as error:
        logger.warning("cannot remove %s: %s", work, error.strerror)


def discard(earlier: Path, output: Path, kind: Kind) -> None:
    """Delete our files of a replaced output; all others move to `output`."""
    ours = files_of(earlier, kind) or {}
    for entry in list(foreign_entries(earlier, kind, ours)):
        target = output / entry.relative_to(earlier)
        if os.path.lexists(target):
            logger.warning("%s was changed while it was replaced; it is kept in %s", target, entry)
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        entry.rename(target)
        logger.warning("%s is kept; it belongs to the earlier output", target)
    for name, status in list(files_below(earlier)):
        if ours.get(name) == status.st_size:
            (earlier / name).unlink()
    for folder, _, _ in os.walk(earlier, topdown=False):
        if Path(folder) != earlier:
            Path(folder).rmdir()
    (earlier / kind.record).unlink(missing_ok=True)  # last, since it lists our files
    earlier.rmdir()


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
    return HIDDEN.sub(r"\1", str(path))
