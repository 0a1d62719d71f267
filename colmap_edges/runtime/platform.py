"""What differs from system to system, each with a path for systems that lack it.

Everything here asks at the time of the call whether the system has the function, so that a test
can take it away.
"""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

fcntl: ModuleType | None
msvcrt: Any
resource: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None
try:
    import msvcrt
except ImportError:  # everything else
    msvcrt = None
try:
    import resource
except ImportError:  # Windows
    resource = None

LOCKED_BYTE = 1 << 30  # far behind what a lock file holds: Windows keeps others from locked bytes
LOCK_INTERVAL_S = 0.05


def c_function(name: str) -> Any:
    """A function of the C library; None where there is none of that name, or no way to ask."""
    try:
        return getattr(ctypes.CDLL(None), name, None)
    except (OSError, TypeError):  # Windows has no library that stands for the program itself
        return None


def ending_signals() -> list[int]:
    """The signals by which users and systems end a program."""
    names = ("SIGINT", "SIGTERM", "SIGHUP")
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


def open_plain(path: Path, flags: int, *, follow: bool) -> int:
    """Open a file without waiting for a pipe or a device in its place.

    Args:
        path: the file.
        flags: how, such as os.O_RDONLY.
        follow: whether it may be a link.

    Raises:
        OSError: when it cannot be opened, or is a link that is not to be followed.
    """
    if not follow and not hasattr(os, "O_NOFOLLOW") and path.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    names = ["O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY", "O_NOINHERIT"]
    names += [] if follow else ["O_NOFOLLOW"]
    for name in names:
        flags |= getattr(os, name, 0)
    return os.open(path, flags)


def make_own(path: Path) -> int:
    """Make a file that only this user may read and write, and open it.

    Raises:
        OSError: when there is one already, or it cannot be made.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
    return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o600)


def is_own(status: os.stat_result) -> bool:
    """Whether a file is this user's; on systems without owners of files, all are."""
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def lock(descriptor: int) -> None:
    """Lock an open file for this program; waits for whoever has it."""
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        return
    while True:
        try:
            return try_lock(descriptor)
        except BlockingIOError:
            time.sleep(LOCK_INTERVAL_S)


def try_lock(descriptor: int) -> None:
    """Lock an open file for this program; the lock goes when the file is closed.

    Raises:
        BlockingIOError: when another program has it.
    """
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    elif msvcrt is not None:
        place = os.lseek(descriptor, 0, os.SEEK_CUR)
        os.lseek(descriptor, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from error
        finally:
            os.lseek(descriptor, place, os.SEEK_SET)


def removes_open_files() -> bool:
    """Whether files can be removed, and folders renamed, while a program has them open."""
    return os.name != "nt"


def reset_peak_memory() -> None:
    """Let the kernel count this process's peak memory anew, where it can."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def peak_memory_mb() -> float:
    """Peak resident memory in megabytes since the last reset, or the start; 0 if none can tell."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        if resource is None:
            return 0.0
        unit = 1e6 if sys.platform == "darwin" else 1e3
        return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit)
    kilobytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    return int(kilobytes) / 1e3
