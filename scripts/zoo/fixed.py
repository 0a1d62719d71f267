"""Makes the scenes that nothing is drawn for: the rooms, and the CAD objects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import trimesh
from manifold3d import Manifold
from trimesh.graph import smooth_shade
from trimesh.ray.ray_pyembree import RayMeshIntersector

from zoo.camera import Grid, Rig, Size, View, look_at, pinhole
from zoo.casting import Caster
from zoo.curves import curves_by_kind
from zoo.geometry import Array, Surface, unit, unite
from zoo.machined import OBJECTS
from zoo.plans import ROOMS
from zoo.points import posed_model
from zoo.radiosity import illuminate
from zoo.render import Lit, Sensor, see, typical_light, write_image
from zoo.truth import cut_curves, write_truth

CREASE = np.radians(15)  # minimum angle between two faces of an object that meet in an edge
LAMPS = (((1, -0.6, 1.2), 0.34), ((-1, 0.4, -0.7), 0.2), ((-0.3, 1, 0.5), 0.14))


def make_room(
    name: str, folder: Path, size: Size | None = None, num_views: int | None = None, seed: int = 0
) -> str:
    """Write a room: images/, sparse/ (true poses and SIFT points), surface.ply, curves.npz.

    Args:
        name: One of `ROOMS`.
        folder: Where to write; created.
        size: Of the images, pixels; default: 640x480.
        num_views: The first views; default: all.
        seed: Of noise, and of the rays that carry light.

    Returns:
        What was made, in a few words.
    """
    from colmap_edges.evaluation.triangulation import PosedImage, triangulate

    room, (width, height) = ROOMS[name](), size or (640, 480)
    camera = pinhole((width, height), 430 / 640 * width)  # 73 degrees across
    rig, surface = Rig(camera, room.views[:num_views]), unite(room.bodies)
    curves, _, _ = cut_curves(surface, room.bodies, spacing=0.01)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    write_truth(folder, surface, room.bodies, curves, face_body=surface.face_body.astype(np.uint8))
    # Light is computed for triangles with sides of 0.1 metres, and longer ones in smaller images.
    lit = illuminate(unite(room.bodies, longest=0.1 * max(1, 640 / width)), room, seed)
    grid, step = Grid.of(camera), max(1, width // 32)
    some = grid.centers.reshape(height, width, 2)[::step, ::step].reshape(-1, 2)
    lit = replace(lit, white=typical_light(lit, rig, some, 60) / 0.45)
    sensor = Sensor(blur_px=0.45, noise=0.5, shot_noise=0.9, soft=True)
    posed = []
    for number, view in enumerate(rig.views):
        random = np.random.default_rng([seed, number])
        write_image(folder / "images" / view.name, see(lit, view, grid), sensor, random)
        rotation, translation = view.cam_from_world[:, :3], view.cam_from_world[:, 3]
        posed.append(
            PosedImage(
                name=view.name, width=width, height=height, rotation=rotation,
                translation=translation, calibration=camera.calibration_matrix(),
            )
        )  # fmt: skip
    model = triangulate(posed, folder / "images", folder / "sparse", num_threads=1)
    return (
        f"{name}: {len(surface.faces)} triangles, {len(curves.edges)} segments of curves, "
        f"{len(rig.views)} views, {model.num_points3D()} points"
    )


def make_object(
    name: str, folder: Path, size: Size | None = None, num_views: int | None = None, seed: int = 0
) -> str:
    """Write a textureless object: images/, sparse/ (poses only), surface.ply and curves.npz.

    curves.npz holds the curve of each edge of the mesh, and kind and radii of each curve. Arguments
    are those of `make_room`; there are 50 views of 800x800 pixels unless asked for others.
    """
    mesh = mesh_of(OBJECTS[name]())
    for part in ("sparse", "images"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    mesh.export(folder / "surface.ply")
    points, edges = sharp_curves(mesh)
    curves, kinds, radii = curves_by_kind(points, edges)
    truth = {"points": points, "edges": edges, "curves": curves, "kinds": kinds, "radii": radii}
    np.savez_compressed(folder / "curves.npz", **truth)
    width, height = size or (800, 800)
    camera = pinhole((width, height), 1111 * width / 800)
    views = all_around(num_views or 50)
    model = posed_model(Rig(camera, views))
    model.write(folder / "sparse")
    lit, grid, random = ObjectLit.of(mesh), Grid.of(camera), np.random.default_rng(seed)
    for view in (views[i - 1] for i in model.images):  # in the model's order, as the noise follows
        write_image(folder / "images" / view.name, see(lit, view, grid), Sensor(noise=0.4), random)
    return f"{name}: {len(mesh.faces)} triangles, {len(kinds)} sharp curves"


def mesh_of(solid: Manifold) -> trimesh.Trimesh:
    """The closed surface of a solid, centred in the unit box, with its longest side 1."""
    bounds = np.array(solid.bounding_box()).reshape(2, 3)
    scale = 1 / float(np.ptp(bounds, axis=0).max())
    centered = solid.translate(tuple(-bounds.mean(axis=0))).scale((scale, scale, scale))
    mesh = centered.translate((0.5, 0.5, 0.5)).to_mesh64()
    return trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], mesh.tri_verts)


def sharp_curves(mesh: trimesh.Trimesh) -> tuple[Array, np.ndarray]:
    """(P, 3) points and (E, 2) edges at which faces meet at `CREASE` or more."""
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles >= CREASE]
    used, edges = np.unique(sharp, return_inverse=True)
    return mesh.vertices[used], edges.reshape(sharp.shape).astype(np.int32)


def all_around(count: int) -> list[View]:
    """Views spread evenly over a sphere, successive ones by the golden angle."""
    heights = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = 180 * (3 - np.sqrt(5))
    return [
        look_at(f"{i:02d}.jpg", 4.0, 90 + turn * i, np.degrees(np.arcsin(height)), (0, 0, 0), 0)
        for i, height in enumerate(heights)
    ]


class ObjectCaster(Caster):
    """Scales rays as trimesh does, so that objects look as in docs/results.md."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        """Build the acceleration structure."""
        vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
        none = np.zeros(len(faces), np.int32)
        super().__init__(Surface(vertices=vertices, faces=faces, face_body=none))
        self.intersector = RayMeshIntersector(mesh)

    def first(self, starts: Array, rays: Array) -> np.ndarray:
        """First triangles (N,) that rays hit, -1 for none; see `hits`."""
        origins, found = np.broadcast_to(starts, rays.shape), np.full(len(rays), -1)
        faces, hit = self.intersector.intersects_id(origins, rays, multiple_hits=False)
        found[hit] = faces
        return found


@dataclass(frozen=True, kw_only=True)
class ObjectLit(Lit):
    """A matte gray mesh under three lamps before white; `vectors` (K, 3) are its normals."""

    @classmethod
    def of(cls, mesh: trimesh.Trimesh) -> ObjectLit:
        """Smooth but for the creases."""
        smooth = smooth_shade(mesh, angle=CREASE)
        caster = ObjectCaster(smooth)
        faces, labels = caster.surface.faces, caster.surface.face_body
        return cls(caster=caster, corners=faces, vectors=smooth.vertex_normals, labels=labels)

    def shade(
        self, faces: np.ndarray, centre: Array, rays: np.ndarray, where: np.ndarray
    ) -> tuple[Array, tuple[int, ...]]:
        """Light that reaches a face from the lamps and from all around."""
        normals = unit(self.between(faces, where))
        directions = unit(np.array([direction for direction, _ in LAMPS], float))
        strengths = np.array([strength for _, strength in LAMPS])
        lamps = np.maximum(normals @ directions.T, 0) @ strengths
        return np.clip(0.16 + 0.05 * normals[:, 2] + lamps, 0, 1)[:, None], (0, 0, 1, 1)

    def background(self, rays: np.ndarray) -> float:
        """White."""
        return 1.0

    def is_rough(self, labels: np.ndarray) -> np.ndarray:
        """The object and what is next to it."""
        return cv2.dilate((labels >= 0).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0


FIXED = {"rooms": (ROOMS, make_room), "cad": (OBJECTS, make_object)}
