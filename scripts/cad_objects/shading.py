"""Rendering of a mesh by ray casting: matte gray, three lamps, white background."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import trimesh
from demo_scene.cameras import look_at
from trimesh.ray.ray_pyembree import RayMeshIntersector

SIZE, FOCAL = 800, 1111.0  # pixels
DISTANCE = 4.0  # distance of the cameras from the origin, at which they look
NUM_VIEWS = 50
RAYS = 3  # rays per pixel along each of its sides
CREASE = np.radians(15)  # minimum angle between two faces that meet in an edge
NOISE = 0.4  # standard deviation, gray levels
AMBIENT = 0.16
LAMPS = (((1, -0.6, 1.2), 0.34), ((-1, 0.4, -0.7), 0.2), ((-0.3, 1, 0.5), 0.14))
TURN_DEG = 180 * (3 - np.sqrt(5))  # golden angle between successive views, to spread them evenly


def make_model(num_views: int = NUM_VIEWS, size: int = SIZE) -> pycolmap.Reconstruction:
    """Posed views of (size, size) pixels spread evenly over a sphere, without any point."""
    model = pycolmap.Reconstruction()
    focal = FOCAL * size / SIZE
    parameters = [focal, focal, size / 2, size / 2]
    camera = pycolmap.Camera(
        camera_id=1, model="PINHOLE", width=size, height=size, params=parameters
    )
    model.add_camera_with_trivial_rig(camera)
    for i, height in enumerate(1 - 2 * (np.arange(num_views) + 0.5) / num_views):
        azimuth, elevation = 90 + TURN_DEG * i, np.degrees(np.arcsin(height))
        view = look_at(f"{i:02d}.jpg", DISTANCE, azimuth, elevation, (0, 0, 0), 0)
        image = pycolmap.Image(name=view.name, camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(view.cam_from_world))
    return model


def render(mesh: trimesh.Trimesh, model: pycolmap.Reconstruction, folder: Path) -> None:
    """Render the images of the model."""
    smooth = trimesh.graph.smooth_shade(mesh, angle=CREASE)
    caster = RayMeshIntersector(smooth)
    random = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    for image in model.images.values():
        light = brightness(smooth, caster, image)
        gray = 255 * light ** (1 / 2.2) + random.normal(0, NOISE, light.shape)
        pixels = np.clip(np.rint(gray), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / image.name), pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])


def brightness(
    mesh: trimesh.Trimesh, caster: RayMeshIntersector, image: pycolmap.Image
) -> np.ndarray:
    """(S, S) light from 0 to 1 of a square image, the mean of the rays through each pixel."""
    size, focal, cam_from_world = image.camera.width, image.camera.params[0], image.cam_from_world()
    rotation = cam_from_world.rotation.matrix()
    center = -rotation.T @ cam_from_world.translation
    local = mesh.vertices @ rotation.T + cam_from_world.translation
    pixels = focal * local[:, :2] / local[:, 2:] + size / 2
    first = np.clip(pixels.min(axis=0).astype(int) - 1, 0, size)
    last = np.clip(pixels.max(axis=0).astype(int) + 2, 0, size)
    x, y = (
        (np.arange(low * RAYS, high * RAYS) + 0.5) / RAYS
        for low, high in zip(first, last, strict=True)
    )
    at = (np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) - size / 2) / focal
    rays = np.column_stack([at, np.ones(len(at))]) @ rotation
    origins = np.broadcast_to(center, rays.shape)
    places, hit, faces = caster.intersects_location(origins, rays, multiple_hits=False)
    values = np.ones(len(rays))
    values[hit] = np.clip(lamplight(normals_at(mesh, places, faces)), 0, 1)
    light = np.ones((size, size))
    means = values.reshape(last[1] - first[1], RAYS, last[0] - first[0], RAYS).mean(axis=(1, 3))
    light[first[1] : last[1], first[0] : last[0]] = means
    return light


def normals_at(mesh: trimesh.Trimesh, places: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(N, 3) normals at (N, 3) places on (N,) faces, between those of the corners."""
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[faces], places)
    normals = np.einsum("ij,ijk->ik", weights, mesh.vertex_normals[mesh.faces[faces]])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def lamplight(normals: np.ndarray) -> np.ndarray:
    """(N,) light that matte faces of (N, 3) normals reflect."""
    directions = np.array([direction for direction, _ in LAMPS], float)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    strengths = np.array([strength for _, strength in LAMPS])
    return AMBIENT + 0.05 * normals[:, 2] + np.maximum(normals @ directions.T, 0) @ strengths
