"""Export of 3D edges, and of any lines and triangles, as binary glTF."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.export.edges import y_up_from
from colmap_edges.export.precision import needs_double
from colmap_edges.export.units import metres
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.mesh import Mesh, Texture

HEAD = struct.Struct("<4sII")  # magic, version, total length
CHUNK = struct.Struct("<I4s")  # length, kind
TYPES = {"<f4": 5126, "|u1": 5121, "<u4": 5125}  # glTF's numbers of component types
LINES, TRIANGLES = 1, 4  # primitive modes
VERTICES, INDICES = 34962, 34963  # targets of buffer views
ASSET = {"version": "2.0", "generator": "colmap-edges"}
ROOT = "y up from model"  # name of the node that turns the scene
PLAIN = {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 0}

TEXTURED = {  # with the texture of the only image, unlit
    "extensionsUsed": ["KHR_materials_unlit"],
    "materials": [
        {
            "pbrMetallicRoughness": PLAIN | {"baseColorTexture": {"index": 0}},
            "extensions": {"KHR_materials_unlit": {}},
            "doubleSided": True,
        }
    ],
    "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
    "textures": [{"sampler": 0, "source": 0}],
}


@checked
def write_glb(
    edges: Edges3D,
    path: Path | str,
    *,
    up: Any = "z",
    unit: str = "",
    overwrite: bool = True,
) -> None:
    """Write a binary glTF of one set of lines, in the mean colour of each edge.

    The attribute `_EDGE_ID` holds the index of the edge of each vertex. Without edges no file is
    written, since the format has no empty scenes.

    Args:
        edges: the edges.
        path: file to write.
        up: upward direction, an axis such as "-y" or (3,) numbers; the root node turns it to y,
            which is up in glTF.
        unit: unit of the coordinates, such as "mm", from which the root node makes metres; if
            empty, they keep their numbers.
        overwrite: replace an existing file.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    if edges.num_edges == 0:
        return
    ids = edges.edge_ids
    sums = np.column_stack(
        [np.bincount(ids, channel, edges.num_edges) for channel in edges.colors.T]
    )
    means = np.rint(sums / np.bincount(ids, minlength=edges.num_edges)[:, None]).astype(np.uint8)
    far = needs_double(edges.points, edges.segments)
    root = root_node(up, unit)
    data = as_glb("edges", edges.points, means[ids], edges.segments, LINES, root, far, ids)
    write_whole(Path(path), data, "edges", overwrite=overwrite)


