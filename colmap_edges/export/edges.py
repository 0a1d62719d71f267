"""Export of 3D edges: polylines as PLY and OBJ, attributes and curves as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray
from colmap_edges.core.checks import check_shape, checked
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.export.curve_records import curve_records
from colmap_edges.runtime.output import write_whole

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


def edge_lengths(edges: Edges3D) -> FloatArray:
    """Length (E,) of each edge, world units."""
    segments = edges.segments
    lengths = np.linalg.norm(edges.points[segments[:, 1]] - edges.points[segments[:, 0]], axis=1)
    owners = edges.edge_ids
    return np.bincount(owners[segments[:, 0]], lengths, edges.num_edges).astype(np.float64)


@checked
def write_ply(edges: Edges3D, path: Path, *, overwrite: bool = True) -> None:
    """Write a binary PLY with `vertex` and `edge` elements.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    vertices = np.empty(edges.num_points, PLY_VERTEX)
    vertices["xyz"], vertices["rgb"] = edges.points, edges.colors
    segments = edges.segments
    header = PLY_HEADER.format(vertices=len(vertices), edges=len(segments))
    data = header.encode() + vertices.tobytes() + segments.astype("<i4").tobytes()
    write_whole(path, data, "edges", overwrite=overwrite)


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


@checked
def write_json(
    edges: Edges3D,
    curves: Curves3D,
    model: Model,
    point3D_ids: IntArray,
    residuals: FloatArray,
    path: Path,
) -> None:
    """Write edges, nodes and curves as JSON, one line each.

    Args:
        edges: the edges; an edge's id is its index.
        curves: the curves that they consist of.
        model: the model whose views the tracks refer to.
        point3D_ids: (N,) ids of the edge points in the written model.
        residuals: (T,) distances of observations from projections, pixels.
        path: file to write.

    Raises:
        ColmapEdgesError: if the file cannot be written, or arguments do not belong together.
    """
    edges.check("edges", len(model.views))
    curves.check("curves", edges)
    check_shape("point3D_ids", point3D_ids.shape, ("N",), {"N": edges.num_points})
    check_shape("residuals", residuals.shape, ("T",), {"T": len(edges.observations.views)})
    parts = {
        "edges": edge_records(edges, model, point3D_ids, residuals),
        "nodes": node_records(edges, model, point3D_ids),
        "curves": curve_records(curves, edges.edge_offsets),
    }
    encode = json.JSONEncoder(separators=(",", ":")).encode
    lists = (
        f'"{name}": [\n' + ",\n".join(map(encode, records)) + "\n]"
        for name, records in parts.items()
    )
    write_whole(path, ("{" + ",\n".join(lists) + "}\n").encode(), "edges")


def edge_records(
    edges: Edges3D,
    model: Model,
    point3D_ids: IntArray,
    residuals: FloatArray,
) -> list[dict[str, Any]]:
    """One mapping per edge: id, point3D ids, closed, length, views, residual, end nodes, sigmas."""
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    lengths = edge_lengths(edges)
    records = []
    for edge in range(edges.num_edges):
        first, last = edges.edge_offsets[edge : edge + 2]
        rows = slice(edges.observations.offsets[first], edges.observations.offsets[last])
        views = np.unique(edges.observations.views[rows])
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
                "sigmas": [short(sigma) for sigma in edges.sigmas[first:last].tolist()],
            }
        )
    return records


def node_records(edges: Edges3D, model: Model, point3D_ids: IntArray) -> list[dict[str, Any]]:
    """One mapping per node: id, point3D id, position, deviation, views, ends, edge through.

    An end is an edge's id with 0 for its first and 1 for its last point. The edge passing through
    is given by its id and the index of the node among its points.
    """
    nodes, node_ids = edges.nodes, edges.node_ids
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    ids = np.full(len(nodes.points), -1, np.int64)
    ids[node_ids[node_ids >= 0]] = point3D_ids[node_ids >= 0]
    met = edges.end_nodes.ravel()
    order = np.argsort(met, kind="stable")
    bounds = np.searchsorted(met[order], np.arange(len(ids) + 1))
    records = []
    for node, through in enumerate(nodes.through_points.tolist()):
        ends = order[bounds[node] : bounds[node + 1]]
        rows = slice(*nodes.observations.offsets[node : node + 2])
        edge = int(np.searchsorted(edges.edge_offsets, through, "right")) - 1
        passing = [edge, through - int(edges.edge_offsets[edge])]
        records.append(
            {
                "id": node,
                "point3D_id": int(ids[node]),
                "xyz": nodes.points[node].tolist(),
                "sigma": float(nodes.sigmas[node]),
                "image_ids": np.unique(image_ids[nodes.observations.views[rows]]).tolist(),
                "ends": [[int(end) // 2, int(end) % 2] for end in ends],
                "through": passing if through >= 0 else None,
            }
        )
    return records


def finite(value: float) -> float | None:
    """`value` rounded to 1e-6; None if it is not finite."""
    return round(float(value), 6) if np.isfinite(value) else None


def short(value: float) -> float | None:
    """`value` to three digits; None if it is not finite."""
    return float(f"{value:.3g}") if np.isfinite(value) else None
