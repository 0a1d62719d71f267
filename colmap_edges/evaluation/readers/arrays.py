"""Arrays of .npz files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import open_file


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read every array of an .npz file.

    Raises:
        ColmapEdgesError: The file is missing, damaged or holds Python objects.
    """
    try:
        with open_file(path) as file, np.load(file, allow_pickle=False) as data:
            return dict(data)
    except Exception as error:  # the exceptions of NumPy's reader are not documented
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ColmapEdgesError(f"{path} is not a readable .npz of arrays: {reason}") from error
