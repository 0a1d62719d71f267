"""Output folders and files that appear whole or not at all."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from colmap_edges.errors import ColmapEdgesError

REPORT_NAME = "report.json"


def check_output_path(output: Path, inputs: list[Path], overwrite: bool) -> None:
    """Check that `output` is free, or ours to replace, and away from every input.

    Raises:
        ColmapEdgesError: otherwise.
    """
    for source in inputs:
        if output == source or source in output.parents or output in source.parents:
            relation = "the same as" if output == source else "inside or around"
            raise ColmapEdgesError(
                f"output_path {output} is {relation} the input {source}; choose a folder apart"
            )
    if not output.parent.is_dir():
        raise ColmapEdgesError(f"cannot write {output}: {output.parent} is no folder; create it")
    if not output.exists():
        return
    if not output.is_dir():
        raise ColmapEdgesError(f"cannot write {output}: a file of that name is there")
    if not any(output.iterdir()):
        return
    if not overwrite:
        raise ColmapEdgesError(f"{output} is there already; choose another or add --overwrite")
    if not (output / REPORT_NAME).is_file():
        raise ColmapEdgesError(
            f"{output} holds no {REPORT_NAME}, so it is no output of colmap-edges and is not "
            "overwritten; choose another folder"
        )


@contextmanager
def new_folder(output: Path) -> Iterator[Path]:
    """Yield a hidden folder beside `output` that takes its place when the block succeeds.

    On an error the hidden folder goes and `output` stays as it was. What a killed run left is
    cleaned by the next one; a second run into the same output at the same time is refused.

    Raises:
        ColmapEdgesError: when the folder cannot be made or another run writes there.
    """
    partial = output.with_name(f".{output.name}.colmap-edges-partial")
    previous = output.with_name(f".{output.name}.colmap-edges-previous")
    try:
        lock = lock_folder(partial, output)
    except OSError as error:
        raise ColmapEdgesError(f"cannot write to {output}: {error.strerror}") from error
    try:
        recover(output, partial, previous)
        yield partial
        replace(output, partial, previous)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        restore(output, previous)
        if isinstance(error, OSError):  # inputs have errors of their own
            reason = error.strerror or error
            raise ColmapEdgesError(f"cannot write to {output}: {reason}") from error
        raise
    finally:
        os.close(lock)


def lock_folder(folder: Path, output: Path) -> int:
    """Make `folder`, lock it, and return the descriptor that holds the lock."""
    while True:
        folder.mkdir(exist_ok=True)
        try:
            descriptor = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue  # another run was just finishing
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(descriptor), folder.stat()):
                return descriptor
        except BlockingIOError:
            os.close(descriptor)
            raise ColmapEdgesError(
                f"another run is writing to {output}; wait for it or choose another folder"
            ) from None
        except FileNotFoundError:
            pass
        os.close(descriptor)


def recover(output: Path, partial: Path, previous: Path) -> None:
    """Undo what a killed run left: its partial files, and an output moved aside."""
    for entry in partial.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()
    restore(output, previous)
    shutil.rmtree(previous, ignore_errors=True)


def restore(output: Path, previous: Path) -> None:
    """Put an output that was moved aside back, when nothing took its place."""
    if previous.exists() and not output.exists():
        previous.rename(output)


def replace(output: Path, partial: Path, previous: Path) -> None:
    """Put the complete `partial` in the place of `output`."""
    if output.exists():
        output.rename(previous)
    partial.rename(output)
    shutil.rmtree(previous, ignore_errors=True)


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
