"""Light in a room: lamps with soft shadows, and several bounces between matte surfaces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from demo_scene.bodies import Body
from demo_scene.geometry import CREASE_DEG, Surface, face_normals, paired_faces
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from trimesh.ray.ray_pyembree import RayMeshIntersector

from rooms.materials import MATERIALS, albedo
from rooms.plans import Lamp, Room

LAMP_SAMPLES = 6  # shadow rays towards a lamp, along each of its sides
GATHER = 10  # rays into the half space above a triangle, squared
BOUNCES = 4
SMOOTHINGS = 3  # between neighbours of one smooth face, against the rays' noise
CHUNK = 400_000  # rays at a time
CLEAR = 1e-4  # metres that rays start above a surface


@dataclass(frozen=True, kw_only=True)
class Caster:
    """Triangles for ray casting; `origin` is subtracted to keep precision in float32."""

    corners: NDArray[np.float64]
    normals: NDArray[np.float64]
    origin: NDArray[np.float64]
    intersector: RayMeshIntersector

    @classmethod
    def of(cls, surface: Surface) -> Caster:
        """Build the acceleration structure of a surface."""
        origin = surface.vertices.mean(axis=0)
        mesh = trimesh.Trimesh(surface.vertices - origin, surface.faces, process=False)
        return cls(
            corners=surface.vertices[surface.faces],
            normals=face_normals(surface),
            origin=origin,
            intersector=RayMeshIntersector(mesh),
        )

    def hits(self, starts: NDArray, rays: NDArray) -> tuple[NDArray, NDArray]:
        """First triangles (N,) that rays (N, 3) hit, -1 for none, and distances in rays."""
        first = self.intersector.intersects_first(starts - self.origin, rays)
        ahead = np.einsum("ij,ij->i", self.corners[first, 0] - starts, self.normals[first])
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ahead / np.einsum("ij,ij->i", rays, self.normals[first])
        return first, np.where(first >= 0, distance, np.inf)


@dataclass(frozen=True, kw_only=True)
class LitSurface:
    """A finely subdivided surface with its light.

    Attributes:
        caster: Its triangles.
        face_body: (F,) body of each.
        group: (F,) smooth face that each belongs to.
        keys: (F, 3) row of `light` of each corner.
        light: (K, 3) light that falls on a corner of a smooth face, over pi.
        materials: Name of the material of each body.
    """

    caster: Caster
    face_body: NDArray[np.int32]
    group: NDArray[np.int32]
    keys: NDArray[np.int64]
    light: NDArray[np.float64]
    materials: list[str]

    def radiance(self, faces: NDArray, places: NDArray) -> NDArray[np.float64]:
        """(N, 3) light reflected at (N, 3) points on (N,) faces, without emission."""
        names = sorted(set(self.materials))
        index = np.array([names.index(name) for name in self.materials])[self.face_body[faces]]
        weights = barycentric(self.caster.corners[faces], places)
        falls = np.einsum("ij,ijk->ik", weights, self.light[self.keys[faces]])
        return falls * albedo(names, index, places)

    def emission(self, faces: NDArray) -> NDArray[np.float64]:
        """(N,) light emitted by faces."""
        of_body = np.array([MATERIALS[name].emission for name in self.materials])
        return of_body[self.face_body[faces]]


def barycentric(corners: NDArray, places: NDArray) -> NDArray[np.float64]:
    """(N, 3) barycentric coordinates of points in triangles with corners (N, 3, 3)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = places - corners[:, 0]
    aa, ab, bb = (np.einsum("ij,ij->i", *pair) for pair in ((a, a), (a, b), (b, b)))
    pa, pb = np.einsum("ij,ij->i", p, a), np.einsum("ij,ij->i", p, b)
    scale = 1 / np.maximum(aa * bb - ab * ab, 1e-30)
    v, w = (bb * pa - ab * pb) * scale, (aa * pb - ab * pa) * scale
    return np.clip(np.column_stack([1 - v - w, v, w]), 0, 1)


def illuminate(surface: Surface, room: Room, seed: int = 0, bounces: int = BOUNCES) -> LitSurface:
    """The light in a room whose surface is finely subdivided (see `unite`)."""
    caster = Caster.of(surface)
    materials = [body.material for body in room.bodies]
    random = np.random.default_rng(seed)
    group = smooth_faces(surface, room.bodies)
    keys, at_corners = corner_averages(surface, group)
    lamps = sum(lamp_light(caster, lamp, random) for lamp in room.lamps)
    direct = np.repeat(np.asarray(lamps)[:, None], 3, axis=1)
    names = sorted(set(materials))
    index = np.array([names.index(name) for name in materials])[surface.face_body]
    reflected = albedo(names, index, caster.corners.mean(axis=1))
    transport = gather(caster, random)
    light = direct
    for _ in range(bounces):
        light = direct + transport @ (reflected * light)
    for _ in range(SMOOTHINGS):
        light = (at_corners @ light)[keys].mean(axis=1)
    return LitSurface(
        caster=caster,
        face_body=surface.face_body,
        group=group,
        keys=keys,
        light=at_corners @ light,
        materials=materials,
    )


