"""Export of 3D edges as binary glTF, one line strip per edge."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.arrays import ByteArray, Float32Array, IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.export.edges import polyline_indices

HEAD = struct.Struct("<4sII")  # magic, version, total length
CHUNK = struct.Struct("<I4s")  # length, kind
FLOAT, UNSIGNED_BYTE, UNSIGNED_INT = 5126, 5121, 5125
LINE_STRIP = 3
VERTICES, INDICES = 34962, 34963  # targets of buffer views


@checked
def write_glb(edges: Edges3D, path: Path) -> None:
    """Write a binary glTF with one line strip per edge, in the mean colour of its points.

    Coordinates are world coordinates in float32, as the format requires. Without edges no file is
    written, since the format has no empty scenes.
    """
    if edges.num_edges == 0:
        return
    ids = edges.edge_ids
    sums = np.column_stack(
        [np.bincount(ids, channel, edges.num_edges) for channel in edges.colors.T]
    )
    rgba = np.full((edges.num_edges, 4), 255, np.uint8)
    rgba[:, :3] = np.rint(sums / np.bincount(ids, minlength=edges.num_edges)[:, None])
    points, shades = edges.points.astype("<f4"), rgba[ids]
    strips = [indices.astype("<u4") for indices in polyline_indices(edges)]
    counts = np.array([len(strip) for strip in strips], np.int64)
    head = json.dumps(document(points, shades, counts), separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    body = points.tobytes() + shades.tobytes() + np.concatenate(strips).tobytes()
    length = HEAD.size + 2 * CHUNK.size + len(head) + len(body)
    chunks = [CHUNK.pack(len(head), b"JSON"), head, CHUNK.pack(len(body), b"BIN\0"), body]
    path.write_bytes(HEAD.pack(b"glTF", 2, length) + b"".join(chunks))


def document(points: Float32Array, shades: ByteArray, counts: IntArray) -> dict[str, Any]:
    """The JSON part of a glTF of (N, 3) points, (N, 4) RGBA, and strips of (E,) indices."""
    strips = [
        {
            "attributes": {"POSITION": 0, "COLOR_0": 1},
            "indices": 2 + edge,
            "mode": LINE_STRIP,
            "material": 0,
        }
        for edge in range(len(counts))
    ]
    plain = {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 0}
    sizes = [points.nbytes, shades.nbytes, 4 * int(counts.sum())]
    starts = [0, sizes[0], sizes[0] + sizes[1]]
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": size, "target": target}
        for start, size, target in zip(starts, sizes, (VERTICES, VERTICES, INDICES), strict=True)
    ]
    return {
        "asset": {"version": "2.0", "generator": "colmap-edges"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "edges", "mesh": 0}],
        "meshes": [{"name": "edges", "primitives": strips}],
        "materials": [{"pbrMetallicRoughness": plain}],
        "accessors": accessors(points, shades, counts),
        "bufferViews": views,
        "buffers": [{"byteLength": sum(sizes)}],
    }


def accessors(points: Float32Array, shades: ByteArray, counts: IntArray) -> list[dict[str, Any]]:
    """The accessors of points, colours and each strip's indices in their buffer views."""
    positions = {
        "bufferView": 0,
        "componentType": FLOAT,
        "type": "VEC3",
        "count": len(points),
        "min": points.min(axis=0).tolist(),
        "max": points.max(axis=0).tolist(),
    }
    colors = {
        "bufferView": 1,
        "componentType": UNSIGNED_BYTE,
        "normalized": True,
        "type": "VEC4",
        "count": len(shades),
    }
    starts = np.cumsum(counts) - counts
    indices = [
        {
            "bufferView": 2,
            "byteOffset": 4 * start,
            "componentType": UNSIGNED_INT,
            "type": "SCALAR",
            "count": count,
        }
        for start, count in zip(starts.tolist(), counts.tolist(), strict=True)
    ]
    return [positions, colors, *indices]