def root_node(up: Any, unit: str) -> dict[str, Any]:
    """The node that turns the scene so that y is up, and makes its unit metres."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(y_up_from(up)).as_quat()
    node: dict[str, Any] = {"name": ROOT, "children": [1], "rotation": turn.tolist()}
    return node | ({"scale": 3 * [metres(unit)]} if unit else {})


def as_glb(
    name: str,
    points: FloatArray,
    colors: ByteArray,
    indices: IntArray | Int32Array,
    mode: int,
    root: dict[str, Any],
    far: bool,
    edge_ids: IntArray | None = None,
) -> bytes:
    """A binary glTF of one node with one mesh of one primitive, in a root node.

    Args:
        name: name of the node and the mesh.
        points: (N, 3) world coordinates, written as float32.
        colors: (N, 3) RGB.
        indices: (P, 2) ends of lines, or (P, 3) corners of triangles.
        mode: LINES or TRIANGLES.
        root: the root node, of `root_node`.
        far: write the points relative to their centre, which becomes the node's translation;
            the latter is text and keeps its precision.
        edge_ids: (N,) values of the attribute `_EDGE_ID`; float32, as glTF forbids integers here.
    """
    if not len(indices):
        return chunks({"asset": ASSET})  # accessors must not be empty
    offset = (points.min(axis=0) + points.max(axis=0)) / 2 if far else np.zeros(3)
    rgba = np.full((len(points), 4), 255, np.uint8)  # four bytes, for alignment
    rgba[:, :3] = colors
    attributes: dict[str, NDArray[Any]] = {
        "POSITION": (points - offset).astype("<f4"),
        "COLOR_0": rgba,
    }
    if edge_ids is not None:
        attributes["_EDGE_ID"] = edge_ids.astype("<f4")[:, None]
    node = {"name": name, "mesh": 0} | ({"translation": offset.tolist()} if far else {})
    arrays = [*attributes.values(), indices.astype("<u4").reshape(-1, 1)]
    primitive = {
        "attributes": {name: index for index, name in enumerate(attributes)},
        "indices": len(attributes),
        "mode": mode,
    }
    if mode == LINES:  # lines without normals are not shaded
        primitive["material"] = 0
    return packed([root, node], primitive, arrays)


def as_textured_glb(mesh: Mesh, texture: Texture, root: dict[str, Any], far: bool) -> bytes:
    """A binary glTF of a mesh with its texture, in a root node.

    Viewers show the photographs' colours as they are, since these hold the scene's light already.

    Args:
        mesh: the mesh.
        texture: its texture.
        root: the root node, of `root_node`.
        far: write the points relative to their centre, as in `as_glb`.
    """
    if not len(mesh.faces):
        return chunks({"asset": ASSET})
    points = mesh.vertices
    offset = (points.min(axis=0) + points.max(axis=0)) / 2 if far else np.zeros(3)
    vertices, places, corners = texture.joined(mesh.faces)
    arrays: list[NDArray[Any]] = [
        (points[vertices] - offset).astype("<f4"),
        texture.points[places].astype("<f4"),
        corners.astype("<u4").reshape(-1, 1),
    ]
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    primitive = {"attributes": attributes, "indices": 2, "mode": TRIANGLES, "material": 0}
    node = {"name": "mesh", "mesh": 0} | ({"translation": offset.tolist()} if far else {})
    return packed([root, node], primitive, arrays, texture.jpeg)


def packed(
    nodes: list[dict[str, Any]],
    primitive: dict[str, Any],
    arrays: list[NDArray[Any]],
    jpeg: bytes = b"",
) -> bytes:
    """A binary glTF of nodes and their mesh's primitive; its arrays in the order of accessors."""
    starts = np.cumsum([0, *(array.nbytes for array in arrays)]).tolist()
    targets = [VERTICES] * (len(arrays) - 1) + [INDICES]
    document: dict[str, Any] = {
        "asset": ASSET,
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"name": nodes[-1]["name"], "primitives": [primitive]}],
        "accessors": [accessor(array, index) for index, array in enumerate(arrays)],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": array.nbytes, "target": target}
            for start, array, target in zip(starts, arrays, targets, strict=False)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    if "material" in primitive:
        document["materials"] = [{"pbrMetallicRoughness": PLAIN}]
    if jpeg:
        document |= TEXTURED
        document["images"] = [{"bufferView": len(arrays), "mimeType": "image/jpeg"}]
        place = {"buffer": 0, "byteOffset": starts[-1], "byteLength": len(jpeg)}
        document["bufferViews"].append(place)
        jpeg += b"\0" * (-len(jpeg) % 4)
        document["buffers"][0]["byteLength"] += len(jpeg)
    return chunks(document, b"".join(array.tobytes() for array in arrays) + jpeg)


def chunks(document: dict[str, Any], body: bytes = b"") -> bytes:
    """A binary glTF of its JSON part and its buffer, whose length is a multiple of four."""
    head = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    head += b" " * (-len(head) % 4)
    data = CHUNK.pack(len(head), b"JSON") + head
    if body:
        data += CHUNK.pack(len(body), b"BIN\0") + body
    return HEAD.pack(b"glTF", 2, HEAD.size + len(data)) + data


def accessor(array: NDArray[Any], view: int) -> dict[str, Any]:
    """The accessor of an array (N, 1) to (N, 4) that fills a buffer view."""
    found = {
        "bufferView": view,
        "componentType": TYPES[array.dtype.str],
        "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[array.shape[1]],
        "count": len(array),
    }
    if array.dtype == np.uint8:
        return found | {"normalized": True}
    if array.shape[1] == 3:  # required for positions
        found |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
    return found
