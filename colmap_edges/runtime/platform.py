"""Functions that depend on the operating system, each with a fallback.

Availability is checked at call time, so that tests can simulate other systems.
"""

from __future__ import annotations

import ctypes
import errno
import math
import os
import signal
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

resource: ModuleType | None
try:
    import resource
except ImportError:  # Windows
    resource = None


def c_function(name: str) -> Any:
    """A function of the C library; None if it is not available."""
    try:
        return getattr(ctypes.CDLL(None), name, None)
    except (OSError, TypeError):  # not possible on Windows
        return None


def ending_signals() -> list[int]:
    """The signals that users and systems send to end a program."""
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


@contextmanager
def signals_deferred(numbers: Collection[int]) -> Iterator[None]:
    """Hold back signals of this thread, the only one so far, until the block ends, if possible."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def address_space_mb() -> float:
    """The limit of this process's address space (`ulimit -v`) in megabytes, infinite if none."""
    if resource is None or not hasattr(resource, "RLIMIT_AS"):
        return math.inf
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return math.inf if limit == resource.RLIM_INFINITY else limit / 1e6


def open_plain(path: Path, flags: int, *, follow: bool) -> int:
    """Open a file without blocking on a pipe or device.

    Args:
        path: the file.
        flags: as of os.open, such as os.O_RDONLY.
        follow: whether links are followed.

    Raises:
        OSError: if it cannot be opened, or is a link and `follow` is false.
    """
    if not follow and not hasattr(os, "O_NOFOLLOW") and path.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    names = ["O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY", "O_NOINHERIT"]
    names += [] if follow else ["O_NOFOLLOW"]
    for name in names:
        flags |= getattr(os, name, 0)
    return os.open(path, flags)


def is_own(status: os.stat_result) -> bool:
    """Whether a file belongs to this user; always true on systems without file owners."""
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def reset_peak_memory() -> None:
    """Reset the kernel's record of this process's peak memory, if supported."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def peak_memory_mb() -> float:
    """Peak resident memory in megabytes since the last reset or the start; 0 if unknown."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        if resource is None:
            return 0.0
        unit = 1e6 if sys.platform == "darwin" else 1e3
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit)
    kilobytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    return int(kilobytes) / 1e3
