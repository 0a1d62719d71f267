"""Export of 3D edges as OBJ, and what is common to all such files."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array
from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.similarity import Y_UP, to_z_up
from colmap_edges.export.units import metres
from colmap_edges.export.upright import direction
from colmap_edges.runtime.output import write_whole

TURN = "# rotation of this file from the model, row by row:"


@checked
def write_obj(
    edges: Edges3D,
    path: Path | str,
    *,
    up: Any = "z",
    unit: str = "",
    overwrite: bool = True,
) -> None:
    """Write an OBJ with one group `edge_N` per edge, and one `l` element per segment.

    Many programs read only the first segment of longer elements.

    Args:
        edges: the edges.
        path: file to write.
        up: upward direction, an axis such as "-y" or (3,) numbers; it becomes y, as programs
            expect of OBJ.
        unit: unit of the coordinates, such as "mm", named in the file; empty if unknown.
        overwrite: replace an existing file.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    turn = y_up_from(up)
    points = formatted("v %.15g %.15g %.15g\n", edges.points @ turn.T)
    lines = ["# 3D edges by colmap-edges\n", obj_header(turn, unit), points]
    pairs = edges.segments + 1
    of_edges = np.searchsorted(pairs[:, 0], edges.edge_offsets, "right")
    for edge, (first, last) in enumerate(pairwise(of_edges.tolist())):
        lines += [f"g edge_{edge}\n", formatted("l %d %d\n", pairs[first:last])]
    write_whole(Path(path), "".join(lines).encode("ascii"), "edges", overwrite=overwrite)


def y_up_from(up: Any) -> FloatArray:
    """(3, 3) the rotation that makes an upward direction y; see `upright.direction`."""
    return np.asarray(Y_UP @ to_z_up(direction(up)))


def obj_header(turn: FloatArray, unit: str) -> str:
    """Comments of an OBJ that tell how it stands; `turn` is the rotation from the model."""
    rows = " ".join(f"{value:.17g}" for value in turn.ravel())
    metres(unit)
    return f"# y is up, unit {unit or 'unknown'}\n{TURN} {rows}\n"


def formatted(line: str, rows: FloatArray | Int32Array) -> str:
    """The rows formatted by a template line, all at once for speed."""
    return line * len(rows) % tuple(rows.ravel().tolist())
