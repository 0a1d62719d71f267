"""3D edges as files: PLY with `edge` elements, OBJ polylines, JSON with what each edge is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.edges import Edges3D
from colmap_edges.model import Model

PLY_VERTEX = np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3)])
PLY_HEADER = """ply
format binary_little_endian 1.0
comment 3D edges by colmap-edges
element vertex {vertices}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
element edge {edges}
property int vertex1
property int vertex2
end_header
"""


def edge_segments(edges: Edges3D) -> NDArray[np.int32]:
    """Segments (S, 2) between successive edge points; closed edges return to their first."""
    first, last = edges.edge_offsets[:-1], edges.edge_offsets[1:] - 1
    starts = np.arange(edges.num_points)
    ends = starts + 1
    is_last = np.zeros(edges.num_points, bool)
    is_last[last] = True
    ends[last] = first
    loops = np.zeros(edges.num_points, bool)
    loops[last] = edges.closed
    kept = ~is_last | loops
    return np.column_stack([starts, ends])[kept].astype(np.int32)


def edge_lengths(edges: Edges3D) -> NDArray[np.float64]:
    """Length (E,) of each edge, world units."""
    segments = edge_segments(edges)
    lengths = np.linalg.norm(edges.points[segments[:, 1]] - edges.points[segments[:, 0]], axis=1)
    owners = np.repeat(np.arange(edges.num_edges), np.diff(edges.edge_offsets))
    return np.bincount(owners[segments[:, 0]], lengths, edges.num_edges).astype(np.float64)


def write_ply(edges: Edges3D, colors: NDArray[np.uint8], path: Path) -> None:
    """Write a binary PLY with `vertex` and `edge` elements."""
    vertices = np.empty(edges.num_points, PLY_VERTEX)
    vertices["xyz"], vertices["rgb"] = edges.points, colors
    segments = edge_segments(edges)
    header = PLY_HEADER.format(vertices=len(vertices), edges=len(segments))
    path.write_bytes(header.encode() + vertices.tobytes() + segments.astype("<i4").tobytes())


def write_obj(edges: Edges3D, path: Path) -> None:
    """Write an OBJ with one `l` element an edge; closed edges name their first point again."""
    with path.open("w", encoding="ascii") as file:
        file.write("# 3D edges by colmap-edges\n")
        file.writelines("v {!r} {!r} {!r}\n".format(*xyz) for xyz in edges.points.tolist())
        bounds = zip(edges.edge_offsets[:-1], edges.edge_offsets[1:], edges.closed, strict=True)
        for first, last, closed in bounds:
            indices = [*range(first + 1, last + 1), *([first + 1] if closed else [])]
            file.write(f"l {' '.join(map(str, indices))}\n")


def write_json(
    edges: Edges3D,
    model: Model,
    point3D_ids: NDArray[np.int64],
    residuals: NDArray[np.float64],
    path: Path,
) -> None:
    """Write what each edge is, one line an edge.

    Args:
        edges: the edges; an edge's id is its place in them.
        model: the model whose views the tracks name.
        point3D_ids: (N,) ids of the edge points in the written model.
        residuals: (T,) distances of observations from projections, pixels.
        path: file to write.
    """
    records = edge_records(edges, model, point3D_ids, residuals)
    lines = ",\n".join(json.dumps(record, separators=(",", ":")) for record in records)
    path.write_text(f'{{"edges": [\n{lines}\n]}}\n', encoding="utf-8")


def edge_records(
    edges: Edges3D,
    model: Model,
    point3D_ids: NDArray[np.int64],
    residuals: NDArray[np.float64],
) -> list[dict[str, Any]]:
    """One mapping an edge: id, point3D ids, closed, length, views, residual, end nodes."""
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    lengths = edge_lengths(edges)
    records = []
    for edge in range(edges.num_edges):
        first, last = edges.edge_offsets[edge : edge + 2]
        rows = slice(edges.track_offsets[first], edges.track_offsets[last])
        views = np.unique(edges.track_views[rows])
        records.append(
            {
                "id": edge,
                "point3D_ids": point3D_ids[first:last].tolist(),
                "closed": bool(edges.closed[edge]),
                "length": float(lengths[edge]),
                "num_views": len(views),
                "image_ids": image_ids[views].tolist(),
                "residual_px": finite(residuals[rows].mean()) if len(views) else None,
                "end_nodes": edges.end_nodes[edge].tolist(),
            }
        )
    return records


def finite(value: float) -> float | None:
    """`value` rounded to 1e-6, or None where JSON has no number for it."""
    return round(float(value), 6) if np.isfinite(value) else None
