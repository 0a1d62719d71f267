"""The surface of the scene as one mesh, and the true 3D curves on it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from manifold3d import Manifold, Mesh64, OpType
from numpy.typing import NDArray

from demo_scene.bodies import Body

CREASE_DEG = 25.0  # smallest angle between the normals of two faces that meet in an edge
CORNER_DEG = 30.0  # largest turn inside one curve
SPACING = 0.01  # longest segment of a curve in metres, about one pixel
KINDS = ("crease", "contact", "texture")


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A closed triangle mesh: (V, 3) metres, (F, 3), and the index of each face's body."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    face_body: NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Segments between points: (P, 3) metres, (E, 2), and curve and kind of each segment."""

    points: NDArray[np.float64]
    edges: NDArray[np.int32]
    curve_id: NDArray[np.int32]
    kind: NDArray[np.int32]


def unite(bodies: list[Body], longest: float | None = None) -> Surface:
    """Return the outer surface of all bodies together, each face with its body.

    With `longest` the triangles are cut so that their sides are about that long at most.
    """
    united, body_of = union(bodies)
    refined = united if longest is None else united.refine_to_length(longest)
    return as_surface(refined.to_mesh64(), body_of)


def unite_shaded(bodies: list[Body], longest: float) -> tuple[Surface, NDArray[np.float64]]:
    """Return the same surface, cut, with the (V, 3) normals of its smooth faces.

    A vertex on a crease is there once for each smooth face that meets in it.
    """
    united, body_of = union(bodies)
    mesh = united.calculate_normals(0, CREASE_DEG).refine_to_length(longest).to_mesh64()
    return as_surface(mesh, body_of), np.asarray(mesh.vert_properties, np.float64)[:, 3:6]


def union(bodies: list[Body]) -> tuple[Manifold, dict[int, int]]:
    """Return the union of the bodies, and the body that each part of its surface comes from."""
    solids = [body.solid.as_original() for body in bodies]
    body_of = {solid.original_id(): index for index, solid in enumerate(solids)}
    return Manifold.batch_boolean(solids, OpType.Add), body_of


def as_surface(mesh: Mesh64, body_of: dict[int, int]) -> Surface:
    """Return the triangles of a union."""
    faces = np.asarray(mesh.tri_verts, np.int32)
    run = np.searchsorted(np.asarray(mesh.run_index), 3 * np.arange(len(faces)), side="right") - 1
    face_body = np.array([body_of[i] for i in mesh.run_original_id], np.int32)[run]
    vertices = np.asarray(mesh.vert_properties, np.float64)[:, :3]
    return Surface(vertices=vertices, faces=faces, face_body=face_body)


def true_curves(surface: Surface, bodies: list[Body], spacing: float = SPACING) -> Curves:
    """Return every edge of the surface: creases, contacts of bodies, borders of paint."""
    edges, kind = sharp_edges(surface, bodies)
    curve_id = chain_edges(surface.vertices, edges, kind)
    return subdivide(surface.vertices, edges, curve_id, kind, spacing)


def sharp_edges(
    surface: Surface, bodies: list[Body]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the (E, 2) mesh edges with a crease or a change of material, and their kinds."""
    edges, pairs = paired_faces(surface.faces)
    normals = face_normals(surface)
    cosine = np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]])
    crease = cosine < np.cos(np.radians(CREASE_DEG))
    name = np.unique([body.name for body in bodies], return_inverse=True)[1]
    material = np.unique([body.material for body in bodies], return_inverse=True)[1]
    first, second = surface.face_body[pairs].T
    kind = np.where(name[first] != name[second], KINDS.index("contact"), KINDS.index("crease"))
    painted = ~crease & (material[first] != material[second])
    kind[painted] = KINDS.index("texture")
    keep = crease | painted
    return edges[keep], kind[keep].astype(np.int32)


def paired_faces(faces: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the (E, 2) edges of a closed mesh and the (E, 2) faces that share them."""
    half = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    order = np.lexsort((half[:, 1], half[:, 0]))
    first, second = order[::2], order[1::2]
    if not np.array_equal(half[first], half[second]):
        raise ValueError("the surface is not closed: some edge has not exactly two faces")
    return half[first], np.column_stack([first // 3, second // 3])


def face_normals(surface: Surface) -> NDArray[np.float64]:
    """Return the unit normals of the faces, shape (F, 3)."""
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def chain_edges(
    vertices: NDArray[np.float64], edges: NDArray[np.int32], kind: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Number the curves: edges joined at vertices of two edges, without corner or new kind."""
    parent = np.arange(len(edges))

    def root(i: int) -> int:
        while parent[i] != i:
            i = parent[i] = parent[parent[i]]
        return i

    ends = np.argsort(edges.ravel(), kind="stable")
    starts = np.flatnonzero(np.diff(edges.ravel()[ends], prepend=-1))
    for group in np.split(ends, starts[1:]):
        if len(group) == 2 and continues(vertices, edges, kind, group):
            parent[root(group[0] // 2)] = root(group[1] // 2)
    roots = [root(i) for i in range(len(edges))]
    return np.unique(roots, return_inverse=True)[1].astype(np.int32)


def continues(
    vertices: NDArray[np.float64],
    edges: NDArray[np.int32],
    kind: NDArray[np.int32],
    ends: NDArray[np.int64],
) -> bool:
    """Return whether two edges that touch, given by their touching ends, belong to one curve."""
    i, j = ends // 2
    near, far = edges[i][ends[0] % 2], (edges[i][1 - ends[0] % 2], edges[j][1 - ends[1] % 2])
    a, b = vertices[near] - vertices[far[0]], vertices[far[1]] - vertices[near]
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return bool(kind[i] == kind[j] and cosine > np.cos(np.radians(CORNER_DEG)))


def subdivide(
    vertices: NDArray[np.float64],
    edges: NDArray[np.int32],
    curve_id: NDArray[np.int32],
    kind: NDArray[np.int32],
    spacing: float = SPACING,
) -> Curves:
    """Cut the edges into segments of at most `spacing`; points are shared at the vertices."""
    used, local = np.unique(edges, return_inverse=True)
    points = [vertices[used]]
    segments, count = [], len(used)
    ends = local.reshape(edges.shape)
    pieces = np.maximum(
        1, np.ceil(np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1) / spacing)
    )
    for (start, end), n in zip(ends, pieces.astype(int), strict=True):
        t = np.arange(1, n)[:, None] / n
        points.append((1 - t) * vertices[used[start]] + t * vertices[used[end]])
        path = np.concatenate([[start], np.arange(count, count + n - 1), [end]])
        segments.append(np.column_stack([path[:-1], path[1:]]))
        count += n - 1
    repeat = pieces.astype(int)
    return Curves(
        points=np.vstack(points),
        edges=np.vstack(segments).astype(np.int32),
        curve_id=np.repeat(curve_id, repeat),
        kind=np.repeat(kind, repeat),
    )


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


def write_curves(path: Path, curves: Curves, surface: Surface, bodies: list[Body]) -> None:
    """Write the curves, and the body of every face of the surface, as a compressed npz."""
    np.savez_compressed(
        path,
        points=curves.points,
        edges=curves.edges,
        curve_id=curves.curve_id,
        kind=curves.kind.astype(np.uint8),
        kind_names=np.array(KINDS),
        face_body=surface.face_body.astype(np.uint8),
        body_names=np.array([body.name for body in bodies]),
        body_materials=np.array([body.material for body in bodies]),
    )
