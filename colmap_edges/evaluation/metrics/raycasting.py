"""Ray casting on triangle meshes (trimesh with Embree), with depths in double precision."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.meshes import model_from_file


def load_mesh(path: Path) -> trimesh.Trimesh:
    """Read the triangle mesh of `path` without merging or dropping anything.

    Raises:
        ColmapEdgesError: The file is missing, unreadable or holds no triangle.
    """
    geometry = load_geometry(path)
    if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
        raise ColmapEdgesError(f"{path} holds no triangle; give a mesh")
    return geometry


def check_geometry(geometry: Any, path: Path) -> None:
    """Raise `ColmapEdgesError` if vertices are not finite 3D points or faces are invalid."""
    vertices = np.asarray(getattr(geometry, "vertices", np.empty(0)))
    faces = np.asarray(getattr(geometry, "faces", np.empty(0)))
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ColmapEdgesError(
            f"{path} is damaged: its vertices are not finite 3D points; write it again"
        )
    if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise ColmapEdgesError(
            f"{path} is damaged: a face refers to a missing vertex; write it again"
        )


def load_geometry(path: Path) -> Any:
    """Read a mesh or point cloud as trimesh gives it.

    Raises:
        ColmapEdgesError: The file is missing or unreadable.
    """
    if not path.is_file():
        raise ColmapEdgesError(f"{path} does not exist; give a mesh or point cloud")
    try:
        loaded = trimesh.load(path, process=False, maintain_order=True)
        if isinstance(loaded, trimesh.Scene):  # for example from GLB
            loaded = trimesh.util.concatenate(loaded.dump())
        back = model_from_file(path)
        if not np.array_equal(back, np.eye(3)):
            loaded.vertices = loaded.vertices @ back.T
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        if isinstance(error, ImportError):  # of trimesh's optional library for encodings
            reason = "its text is not UTF-8"
        raise ColmapEdgesError(f"{path} is not a readable mesh or point cloud: {reason}") from error
    check_geometry(loaded, path)
    return loaded


class Hits(NamedTuple):
    """First hits of rays.

    Attributes:
        t: (N,) length along each ray, in lengths of its direction; NaN where it hits nothing.
        normals: (N, 3) unit normals of the triangles, towards the origin of the rays; or NaN.
    """

    t: FloatArray
    normals: FloatArray


class RayCaster:
    """A mesh with an acceleration structure for ray casting."""

    def __init__(self, vertices: NDArray[Any], faces: NDArray[Any]) -> None:
        """Build the acceleration structure of `vertices` (V, 3) and `faces` (F, 3).

        No ray hits a mesh without faces.
        """
        try:
            from trimesh.ray.ray_pyembree import RayMeshIntersector
        except ImportError as error:
            raise ColmapEdgesError(
                "ray casting needs embreex; pip install 'colmap-edges[evaluation]'"
            ) from error
        self._origin = np.asarray(vertices, dtype=np.float64).mean(axis=0) if len(faces) else 0.0
        mesh = trimesh.Trimesh(vertices - self._origin, faces, process=False)
        corners = mesh.vertices[mesh.faces]
        self._corner = corners[:, 0]
        self._normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._intersector = RayMeshIntersector(mesh) if len(faces) else None

    def cast(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """Lengths t (N,) of the rays up to their first hits, NaN without one; see `hits`."""
        return self.hits(origin, directions).t

    def hits(self, origin: FloatArray, directions: FloatArray) -> Hits:
        """First hits of rays origin + t * direction, t > 0, from one origin.

        Embree (single precision) finds the triangle, its plane gives t in double precision.

        Args:
            origin: (3,) start of every ray.
            directions: (N, 3), of any length.
        """
        start = origin - self._origin
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        hit = np.full(len(unit), -1)
        if self._intersector is not None:
            hit = self._intersector.intersects_first(np.broadcast_to(start, unit.shape), unit)
        distance, normals = np.full(len(directions), np.nan), np.full((len(directions), 3), np.nan)
        rays = np.flatnonzero(hit >= 0)
        normal = self._normal[hit[rays]]
        ahead = np.einsum("ij,ij->i", self._corner[hit[rays]] - start, normal)
        along = np.einsum("ij,ij->i", directions[rays], normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ahead / along
        met = np.isfinite(t) & (t > 0)
        rays, normal = rays[met], normal[met]
        distance[rays] = t[met]
        facing = -np.sign(along[met]) / np.linalg.norm(normal, axis=1)
        normals[rays] = normal * facing[:, None]
        return Hits(distance, normals)

    def depth_at(self, view: View, pixels: FloatArray) -> FloatArray:
        """Depths (N,) along the optical axis of `view` at `pixels` (N, 2); NaN off the mesh."""
        return self.cast(view.center, view.rays(pixels))


def seen_in(
    view: View, points: FloatArray, caster: RayCaster | None
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Projections (N, 2) of `points` (N, 3), their depths (N,), and which the view sees (N,).

    A point is seen if it is inside the image and no surface is hit more than three pixels' length
    (at the point's depth) in front of it; the tolerance allows for the surface's own triangles.
    """
    pixels, depths = view.project(points)
    seen = view.holds(pixels, depths)
    if caster is not None and seen.any():
        along = caster.cast(view.center, points[seen] - view.center)
        seen[seen] = ~(along < 1 - 3 / view.focal_px)
    return pixels, depths, seen