def smooth_faces(surface: Surface, bodies: list[Body]) -> NDArray[np.int32]:
    """(F,) smooth face of each triangle."""
    _, pairs = paired_faces(surface.faces)
    normals = face_normals(surface)
    cosine = np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]])
    name = np.array([f"{body.name} {body.material}" for body in bodies])[surface.face_body]
    smooth = cosine > np.cos(np.radians(CREASE_DEG))
    joined = pairs[smooth & (name[pairs[:, 0]] == name[pairs[:, 1]])]
    count = len(surface.faces)
    graph = csr_matrix((np.ones(len(joined)), joined.T), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def corner_averages(surface: Surface, group: NDArray) -> tuple[NDArray[np.int64], csr_matrix]:
    """(F, 3) indices of the corners of smooth faces, and averages over the triangles there."""
    whole = surface.faces.astype(np.int64) + group[:, None] * np.int64(len(surface.vertices))
    found, keys = np.unique(whole, return_inverse=True)
    keys = keys.reshape(whole.shape)
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) + 1e-12
    triangles = np.repeat(np.arange(len(keys)), 3)
    weights = csr_matrix((np.repeat(area, 3), (keys.ravel(), triangles)), (len(found), len(keys)))
    return keys, csr_matrix(weights.multiply(1 / weights.sum(axis=1)))


def in_chunks(count: int, rays_each: int) -> Iterator[slice]:
    """Slices of `count` triangles that send `rays_each` rays each."""
    step = max(1, CHUNK // rays_each)
    yield from (slice(start, min(start + step, count)) for start in range(0, count, step))


def lamp_light(caster: Caster, lamp: Lamp, random: np.random.Generator) -> NDArray[np.float64]:
    """(F,) light of a lamp on each triangle, over pi, by shadow rays to points on the lamp."""
    u, v = np.array(lamp.half_u), np.array(lamp.half_v)
    towards = np.array(lamp.towards, float)
    area = 4 * np.linalg.norm(u) * np.linalg.norm(v)
    cells = (np.indices((LAMP_SAMPLES, LAMP_SAMPLES)).reshape(2, -1).T / LAMP_SAMPLES)[None]
    result = np.zeros(len(caster.corners))
    for part in in_chunks(len(result), LAMP_SAMPLES**2):
        starts = caster.corners[part].mean(axis=1) + CLEAR * caster.normals[part]
        spots = 2 * (cells + random.random((len(starts), LAMP_SAMPLES**2, 2)) / LAMP_SAMPLES) - 1
        rays = np.array(lamp.center) + spots[..., :1] * u + spots[..., 1:] * v - starts[:, None]
        squared = np.maximum(np.einsum("ijk,ijk->ij", rays, rays), 0.01)
        here = np.maximum(np.einsum("ijk,ik->ij", rays, caster.normals[part]), 0)
        there = np.maximum(-rays @ towards, 0)
        share = here * there / squared**2 * area * lamp.radiance / np.pi
        asked = np.nonzero(share)
        _, distance = caster.hits(starts[asked[0]], rays[asked])
        share[asked] *= distance > 0.999
        result[part] = share.mean(axis=1)
    return result


def gather(caster: Caster, random: np.random.Generator) -> csr_matrix:
    """(F, F) form factors between triangles, by rays with cosine-weighted directions."""
    count, rays_each = len(caster.corners), GATHER**2
    cells = (np.indices((GATHER, GATHER)).reshape(2, -1).T)[None]
    found = np.empty((count, rays_each), np.int32)
    for part in in_chunks(count, rays_each):
        normals = caster.normals[part]
        starts = caster.corners[part].mean(axis=1) + CLEAR * normals
        u = (cells + random.random((len(starts), rays_each, 2))) / GATHER
        radius, turn = np.sqrt(u[..., 0]), 2 * np.pi * u[..., 1]
        helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
        x = np.cross(normals, helper)
        x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
        y = np.cross(normals, x)
        rays = (radius * np.cos(turn))[..., None] * x[:, None]
        rays += (radius * np.sin(turn))[..., None] * y[:, None]
        rays += np.sqrt(1 - u[..., :1]) * normals[:, None]
        origins = np.repeat(starts, rays_each, axis=0)
        first, _ = caster.hits(origins, rays.reshape(-1, 3))
        found[part] = first.reshape(len(starts), rays_each)
    rows, columns = np.nonzero(found >= 0)
    shares = np.full(len(rows), 1 / rays_each, np.float32)
    return csr_matrix((shares, (rows, found[rows, columns])), (count, count))
