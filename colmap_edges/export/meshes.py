"""Writing of meshes as PLY, OBJ and GLB, and reading of such files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array
from colmap_edges.core.checks import checked
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.edges import TURN, formatted, obj_header, y_up_from
from colmap_edges.export.glb import CHUNK, HEAD, ROOT, TRIANGLES, as_glb, as_textured_glb, root_node
from colmap_edges.export.ply import MESH_FACE, MESH_HEADER, MESH_VERTEX, mesh_as_ply
from colmap_edges.export.precision import needs_double
from colmap_edges.runtime.input_files import DAMAGE, open_file, read_bytes, read_text
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.mesh import Mesh, Texture

MESH_FORMATS = (".ply", ".obj", ".glb")
TEXTURED = ("OBJ", "GLB")  # formats that hold textures
# Light is in the photographs already, so that programs shall add no shine.
MATERIAL = "newmtl texture\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {picture}\n"


@checked
def write_mesh(
    mesh: Mesh,
    path: Path | str,
    *,
    up: Any = "z",
    unit: str = "",
    overwrite: bool = True,
) -> bool:
    """Write a mesh with colours as PLY, OBJ or GLB, complete or not at all.

    OBJ and GLB files show the mesh's texture, if it has one: beside an OBJ, files of the same name
    with the suffixes `.mtl` and `.jpg` hold it; a GLB contains it.

    Args:
        mesh: the mesh.
        path: file to write.
        up: upward direction, an axis such as "-y" or (3,) numbers; OBJ and GLB files are turned
            so that it is y, as programs expect.
        unit: unit of the coordinates, such as "mm", or empty if unknown; a GLB's node makes metres
            of it.
        overwrite: replace an existing file.

    Returns:
        Whether 32-bit coordinates would distort the mesh, because it lies far from the origin. Then
            a PLY has 64-bit coordinates and a GLB an offset; an OBJ is precise in any case.

    Raises:
        ColmapEdgesError: if the suffix is unknown, the file cannot be written, or exists and
            `overwrite` is false.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_FORMATS:
        raise ColmapEdgesError(
            f"cannot write a mesh as {path.name!r}; choose one of: {', '.join(MESH_FORMATS)}"
        )
    far = is_far_from_origin(mesh)
    if suffix == ".ply":
        data = mesh_as_ply(mesh, "f8" if far else "f4")
    elif suffix == ".obj":
        if mesh.texture is not None:
            write_material(mesh.texture, path, overwrite)
        data = as_obj(mesh, y_up_from(up), unit, path.stem)
    elif mesh.texture is not None:
        data = as_textured_glb(mesh, mesh.texture, root_node(up, unit), far)
    else:
        root = root_node(up, unit)
        data = as_glb("mesh", mesh.vertices, mesh.colors, mesh.faces, TRIANGLES, root, far)
    write_whole(path, data, "mesh", overwrite=overwrite)
    return far


def is_far_from_origin(mesh: Mesh) -> bool:
    """Whether 32-bit coordinates would distort a mesh."""
    return needs_double(mesh.vertices, sides_of(mesh))


def sides_of(mesh: Mesh) -> Int32Array:
    """(3 F, 2) the sides of all triangles, by their vertices."""
    return mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def write_material(texture: Texture, path: Path, overwrite: bool) -> None:
    """Write the picture of an OBJ file, and the material that shows it."""
    text = MATERIAL.format(picture=path.with_suffix(".jpg").name)
    write_whole(path.with_suffix(".jpg"), texture.jpeg, "texture", overwrite=overwrite)
    write_whole(path.with_suffix(".mtl"), text.encode(), "material", overwrite=overwrite)


def as_obj(mesh: Mesh, turn: FloatArray, unit: str, stem: str) -> bytes:
    """An OBJ of the mesh turned by a (3, 3) rotation, with colours from 0 to 1.

    `stem` is the name of its material's file without suffix.
    """
    rows = np.column_stack([mesh.vertices @ turn.T, mesh.colors / 255])
    text = formatted("v %.15g %.15g %.15g %.4g %.4g %.4g\n", rows)
    if mesh.texture is None:
        faces = formatted("f %d %d %d\n", mesh.faces + 1)
    else:
        # Places in pictures count from the lower left corner.
        points = formatted("vt %.8g %.8g\n", mesh.texture.points * [1, -1] + [0, 1])
        text = f"mtllib {stem}.mtl\n{text}{points}usemtl texture\n"
        pairs = np.dstack([mesh.faces, mesh.texture.corners]).reshape(-1, 6) + 1
        faces = formatted("f %d/%d %d/%d %d/%d\n", pairs)
    return f"# mesh by colmap-edges\n{obj_header(turn, unit)}{text}{faces}".encode()


