"""Arrays of .npz files."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.errors import ColmapEdgesError


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read every array of an .npz file.

    Raises:
        ColmapEdgesError: The file is missing, damaged or holds Python objects.
    """
    known = (OSError, EOFError, ValueError, MemoryError, zipfile.BadZipFile, zlib.error)
    try:
        with np.load(path, allow_pickle=False) as data:
            return dict(data)
    except (*known, NotImplementedError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ColmapEdgesError(f"{path} is not a readable .npz of arrays: {reason}") from error
