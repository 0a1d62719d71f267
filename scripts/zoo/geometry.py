"""Bodies as closed solids, and their outer surface as one mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from manifold3d import Manifold, Mesh64, OpType
from numpy.typing import NDArray

Array = NDArray[np.float64]
Random = np.random.Generator
CREASE_DEG = 25.0  # smallest angle between the normals of two faces that meet in an edge
KINDS = ("crease", "contact", "texture")


@dataclass(frozen=True)
class Body:
    """A closed solid, the material of its surface and the object that it belongs to."""

    name: str
    material: str
    solid: Manifold


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A closed triangle mesh: (V, 3) vertices, (F, 3), and the index of each face's body."""

    vertices: Array
    faces: NDArray[np.int32]
    face_body: NDArray[np.int32]

    @cached_property
    def corners(self) -> Array:
        """(F, 3, 3) corners of the faces."""
        return self.vertices[self.faces]

    @cached_property
    def crosses(self) -> Array:
        """(F, 3) normals of the faces, of twice their area."""
        a, b, c = self.corners.swapaxes(0, 1)
        return np.cross(b - a, c - a)

    @property
    def normals(self) -> Array:
        """(F, 3) unit normals of the faces."""
        return self.crosses / np.maximum(np.linalg.norm(self.crosses, axis=1), 1e-30)[:, None]


def dot(a: Array, b: Array) -> Array:
    """(N,) products of vectors (N, 3)."""
    return np.einsum("ij,ij->i", a, b)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of length 1."""
    return vectors / np.sqrt(dot(vectors, vectors))[:, None]


def unite(bodies: list[Body], longest: float | None = None) -> Surface:
    """The outer surface of all bodies together, each face with its body.

    With `longest` the triangles are cut so that their sides are about that long at most.
    """
    united, body_of = union(bodies)
    refined = united if longest is None else united.refine_to_length(longest)
    return as_surface(refined.to_mesh64(), body_of)


def unite_shaded(bodies: list[Body], longest: float) -> tuple[Surface, Array]:
    """The same surface, cut, with the (V, 3) normals of its smooth faces.

    A vertex on a crease is there once for each smooth face that meets in it.
    """
    united, body_of = union(bodies)
    mesh = united.calculate_normals(0, CREASE_DEG).refine_to_length(longest).to_mesh64()
    return as_surface(mesh, body_of), np.asarray(mesh.vert_properties, np.float64)[:, 3:6]


def union(bodies: list[Body]) -> tuple[Manifold, dict[int, int]]:
    """The union of the bodies, and the body that each part of its surface comes from."""
    solids = [body.solid.as_original() for body in bodies]
    body_of = {solid.original_id(): index for index, solid in enumerate(solids)}
    return Manifold.batch_boolean(solids, OpType.Add), body_of


def as_surface(mesh: Mesh64, body_of: dict[int, int]) -> Surface:
    """The triangles of a union."""
    faces = np.asarray(mesh.tri_verts, np.int32)
    run = np.searchsorted(np.asarray(mesh.run_index), 3 * np.arange(len(faces)), side="right") - 1
    face_body = np.array([body_of[i] for i in mesh.run_original_id], np.int32)[run]
    vertices = np.asarray(mesh.vert_properties, np.float64)[:, :3]
    return Surface(vertices=vertices, faces=faces, face_body=face_body)


def paired_faces(surface: Surface) -> tuple[NDArray[np.int32], NDArray[np.int64], np.ndarray]:
    """(E, 2) edges of a closed mesh, (E, 2) faces that share them, (E,) whether they are creases.

    Raises:
        ValueError: The surface is not closed.
    """
    half = np.sort(surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort((half[:, 1], half[:, 0]))
    first, second = order[::2], order[1::2]
    if not np.array_equal(half[first], half[second]):
        raise ValueError("the surface is not closed: some edge has not exactly two faces")
    pairs, normals = np.column_stack([first // 3, second // 3]), surface.normals
    cosine = dot(normals[pairs[:, 0]], normals[pairs[:, 1]])
    return half[first], pairs, cosine < np.cos(np.radians(CREASE_DEG))


def sharp_edges(
    surface: Surface, bodies: list[Body]
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """(E, 2) edges of the mesh with a crease or a change of material, and (E,) their kinds."""
    edges, pairs, crease = paired_faces(surface)
    name = np.unique([body.name for body in bodies], return_inverse=True)[1]
    material = np.unique([body.material for body in bodies], return_inverse=True)[1]
    first, second = surface.face_body[pairs].T
    kind = np.where(name[first] != name[second], KINDS.index("contact"), KINDS.index("crease"))
    painted = ~crease & (material[first] != material[second])
    kind[painted] = KINDS.index("texture")
    keep = crease | painted
    return edges[keep], kind[keep].astype(np.uint8)


def write_surface(path: Path, surface: Surface) -> None:
    """Write the triangles as a binary little-endian PLY."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(surface.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(surface.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(surface.faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, surface.faces
    data = surface.vertices.astype("<f4").tobytes() + faces.tobytes()
    path.write_bytes(header.encode() + data)
