"""Lengths and polylines of 3D edges, and their export as OBJ."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.runtime.output import write_whole


def edge_lengths(edges: Edges3D) -> FloatArray:
    """Length (E,) of each edge, world units."""
    segments = edges.segments
    lengths = np.linalg.norm(edges.points[segments[:, 1]] - edges.points[segments[:, 0]], axis=1)
    owners = edges.edge_ids
    return np.bincount(owners[segments[:, 0]], lengths, edges.num_edges).astype(np.float64)


@checked
def write_obj(edges: Edges3D, path: Path, *, overwrite: bool = True) -> None:
    """Write an OBJ with one `l` element per edge; closed edges repeat their first point.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    lines = ["# 3D edges by colmap-edges\n", formatted("v %.15g %.15g %.15g\n", edges.points)]
    for indices in polyline_indices(edges):
        lines.append(f"l {' '.join(map(str, (indices + 1).tolist()))}\n")
    write_whole(path, "".join(lines).encode("ascii"), "edges", overwrite=overwrite)


def formatted(line: str, rows: FloatArray | Int32Array) -> str:
    """The rows formatted by a template line, all at once for speed."""
    return line * len(rows) % tuple(rows.ravel().tolist())


def polyline_indices(edges: Edges3D) -> Iterator[IntArray]:
    """The point indices of each edge; those of closed edges end with the first point."""
    bounds = zip(edges.edge_offsets[:-1], edges.edge_offsets[1:], edges.closed, strict=True)
    for first, last, closed in bounds:
        yield np.append(np.arange(first, last), [first] if closed else []).astype(np.int64)
