"""Elements of PLY files, such as the `edge` element that mesh readers reject or drop."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import read_bytes


def read_ply(path: Path) -> dict[str, NDArray[Any]]:
    """Read the elements of a PLY file as structured arrays, one field a property.

    Raises:
        ColmapEdgesError: The file is not a PLY, or damaged; or plyfile is not installed.
    """
    content = read_bytes(path)
    try:
        from plyfile import PlyData
    except ImportError as error:
        raise ColmapEdgesError(
            "reading PLY files needs plyfile; pip install 'colmap-edges[evaluation]'"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of NaN, which readers check
            elements = PlyData.read(BytesIO(content)).elements
    except Exception as error:  # the exceptions of plyfile's parser are not documented
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ColmapEdgesError(f"{path} is not a readable PLY file: {reason}") from error
    return {element.name: np.array(element.data) for element in elements}
