"""3D curves of reference files and other programs: points and segments between them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.readers.arrays import read_arrays
from colmap_edges.export.peers import read_lines
from colmap_edges.export.ply import read_ply
from colmap_edges.runtime.input_files import DAMAGE


@dataclass(frozen=True, kw_only=True)
class Curves:
    """A 3D edge graph: points (P, 3) and segments (E, 2) between them.

    Without a segment the points are samples already.
    """

    points: FloatArray
    segments: IntArray

    def lengths(self) -> FloatArray:
        """Length of every segment, (E,)."""
        ends = self.points[self.segments]
        return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))


def load_curves(path: Path) -> Curves:
    """Read curves from .npz (`points`, `edges`) or .ply (`vertex` and optional `edge` elements).

    Raises:
        ColmapEdgesError: The file is missing, unreadable or refers to missing points.
    """
    if not path.is_file():
        raise ColmapEdgesError(f"{path} does not exist; give curves as .ply or .npz")
    if path.suffix == ".npz":
        data = read_arrays(path)
        missing = {"points", "edges"} - set(data)
        if missing:
            raise ColmapEdgesError(f"{path} holds no array {', '.join(sorted(missing))}")
        points, segments = data["points"], data["edges"]
    else:
        elements = read_ply(path)
        points = columns(elements.get("vertex"), ("x", "y", "z"), path)
        segments = np.empty((0, 2), dtype=np.int64)
        if len(elements.get("edge", ())):
            segments = columns(elements["edge"], ("vertex1", "vertex2"), path)
    try:
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        segments = np.asarray(segments, dtype=np.int64).reshape(-1, 2)
    except (ValueError, TypeError) as error:
        raise ColmapEdgesError(
            f"{path}: points must be numbers in rows of three, edges in rows of two"
        ) from error
    if not np.isfinite(points).all():
        raise ColmapEdgesError(f"{path}: a point is not finite")
    if len(segments) and (segments.min() < 0 or segments.max() >= len(points)):
        raise ColmapEdgesError(f"{path}: a segment refers to a point outside 0..{len(points) - 1}")
    return Curves(points=points, segments=segments)


def read_curves(path: Path) -> Curves:
    """Read 3D edges as `load_curves` does, or the lines of Line3D++ or LIMAP.

    Raises:
        ColmapEdgesError: Nothing readable there.
    """
    if path.suffix in (".ply", ".npz"):
        return load_curves(path)
    if not path.exists():
        raise ColmapEdgesError(f"{path} does not exist; give a file of 3D edges")
    try:
        segments = np.concatenate([line.segments for line in read_lines(path)])
    except DAMAGE as error:
        raise ColmapEdgesError(f"{path} holds no readable lines: {error}") from error
    index = np.arange(2 * len(segments)).reshape(-1, 2)
    return Curves(points=segments.reshape(-1, 3), segments=index)


def columns(element: NDArray[Any] | None, names: tuple[str, ...], path: Path) -> NDArray[Any]:
    """Properties `names` of a PLY element as columns (N, len(names))."""
    if element is None or not set(names) <= set(element.dtype.names or ()):
        raise ColmapEdgesError(f"{path} lacks the properties {', '.join(names)}")
    return np.column_stack([element[name] for name in names])
