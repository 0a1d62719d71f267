"""Output folders and files that appear whole or not at all."""

from __future__ import annotations

import logging
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime import platform
from colmap_edges.runtime.ownership import (
    OUTPUT,
    Kind,
    check_ours,
    files_below,
    files_of,
    foreign_entries,
)

logger = logging.getLogger(__name__)

# In the work folder of a run: the lock that says whose it is, the output in the making, and the
# one that it replaces.
LOCK, NEW, PREVIOUS = "lock", "new", "previous"


def check_output_path(output: Path, inputs: list[Path], overwrite: bool) -> None:
    """Check that `output` is free, or ours to replace, and away from every input.

    Raises:
        ColmapEdgesError: otherwise.
    """
    check_apart("output_path", output, inputs)
    with one_line("cannot write to", output):
        check_replaceable(output, OUTPUT, overwrite)


def check_apart(what: str, path: Path, inputs: list[Path]) -> None:
    """Check that `path`, which `what` names in errors, is away from every input.

    Raises:
        ColmapEdgesError: otherwise.
    """
    for source in inputs:
        if path == source or source in path.parents or path in source.parents:
            relation = "the same as" if path == source else "inside or around"
            raise ColmapEdgesError(
                f"{what} {path} is {relation} the input {source}; choose a folder apart"
            )


def check_replaceable(output: Path, kind: Kind, overwrite: bool) -> None:
    """Check that there is no output yet, or one that may be replaced.

    Raises:
        ColmapEdgesError: otherwise.
        OSError: when that cannot be told.
    """
    check_free(output, overwrite)
    if output.exists() and any(output.iterdir()):
        check_ours(output, kind)


def check_free(output: Path, overwrite: bool) -> None:
    """Check that at `output` there is nothing, an empty folder, or one to overwrite.

    Raises:
        ColmapEdgesError: otherwise.
        OSError: when that cannot be told.
    """
    if not output.parent.is_dir():
        raise ColmapEdgesError(f"cannot write {output}: {output.parent} is no folder; create it")
    if output.is_symlink():
        raise ColmapEdgesError(
            f"cannot write {output}: it is a link to {output.readlink()}; give the folder itself"
        )
    if not output.exists():
        return
    if not output.is_dir():
        raise ColmapEdgesError(f"cannot write {output}: a file of that name is there")
    if os.path.ismount(output):
        raise ColmapEdgesError(f"cannot write {output}: it is a mount point; give a folder in it")
    if any(output.iterdir()) and not overwrite:
        raise ColmapEdgesError(f"{output} is there already; choose another or add --overwrite")


@contextmanager
def one_line(what: str, path: Path) -> Iterator[None]:
    """Turn errors of the system into one line that begins with `what` and the path."""
    try:
        yield
    except OSError as error:
        raise ColmapEdgesError(f"{what} {path}: {error.strerror or error}") from error


@contextmanager
def new_folder(output: Path, kind: Kind = OUTPUT, overwrite: bool = False) -> Iterator[Path]:
    """Yield a hidden folder beside `output` that takes its place when the block succeeds.

    On an error the hidden folder goes and `output` stays as it was. What a killed run left is
    cleaned by the next one; a second run into the same output at the same time is refused.

    Args:
        output: folder to make.
        kind: says which files in an earlier one are ours; others are not deleted.
        overwrite: replace an earlier one.

    Raises:
        ColmapEdgesError: when the folder cannot be made, is not ours to replace, or another run
            writes there.
    """
    # Inputs have errors of their own.
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
    """Yield a locked folder of this run beside `output`, after clearing up those of killed runs.

    Raises:
        ColmapEdgesError: when another run writes to `output`.
        OSError: when there can be none.
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
    """Make a folder of a name that nobody guesses; give it and the descriptor of its lock."""
    while True:
        token = secrets.token_hex(16)
        work = output.with_name(f".{output.name}.colmap-edges-{token}")
        work.mkdir()
        try:
            lock = platform.make_own(work / LOCK)
        except FileNotFoundError:
            continue  # another run took it for one that a killed run left
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
    """Remove a work folder in which nothing was begun."""
    with suppress(OSError):
        (work / LOCK).unlink(missing_ok=True)
        work.rmdir()


def lock_text(token: str) -> bytes:
    """What the lock in the work folder of a name with `token` holds."""
    return f"colmap-edges {token}\n".encode()


def abandoned(output: Path, own: Path) -> Iterator[Path]:
    """Work folders beside `output` that killed runs left, each locked until the next is asked for.

    Only folders of this user with a lock by this program are: no links, and nothing else of the
    same name.

    Raises:
        ColmapEdgesError: when a living run holds one.
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
                work.rmdir()  # killed before there was anything in it
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
    """Close a lock before its file is removed, where open files cannot be; -1 if it is closed.

    A run that begins then may take the folder for abandoned too; of two that remove it one is
    faster, and the other does not mind.
    """
    return lock if platform.removes_open_files() else released(lock)


def released(lock: int) -> int:
    """Close a lock that may be closed already, -1."""
    if lock >= 0:
        os.close(lock)
    return -1


def settle(work: Path, output: Path, kind: Kind) -> None:
    """End the work in a work folder, complete or not, and remove it.

    An output that was moved aside comes back when nothing took its place; otherwise its files are
    deleted, and what this program did not write goes over to the new one.
    """
    try:
        previous = work / PREVIOUS
        moved = previous.is_dir() and not previous.is_symlink()
        if moved and not os.path.lexists(output):
            previous.rename(output)
        elif moved:
            discard(previous, output, kind)
        shutil.rmtree(work / NEW, ignore_errors=True)
        if [path.name for path in work.iterdir()] == [LOCK]:  # which goes last
            (work / LOCK).unlink()
            work.rmdir()
    except FileNotFoundError:
        return  # another run was faster
    except OSError as error:
        logger.warning("cannot remove %s: %s", work, error.strerror)


def discard(earlier: Path, output: Path, kind: Kind) -> None:
    """Delete our files of an output that `output` replaced; the others go over to `output`."""
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
    (earlier / kind.record).unlink(missing_ok=True)  # last, for it says what is ours
    earlier.rmdir()


def write_whole(path: Path, data: bytes, what: str) -> None:
    """Write the whole file or none.

    Args:
        path: the file.
        data: all of it.
        what: names it in errors.

    Raises:
        ColmapEdgesError: when it cannot be written.
    """
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as file:
            temporary = Path(file.name)
            file.write(data)
        temporary.chmod(0o666 & ~current_umask())
        temporary.replace(path)
    except OSError as error:
        raise ColmapEdgesError(f"cannot write the {what} to {path}: {error}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def current_umask() -> int:
    """The process's umask, which can only be read by setting it."""
    umask = os.umask(0o022)
    os.umask(umask)
    return umask
