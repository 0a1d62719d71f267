"""Light in a room: lamps with soft shadows, and several bounces between matte surfaces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from trimesh.ray.ray_pyembree import RayMeshIntersector

from zoo.casting import Caster
from zoo.geometry import Array, Body, Random, Surface, paired_faces
from zoo.materials import painted
from zoo.plans import MATERIALS, Lamp, Room
from zoo.render import Lit

LAMP_SAMPLES = 6  # shadow rays towards a lamp, along each of its sides
GATHER = 10  # rays into the half space above a triangle, squared
SMOOTHINGS = 3  # between neighbours of one smooth face, against the rays' noise
CHUNK = 400_000  # rays at a time
CLEAR = 1e-4  # metres that rays start above a surface


class RoomCaster(Caster):
    """Scales rays as trimesh does, so that rooms look as in docs/results.md to the byte."""

    def __init__(self, surface: Surface) -> None:
        """Build the acceleration structure."""
        super().__init__(surface)
        mesh = trimesh.Trimesh(surface.vertices - self.origin, surface.faces, process=False)
        self.intersector = RayMeshIntersector(mesh)

    def first(self, starts: Array, rays: Array) -> np.ndarray:
        """First triangles (N,) that rays hit, -1 for none; see `hits`."""
        origins = np.broadcast_to(starts - self.origin, rays.shape)
        return np.asarray(self.intersector.intersects_first(origins, rays))


@dataclass(frozen=True, kw_only=True)
class RoomLit(Lit):
    """A finely cut surface with its light; all labels of a body are alike modulo their number.

    `vectors` (K, 3) are the light that falls on the corners of each smooth face, over pi.
    """

    materials: list[str]  # of each body

    max_light = 3.0

    def shade(
        self, faces: np.ndarray, centre: Array, rays: np.ndarray, where: np.ndarray
    ) -> tuple[Array, tuple[int, ...]]:
        """Light that matte faces reflect and emit; there are no borders but those of labels."""
        places = centre + where[:, 3:] * rays
        own = [MATERIALS[name] for name in self.materials]
        body = self.caster.surface.face_body[faces]
        reflected = self.between(faces, where) * albedo(self.materials, body, places)
        emitted = np.array([material.emission for material in own])[body]
        return reflected / self.white + emitted[:, None], (0, 0, 1, 1)

    def background(self, rays: np.ndarray) -> float:
        """Of the sky."""
        return self.max_light

    def is_rough(self, labels: np.ndarray) -> np.ndarray:
        """Whether pixels are textured."""
        rough = np.array([MATERIALS[name].contrast > 0.1 for name in self.materials])
        return (labels >= 0) & rough[labels % len(rough)]


def albedo(materials: list[str], body: np.ndarray, places: Array) -> Array:
    """(N, 3) albedo at `places` (N, 3) on bodies (N,)."""
    result = np.empty(places.shape)
    names = np.array(materials)[body]
    for name in sorted(set(materials)):
        own = np.flatnonzero(names == name)
        result[own] = painted(MATERIALS[name], places[own], len(name) + ord(name[0]))
    return result


def illuminate(surface: Surface, room: Room, seed: int = 0, bounces: int = 4) -> RoomLit:
    """The light in a room whose surface is finely subdivided (see `unite`)."""
    caster = RoomCaster(surface)
    materials = [body.material for body in room.bodies]
    random = np.random.default_rng(seed)
    group = smooth_faces(surface, room.bodies)
    corners, at_corners = corner_averages(surface, group)
    lamps = np.sum([lamp_light(caster, lamp, random) for lamp in room.lamps], axis=0)
    direct = np.repeat(lamps[:, None], 3, axis=1)
    reflected = albedo(materials, surface.face_body, surface.corners.mean(axis=1))
    transport = gather(caster, random)
    light = direct
    for _ in range(bounces):
        light = direct + transport @ (reflected * light)
    for _ in range(SMOOTHINGS):
        light = (at_corners @ light)[corners].mean(axis=1)
    return RoomLit(
        caster=caster,
        corners=corners,
        vectors=at_corners @ light,
        labels=group.astype(np.int64) * len(materials) + surface.face_body,
        materials=materials,
    )


def smooth_faces(surface: Surface, bodies: list[Body]) -> np.ndarray:
    """(F,) smooth face of each triangle."""
    _, pairs, crease = paired_faces(surface)
    name = np.array([f"{body.name} {body.material}" for body in bodies])[surface.face_body]
    joined = pairs[~crease & (name[pairs[:, 0]] == name[pairs[:, 1]])]
    count = len(surface.faces)
    graph = csr_matrix((np.ones(len(joined)), joined.T), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def corner_averages(surface: Surface, group: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
    """(F, 3) indices of the corners of smooth faces, and averages over the triangles there."""
    whole = surface.faces.astype(np.int64) + group[:, None] * np.int64(len(surface.vertices))
    found, keys = np.unique(whole, return_inverse=True)
    keys = keys.reshape(whole.shape)
    area = np.linalg.norm(surface.crosses, axis=1) + 1e-12
    triangles = np.repeat(np.arange(len(keys)), 3)
    weights = csr_matrix((np.repeat(area, 3), (keys.ravel(), triangles)), (len(found), len(keys)))
    return keys, csr_matrix(weights.multiply(1 / weights.sum(axis=1)))


def in_chunks(caster: Caster, rays_each: int) -> Iterator[tuple[slice, Array, Array]]:
    """Triangles that send `rays_each` rays each, their normals, and the rays' starts."""
    count, step = len(caster.normals), max(1, CHUNK // rays_each)
    for part in (slice(start, min(start + step, count)) for start in range(0, count, step)):
        normals = caster.normals[part]
        yield part, normals, caster.surface.corners[part].mean(axis=1) + CLEAR * normals


def lamp_light(caster: Caster, lamp: Lamp, random: Random) -> Array:
    """(F,) light of a lamp on each triangle, over pi, by shadow rays to points on the lamp."""
    u, v = np.array(lamp.half_u), np.array(lamp.half_v)
    towards = np.array(lamp.towards, float)
    area = 4 * np.linalg.norm(u) * np.linalg.norm(v)
    cells = (np.indices((LAMP_SAMPLES, LAMP_SAMPLES)).reshape(2, -1).T / LAMP_SAMPLES)[None]
    result = np.zeros(len(caster.normals))
    for part, normals, starts in in_chunks(caster, LAMP_SAMPLES**2):
        spots = 2 * (cells + random.random((len(starts), LAMP_SAMPLES**2, 2)) / LAMP_SAMPLES) - 1
        rays = np.array(lamp.center) + spots[..., :1] * u + spots[..., 1:] * v - starts[:, None]
        squared = np.maximum(np.einsum("ijk,ijk->ij", rays, rays), 0.01)
        here = np.maximum(np.einsum("ijk,ik->ij", rays, normals), 0)
        there = np.maximum(-rays @ towards, 0)
        share = here * there / squared**2 * area * lamp.radiance / np.pi
        asked = np.nonzero(share)
        _, distance = caster.hits(starts[asked[0]], rays[asked])
        share[asked] *= distance > 0.999
        result[part] = share.mean(axis=1)
    return result


def gather(caster: Caster, random: Random) -> csr_matrix:
    """(F, F) form factors between triangles, by rays with cosine-weighted directions."""
    count, rays_each = len(caster.normals), GATHER**2
    cells = (np.indices((GATHER, GATHER)).reshape(2, -1).T)[None]
    found = np.empty((count, rays_each), np.int32)
    for part, normals, starts in in_chunks(caster, rays_each):
        u = (cells + random.random((len(starts), rays_each, 2))) / GATHER
        radius, turn = np.sqrt(u[..., 0]), 2 * np.pi * u[..., 1]
        helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
        x = np.cross(normals, helper)
        x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
        y = np.cross(normals, x)
        rays = (radius * np.cos(turn))[..., None] * x[:, None]
        rays += (radius * np.sin(turn))[..., None] * y[:, None]
        rays += np.sqrt(1 - u[..., :1]) * normals[:, None]
        first, _ = caster.hits(np.repeat(starts, rays_each, axis=0), rays.reshape(-1, 3))
        found[part] = first.reshape(len(starts), rays_each)
    rows, columns = np.nonzero(found >= 0)
    shares = np.full(len(rows), 1 / rays_each, np.float32)
    return csr_matrix((shares, (rows, found[rows, columns])), (count, count))
