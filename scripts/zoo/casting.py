"""Ray casting on a surface."""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from trimesh.triangles import points_to_barycentric

from zoo.geometry import Array, Surface, dot


class Caster:
    """Triangles for ray casting in single precision; depths come from the planes in double."""

    def __init__(self, surface: Surface) -> None:
        """Build the acceleration structure."""
        self.surface, self.normals = surface, surface.normals
        self.origin = surface.vertices.mean(axis=0)
        self.unit = float(np.abs(surface.vertices - self.origin).max())
        self.corner = surface.vertices[surface.faces[:, 0]]
        self.scene = EmbreeScene()
        self.mesh = TriangleMesh(
            self.scene, self.scaled(surface.vertices), surface.faces.astype(np.int32)
        )

    def scaled(self, points: Array) -> np.ndarray:
        """Points in the frame of the ray caster."""
        return ((points - self.origin) / self.unit).astype(np.float32)

    def first(self, starts: Array, rays: Array) -> np.ndarray:
        """First triangles (N,) that rays hit, -1 for none; see `hits`."""
        origins = np.ascontiguousarray(np.broadcast_to(self.scaled(starts), rays.shape))
        return np.asarray(self.scene.run(origins, np.ascontiguousarray(rays, np.float32)))

    def hits(self, starts: Array, rays: Array) -> tuple[np.ndarray, Array]:
        """First triangles (N,) that rays hit, -1 for none, and distances, infinite for none.

        Args:
            starts: (N, 3), or (3,) for all rays.
            rays: (N, 3); the unit of the distances is their length.
        """
        found = self.first(starts, rays)
        hit = np.flatnonzero(found >= 0)
        corners, normals = self.corner[found[hit]], self.normals[found[hit]]
        ahead = corners - (starts if starts.ndim == 1 else starts[hit])
        distance = np.full(len(rays), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance[hit] = dot(ahead, normals) / dot(rays[hit], normals)
        return found, distance

    def seen(self, start: Array, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The triangles that rays (N, 3) from one place hit, in the precision of the rays.

        Returns:
            Indices (M,) of the rays that hit, triangles (M,), and (M, 4) weights of their corners
            and distances in rays.
        """
        if rays.dtype == np.float64:
            first, distance = self.hits(start, rays)
            hit = np.flatnonzero(first >= 0)
            faces, distance = first[hit], distance[hit]
            places = start + distance[:, None] * rays[hit]
            corners = self.surface.vertices[self.surface.faces[faces]]
            weights = np.clip(points_to_barycentric(corners, places), 0, 1)
            return hit, faces, np.column_stack([weights, distance])
        origins = np.ascontiguousarray(np.broadcast_to(self.scaled(start), rays.shape))
        found = self.scene.run(origins, rays, output=1)
        hit = np.flatnonzero(found["primID"] >= 0)
        u, v, distance = found["u"][hit], found["v"][hit], found["tfar"][hit] * self.unit
        return hit, found["primID"][hit], np.column_stack([1 - u - v, u, v, distance])
