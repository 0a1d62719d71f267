#!/usr/bin/env python3
"""Mesh a scene as a user would, and keep the meshes and edges: product.py SCENE OUTPUT.npz.

It runs in a process of its own, with the package that PYTHONPATH names, so it uses nothing but the
public functions of the package.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class NoMesh(NamedTuple):
    """A mesh of nothing."""

    vertices: Any = np.empty((0, 3))
    faces: Any = np.empty((0, 3))


NO_MESH = NoMesh()


def main(scene: Path, output: Path) -> None:
    import colmap_edges

    seconds, last = {}, time.process_time()
    sparse, found = scene / "sparse", {}

    def keep(name: str, mesh: Any = None) -> None:
        nonlocal last
        seconds[name], last = time.process_time() - last, time.process_time()
        if mesh is not None:
            found[f"{name}_vertices"] = np.asarray(mesh.vertices, np.float32)
            found[f"{name}_faces"] = np.asarray(mesh.faces, np.int32)

    try:
        keep("sfm", colmap_edges.mesh(sparse))
    except colmap_edges.ColmapEdgesError:  # too few points, which edges can make up for
        keep("sfm", NO_MESH)
    result = colmap_edges.reconstruct(sparse, scene / "images")
    keep("reconstruct")
    sparse = getattr(result, "model", sparse)  # earlier versions have none
    curves = {"contours": result.contours, "background": result.background}
    keep("edges", colmap_edges.mesh(sparse, result.edges, **curves))
    curves["faces"] = result.faces
    keep("faces", colmap_edges.mesh(sparse, result.edges, **curves))
    if hasattr(result, "patches"):  # not in versions without them
        curves["patches"] = result.patches
    keep("patches", colmap_edges.mesh(sparse, result.edges, **curves))
    edges = result.edges
    found |= {
        "edge_points": edges.points,
        "edge_segments": segments_of(edges.edge_offsets, edges.closed),
        "seconds": np.array([seconds[name] for name in seconds]),
    }
    with output.open("wb") as file:
        np.savez_compressed(file, **found)


def segments_of(offsets: Any, closed: Any) -> Any:
    """Segments (S, 2) between the points of polylines."""
    parts = [np.empty((0, 2), np.int64)]
    for first, end, is_closed in zip(offsets[:-1], offsets[1:], closed, strict=True):
        points = np.arange(first, end)
        parts.append(np.column_stack([points[:-1], points[1:]]))
        if is_closed and len(points):
            parts.append(np.array([[end - 1, first]]))
    return np.concatenate(parts)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
