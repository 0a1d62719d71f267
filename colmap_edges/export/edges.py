"""3D edges as files: PLY, OBJ, GLB and DXF for other programs, JSON with what each edge is."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import ByteArray, Float32Array, FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D

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
GLB_HEAD = struct.Struct("<4sII")  # magic, version, length of all
GLB_CHUNK = struct.Struct("<I4s")  # length, kind
# Groups of a code and its value, a line each.
DXF_START = "0\nSECTION\n2\nENTITIES\n"
DXF_POLYLINE = "0\nPOLYLINE\n8\nEDGES\n66\n1\n70\n{}\n"  # 70: 8 is 3D, 1 closed
DXF_VERTEX = "0\nVERTEX\n8\nEDGES\n70\n32\n10\n%.12g\n20\n%.12g\n30\n%.12g\n"
DXF_END_OF_POLYLINE = "0\nSEQEND\n"
DXF_END = "0\nENDSEC\n0\nEOF\n"


def edge_lengths(edges: Edges3D) -> FloatArray:
    """Length (E,) of each edge, world units."""
    segments = edges.segments
    lengths = np.linalg.norm(edges.points[segments[:, 1]] - edges.points[segments[:, 0]], axis=1)
    owners = edges.edge_ids
    return np.bincount(owners[segments[:, 0]], lengths, edges.num_edges).astype(np.float64)


def write_ply(edges: Edges3D, path: Path) -> None:
    """Write a binary PLY with `vertex` and `edge` elements."""
    vertices = np.empty(edges.num_points, PLY_VERTEX)
    vertices["xyz"], vertices["rgb"] = edges.points, edges.colors
    segments = edges.segments
    header = PLY_HEADER.format(vertices=len(vertices), edges=len(segments))
    path.write_bytes(header.encode() + vertices.tobytes() + segments.astype("<i4").tobytes())


def write_obj(edges: Edges3D, path: Path) -> None:
    """Write an OBJ with one `l` element an edge; closed edges name their first point again."""
    with path.open("w", encoding="ascii") as file:
        file.write("# 3D edges by colmap-edges\n")
        file.write(formatted("v %.12g %.12g %.12g\n", edges.points))
        for indices in polyline_indices(edges):
            file.write(f"l {' '.join(map(str, (indices + 1).tolist()))}\n")


def formatted(line: str, rows: FloatArray) -> str:
    """A line, with a place for each column, for each of the rows; all at once, which is fast."""
    return line * len(rows) % tuple(rows.ravel().tolist())


def polyline_indices(edges: Edges3D) -> Iterator[IntArray]:
    """The edge points of each edge in turn; closed edges return to their first."""
    bounds = zip(edges.edge_offsets[:-1], edges.edge_offsets[1:], edges.closed, strict=True)
    for first, last, closed in bounds:
        yield np.append(np.arange(first, last), [first] if closed else []).astype(np.int64)


def write_glb(edges: Edges3D, path: Path) -> None:
    """Write a binary glTF with lines, each edge in the mean colour of its points.

    World coordinates are kept, in float32 as the format has it. Without edges nothing is written,
    as the format knows no empty scene.
    """
    if edges.num_edges == 0:
        return
    ids, segments = edges.edge_ids, edges.segments
    sums = np.column_stack(
        [np.bincount(ids, channel, edges.num_edges) for channel in edges.colors.T]
    )
    rgba = np.full((edges.num_edges, 4), 255, np.uint8)
    rgba[:, :3] = np.rint(sums / np.bincount(ids, minlength=edges.num_edges)[:, None])
    corners = edges.points.astype("<f4")[segments.ravel()]
    shades = np.repeat(rgba[ids[segments[:, 0]]], 2, axis=0)
    head = json.dumps(glb_document(corners, shades), separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    body = corners.tobytes() + shades.tobytes()
    length = GLB_HEAD.size + 2 * GLB_CHUNK.size + len(head) + len(body)
    chunks = [GLB_CHUNK.pack(len(head), b"JSON"), head, GLB_CHUNK.pack(len(body), b"BIN\0"), body]
    path.write_bytes(GLB_HEAD.pack(b"glTF", 2, length) + b"".join(chunks))


def glb_document(corners: Float32Array, shades: ByteArray) -> dict[str, Any]:
    """What a glTF says of (2S, 3) ends of lines and their (2S, 4) RGBA, which follow it."""
    sizes = (corners.nbytes, shades.nbytes)
    positions = {
        "bufferView": 0,
        "componentType": 5126,  # float32
        "type": "VEC3",
        "count": len(corners),
        "min": corners.min(axis=0).tolist(),
        "max": corners.max(axis=0).tolist(),
    }
    colors = {
        "bufferView": 1,
        "componentType": 5121,  # unsigned byte
        "normalized": True,
        "type": "VEC4",
        "count": len(shades),
    }
    lines = {"attributes": {"POSITION": 0, "COLOR_0": 1}, "mode": 1, "material": 0}
    plain = {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 0}
    return {
        "asset": {"version": "2.0", "generator": "colmap-edges"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "edges", "mesh": 0}],
        "meshes": [{"name": "edges", "primitives": [lines]}],
        "materials": [{"pbrMetallicRoughness": plain}],
        "accessors": [positions, colors],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": sizes[0]},
            {"buffer": 0, "byteOffset": sizes[0], "byteLength": sizes[1]},
        ],
        "buffers": [{"byteLength": sum(sizes)}],
    }


def write_dxf(edges: Edges3D, path: Path) -> None:
    """Write a DXF (R12, which every CAD program reads) with one 3D polyline an edge."""
    bounds = zip(edges.edge_offsets[:-1], edges.edge_offsets[1:], edges.closed, strict=True)
    with path.open("w", encoding="ascii") as file:
        file.write(DXF_START)
        for first, last, closed in bounds:
            file.write(DXF_POLYLINE.format(8 + closed))
            file.write(formatted(DXF_VERTEX, edges.points[first:last]))
            file.write(DXF_END_OF_POLYLINE)
        file.write(DXF_END)


def write_json(
    edges: Edges3D,
    model: Model,
    point3D_ids: IntArray,
    residuals: FloatArray,
    path: Path,
) -> None:
    """Write what each edge and each node is, one line for each.

    Args:
        edges: the edges; an edge's id is its place in them.
        model: the model whose views the tracks name.
        point3D_ids: (N,) ids of the edge points in the written model.
        residuals: (T,) distances of observations from projections, pixels.
        path: file to write.
    """
    records = edge_records(edges, model, point3D_ids, residuals)
    lines, nodes = (
        ",\n".join(json.dumps(record, separators=(",", ":")) for record in each)
        for each in (records, node_records(edges, model, point3D_ids))
    )
    text = f'{{"edges": [\n{lines}\n],\n"nodes": [\n{nodes}\n]}}\n'
    path.write_text(text, encoding="utf-8")


def edge_records(
    edges: Edges3D,
    model: Model,
    point3D_ids: IntArray,
    residuals: FloatArray,
) -> list[dict[str, Any]]:
    """One mapping an edge: id, point3D ids, closed, length, views, residual, end nodes."""
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
            }
        )
    return records


def node_records(edges: Edges3D, model: Model, point3D_ids: IntArray) -> list[dict[str, Any]]:
    """One mapping a node: id, point3D id, place, deviation, views, ends that meet, edge through.

    An end is an edge's id with 0 for its first and 1 for its last point; the edge that passes
    through is its id with the place of the node among its points.
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
    """`value` rounded to 1e-6, or None where JSON has no number for it."""
    return round(float(value), 6) if np.isfinite(value) else None
