"""Import of the libraries: signals wait, and what keeps them from loading is one line."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from colmap_edges.cli.terminal import HANDLED, handle_signals
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.platform import address_space_mb, signals_deferred

# With 700 MB of address space, OpenBLAS asks for memory for ever while it is loaded; with less, the
# system's loader ends the process.
LEAST_ADDRESS_SPACE_MB = 1000
# OpenCV ends the process, at import or later, if it cannot read a variable.
PROBE = (
    "import cv2, numpy; cv2.cvtColor(numpy.zeros((999, 999, 3), numpy.uint8), cv2.COLOR_BGR2GRAY)"
)


@contextmanager
def importing() -> Iterator[None]:
    """Import libraries within the block; signals are handled after it.

    Signals wait since pycolmap installs handlers, which print the stack and end the process.

    Raises:
        ColmapEdgesError: if a library cannot be loaded.
    """
    check_address_space()
    check_opencv_variables()
    with signals_deferred(HANDLED):
        try:
            yield
        except (ImportError, RuntimeError, OSError) as error:
            raise ColmapEdgesError(
                f"cannot load the libraries ({' '.join(str(error).split())}); raise limits of "
                "memory (ulimit -v), or install colmap-edges again"
            ) from error
        finally:
            handle_signals(HANDLED)


def check_address_space() -> None:
    """Check that the libraries fit into this process's address space.

    Raises:
        ColmapEdgesError: if they do not.
    """
    if (limit := address_space_mb()) < LEAST_ADDRESS_SPACE_MB:
        raise ColmapEdgesError(
            f"the address space is limited to {limit:.0f} MB; allow at least "
            f"{LEAST_ADDRESS_SPACE_MB} MB (ulimit -v)"
        )


def check_opencv_variables() -> None:
    """Check that OpenCV accepts the environment variables that are set for it.

    Raises:
        ColmapEdgesError: naming them, if it ends a process with them.
    """
    names = sorted(name for name in os.environ if name.startswith("OPENCV_"))
    if not names:
        return
    probe = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, check=False)
    if probe.returncode:
        given = ", ".join(f"{name}={os.environ[name]}" for name in names)
        raise ColmapEdgesError(f"OpenCV does not run with {given}; unset what is wrong there")
