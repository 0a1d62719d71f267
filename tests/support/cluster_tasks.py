"""What tests have a cluster's workers do: in a module that these can import."""

import os
import signal
import time

from colmap_edges.errors import ColmapEdgesError


def other_version():
    """A version that differs from process to process."""
    return str(os.getpid())


def die_once(marker):
    """Kill the worker that runs this first."""
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return os.getpid()
    os.kill(os.getpid(), signal.SIGKILL)


def die():
    """Kill the worker that runs this."""
    os.kill(os.getpid(), signal.SIGKILL)


def fail_first(index):
    """Raise in the first of several calls that end at nearly the same time."""
    time.sleep(0.001 * (index % 3))
    if index == 0:
        raise ColmapEdgesError("the first")