def model_from_file(path: Path) -> FloatArray:
    """(3, 3) the matrix that turns an OBJ or GLB file of `write_mesh` back to the model.

    That of other files is the identity.

    Raises:
        OSError: if the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".obj":
        with open_file(path) as file:
            lines = [file.readline().decode("ascii", "replace") for _ in range(3)]
        rows = [line.removeprefix(TURN).split() for line in lines if line.startswith(TURN)]
        return np.array(rows[0], float).reshape(3, 3).T if rows else np.eye(3)
    document = glb_document(path) if suffix == ".glb" else {}
    root = (document.get("nodes") or [{}])[0]
    if root.get("name") != ROOT:
        return np.eye(3)
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(root["rotation"]).as_matrix()
    return np.asarray(turn.T / root.get("scale", [1.0])[0])


@checked
def read_mesh(path: Path | str) -> Mesh:
    """Read a mesh of `write_mesh` in the frame of the model; ids of its points are not in files.

    Raises:
        ColmapEdgesError: if the file is missing or damaged, or not one of `write_mesh`.
    """
    path = Path(path)
    readers = {".ply": mesh_of_ply, ".obj": mesh_of_obj, ".glb": mesh_of_glb}
    if path.suffix.lower() not in readers:
        raise ColmapEdgesError(
            f"cannot read a mesh from {path.name!r}; give one of: {', '.join(readers)}"
        )
    try:
        mesh = readers[path.suffix.lower()](path)
    except (OSError, *DAMAGE) as error:
        raise ColmapEdgesError(f"{path} is not a mesh of colmap-edges: {error}") from error
    mesh.check(str(path))
    return mesh


def mesh_of(
    vertices: FloatArray, colors: ByteArray, faces: Int32Array, texture: Texture | None = None
) -> Mesh:
    """A mesh whose points are not known."""
    unknown = np.full(len(vertices), -1, np.int64)
    return Mesh(vertices=vertices, faces=faces, point3D_ids=unknown, colors=colors, texture=texture)


def mesh_of_ply(path: Path) -> Mesh:
    """The mesh in a PLY of `write_mesh`."""
    head, _, body = read_bytes(path).partition(b"end_header\n")
    counts = {
        name.decode(): int(count) for name, count in re.findall(rb"element (\w+) (\d+)", head)
    }
    vertex = MESH_VERTEX["f8" if b"property double x" in head else "f4"]
    expected = MESH_HEADER.format(
        vertices=counts["vertex"],
        faces=counts["face"],
        number="double" if vertex is MESH_VERTEX["f8"] else "float",
    )
    if head + b"end_header\n" != expected.encode():
        raise ValueError("it has other properties")
    vertices = np.frombuffer(body, vertex, counts["vertex"])
    faces = np.frombuffer(body, MESH_FACE, counts["face"], vertices.nbytes)["indices"]
    colors = vertices["rgba"][:, :3].copy()
    return mesh_of(vertices["xyz"].astype(float), colors, faces.astype(np.int32))


def mesh_of_obj(path: Path) -> Mesh:
    """The mesh in an OBJ of `write_mesh`, with its texture."""
    rows: dict[str, list[list[str]]] = {"v": [], "vt": [], "f": []}
    for line in read_text(path).splitlines():
        kind, _, rest = line.partition(" ")
        if kind in rows:
            rows[kind].append(rest.replace("/", " ").split())
    values = np.array(rows["v"], float).reshape(-1, 6)
    colors = np.rint(255 * values[:, 3:]).astype(np.uint8)
    vertices = values[:, :3] @ model_from_file(path).T
    if not rows["vt"]:
        return mesh_of(vertices, colors, np.array(rows["f"], np.int32).reshape(-1, 3) - 1)
    corners = np.array(rows["f"], np.int32).reshape(-1, 3, 2) - 1
    texture = Texture(
        jpeg=read_bytes(path.with_suffix(".jpg")),
        points=np.array(rows["vt"], float) * [1, -1] + [0, 1],
        corners=np.ascontiguousarray(corners[:, :, 1]),
    )
    return mesh_of(vertices, colors, np.ascontiguousarray(corners[:, :, 0]), texture)


def mesh_of_glb(path: Path) -> Mesh:
    """The mesh in a GLB of `write_mesh`, without its root node's transform.

    With a texture, vertices that the file repeats for it are one again, and have its colours.
    """
    document, data = glb_document(path), read_bytes(path)
    if not document.get("meshes"):
        return mesh_of(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.int32))
    start = data.index(b"BIN\0") + 4
    is_textured = bool(document.get("images"))
    kinds = [("<f4", 3), ("<f4", 2) if is_textured else ("|u1", 4), ("<u4", 1)]
    found = []
    for accessor, (kind, columns) in zip(document["accessors"], kinds, strict=True):
        place = start + document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        array = np.frombuffer(data, kind, columns * accessor["count"], place)
        found.append(array.reshape(-1, columns))
    offset = np.array(document["nodes"][-1].get("translation", [0.0, 0.0, 0.0]))
    points, values, indices = found
    corners = indices.astype(np.int32).reshape(-1, 3)
    if not is_textured:
        return mesh_of(points + offset, values[:, :3].copy(), corners)
    picture = document["bufferViews"][document["images"][0]["bufferView"]]
    begin = start + picture["byteOffset"]
    jpeg = data[begin : begin + picture["byteLength"]]
    texture = Texture(jpeg=jpeg, points=values.astype(float), corners=corners)
    vertices, first, owners = np.unique(points, axis=0, return_index=True, return_inverse=True)
    faces = owners.ravel()[corners].astype(np.int32)
    return mesh_of(vertices + offset, texture.colors()[first], faces, texture)


def glb_document(path: Path) -> dict[str, Any]:
    """The JSON part of a binary glTF."""
    data = read_bytes(path)
    length, kind = CHUNK.unpack_from(data, HEAD.size)
    if data[:4] != b"glTF" or kind != b"JSON":
        raise ValueError("it is no binary glTF")
    return dict(json.loads(data[HEAD.size + CHUNK.size :][:length]))
