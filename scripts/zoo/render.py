"""Light on a stage and images of it: ray casting, soft shadows, gloss, anti-aliasing, noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from demo_scene.cameras import TrueCamera
from demo_scene.geometry import Surface, face_normals, unite_shaded
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from zoo.camera import Grid
from zoo.stage import Array, Light, Material, Random, Stage, blotches

RAYS = 12  # through a pixel at borders; their rows and columns are all different
PARTS = 1 / 6  # triangles per pixel, about, between which light is interpolated; those of the
MIN_PARTS = 1 / 20  # bodies count, and at least so many are of the size that follows
SKY_RAYS, LAMP_RAYS = 72, 20
CLEAR = 1e-4  # of the scene's size, that rays start above a surface
INWARDS = 0.3  # of the way from a vertex to the middle of its triangles
MAX_LIGHT = 1.5  # of a ray, of 1 at white, so that lights do not bleed over their borders
TURN = np.cos(np.radians(10))  # between the normals of neighbouring pixels at a crease
BRIGHT = 0.75  # light, of 1 at white, that typical bright pixels are exposed to
STEP = 0.01  # relative, between the depths of neighbouring pixels at a border
GAMMA = 2.2


def dot(a: Array, b: Array) -> Array:
    """(N,) products of vectors (N, 3)."""
    return np.einsum("ij,ij->i", a, b)


class Caster:
    """Triangles for ray casting in single precision; depths come from the planes in double."""

    def __init__(self, surface: Surface) -> None:
        """Build the acceleration structure."""
        self.origin = surface.vertices.mean(axis=0)
        self.unit = float(np.abs(surface.vertices - self.origin).max())
        self.corner = surface.vertices[surface.faces[:, 0]]
        self.normals = face_normals(surface)
        self.scene = EmbreeScene()
        vertices = ((surface.vertices - self.origin) / self.unit).astype(np.float32)
        self.mesh = TriangleMesh(self.scene, vertices, surface.faces.astype(np.int32))

    def hits(self, starts: Array, rays: Array) -> tuple[np.ndarray, Array]:
        """First triangles (N,) that rays hit, -1 for none, and distances, infinite for none.

        Args:
            starts: (N, 3), or (3,) for all rays.
            rays: (N, 3); the unit of the distances is their length.
        """
        near = ((starts - self.origin) / self.unit).astype(np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(near, rays.shape))
        found = np.asarray(self.scene.run(origins, np.ascontiguousarray(rays, np.float32)))
        hit = np.flatnonzero(found >= 0)
        corners, normals = self.corner[found[hit]], self.normals[found[hit]]
        ahead = corners - (starts if starts.ndim == 1 else starts[hit])
        distance = np.full(len(rays), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance[hit] = dot(ahead, normals) / dot(rays[hit], normals)
        return found, distance

    def seen(self, start: Array, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What rays (N, 3) float32 from one place show, in single precision.

        Returns:
            Indices (M,) of the rays that hit, triangles (M,), and (M, 4) weights of their corners
            and distances in rays.
        """
        near = ((start - self.origin) / self.unit).astype(np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(near, rays.shape))
        found = self.scene.run(origins, rays, output=1)
        hit = np.flatnonzero(found["primID"] >= 0)
        u, v, distance = found["u"][hit], found["v"][hit], found["tfar"][hit] * self.unit
        return hit, found["primID"][hit], np.column_stack([1 - u - v, u, v, distance])


@dataclass(frozen=True, kw_only=True)
class Lit:
    """A finely cut surface with its normals, and the light that reaches its vertices.

    Attributes:
        surface: The triangles.
        caster: The same for ray casting.
        vectors: (V, 5) float32 of each vertex: normal, share of the lamp that it sees, and light
            from all around.
        stage: The scene.
        light: The lamp.
        pixel: Size of a pixel at distance 1.
        white: Light that is shown as 255.
    """

    surface: Surface
    caster: Caster
    vectors: np.ndarray
    stage: Stage
    light: Light
    pixel: float
    white: float = 1.0


def area(surface: Surface) -> float:
    """Area of the triangles."""
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def illuminate(stage: Stage, surface: Surface, camera: pycolmap.Camera) -> Lit:
    """Light a stage whose united surface is given."""
    pixels = camera.width * camera.height
    parts = max(PARTS * pixels - len(surface.faces), MIN_PARTS * pixels)
    fine, normals = unite_shaded(stage.bodies, 2 * np.sqrt(area(surface) / parts))
    caster = Caster(fine)
    starts = light_points(fine, normals) + CLEAR * caster.unit * normals
    seen = lamp_share(caster, starts, normals, stage.light)
    sky = ambient(caster, starts, normals, stage.light)
    return Lit(
        surface=fine,
        caster=caster,
        vectors=np.column_stack([normals, seen, sky]).astype(np.float32),
        stage=stage,
        light=stage.light,
        pixel=1 / camera.focal_length_x,
    )


def relit(lit: Lit, light: Light) -> Lit:
    """The same with the lamp elsewhere."""
    normals = lit.vectors[:, :3].astype(np.float64)
    starts = light_points(lit.surface, normals) + CLEAR * lit.caster.unit * normals
    vectors = lit.vectors.copy()
    vectors[:, 3] = lamp_share(lit.caster, starts, normals, light)
    return replace(lit, vectors=vectors, light=light)


def light_points(surface: Surface, normals: Array) -> Array:
    """(V, 3) points for which light is computed: vertices, moved off the borders of their faces.

    On a border they would lie in the plane of the next face, which hides all or nothing.
    """
    centers = surface.vertices[surface.faces].mean(axis=1)
    total, count = np.zeros_like(normals), np.zeros(len(normals))
    for corner in surface.faces.T:
        np.add.at(total, corner, centers)
        np.add.at(count, corner, 1)
    step = INWARDS * (total / np.maximum(count, 1)[:, None] - surface.vertices)
    return surface.vertices + step - dot(step, normals)[:, None] * normals


def sphere(count: int) -> Array:
    """(count, 3) directions spread evenly over a sphere."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])


def ambient(caster: Caster, starts: Array, normals: Array, light: Light) -> Array:
    """(N,) light from all around that reaches points with normals (N, 3)."""
    total = np.zeros(len(starts))
    for direction in sphere(SKY_RAYS):
        cosine = normals @ direction
        facing = np.flatnonzero(cosine > 0)
        rays = np.broadcast_to(direction, (len(facing), 3))
        found, distance = caster.hits(starts[facing], rays)
        free = (found < 0) | (distance > light.reach)
        brightness = light.ambient * (light.below + (1 - light.below) * (1 + direction[2]) / 2)
        total[facing] += 4 / SKY_RAYS * brightness * cosine[facing] * free
    return total


def lamp_share(caster: Caster, starts: Array, normals: Array, light: Light) -> Array:
    """(N,) share of the lamp that points with normals (N, 3) see."""
    spots = sphere(LAMP_RAYS) * light.radius + light.position
    total = np.zeros(len(starts))
    for spot in spots:
        rays = spot - starts
        facing = np.flatnonzero(dot(rays, normals) > 0)
        found, distance = caster.hits(starts[facing], rays[facing])
        total[facing] += (found < 0) | (distance > 1)
    return total / LAMP_RAYS


def trace(lit: Lit, camera: TrueCamera, at: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Light through image coordinates (N, 2): (N, 3), bodies (N,), -1: none, (N, 4) geometry.

    Geometry is the normal and the distance.
    """
    rays = np.column_stack([at, np.ones(len(at))]) @ camera.cam_from_world[:, :3]
    rays = rays.astype(np.float32)
    hit, faces, where = lit.caster.seen(camera.centre(), rays)
    body = np.full(len(rays), -1)
    body[hit] = lit.surface.face_body[faces]
    light = np.empty(rays.shape, np.float32)
    light[body < 0] = lit.stage.background(unit(rays[body < 0]))
    corners = lit.surface.faces[faces]
    values = sum(where[:, i, None] * lit.vectors[corners[:, i]] for i in range(3))
    values[:, :3] = unit(values[:, :3])
    geometry = np.zeros((len(rays), 4), np.float32)
    geometry[hit] = np.column_stack([values[:, :3], where[:, 3]])
    shown = reflect(lit, body[hit], camera.centre(), rays[hit], where[:, 3], values)
    light[hit] = shown / np.float32(lit.white)
    return light, body, geometry


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of length 1."""
    return vectors / np.sqrt(dot(vectors, vectors))[:, None]


def reflect(
    lit: Lit,
    body: np.ndarray,
    centre: Array,
    rays: np.ndarray,
    distance: np.ndarray,
    values: np.ndarray,
) -> np.ndarray:
    """(N, 3) light that bodies (N,) send back along rays (N, 3), given `Lit.vectors` there."""
    stage, light = lit.stage, lit.light
    normals, seen, sky = values[:, :3], values[:, 3], values[:, 4]
    places = centre.astype(np.float32) + distance[:, None] * rays
    to_lamp = light.position.astype(np.float32) - places
    fall = np.sum((light.position - stage.place.middle) ** 2) / dot(to_lamp, to_lamp)
    to_lamp, towards = unit(to_lamp), -unit(rays)
    lamp = np.float32(light.strength) * fall.astype(np.float32) * seen
    diffuse = sky + lamp * np.maximum(dot(to_lamp, normals), 0)
    footprint = np.float32(lit.pixel) * distance / np.maximum(dot(towards, normals), 0.05)
    result = np.empty(places.shape, np.float32)
    for i in np.unique(body):
        own = np.flatnonzero(body == i)
        material = stage.materials[stage.bodies[i].material]
        paint = painted(material, places[own], footprint[own], int(i))
        result[own] = paint * diffuse[own, None] + np.float32(material.emission)
        if material.gloss:
            ways = (normals[own], towards[own], to_lamp[own])
            result[own] += shine(material, stage, *ways, lamp[own])[:, None]
    return result


def painted(material: Material, places: Array, footprint: Array, seed: int) -> Array:
    """(N, 3) albedo of a material at places; its mean over footprints (N,)."""
    albedo = np.broadcast_to(np.array(material.albedo, np.float32), places.shape)
    if not material.contrast:
        return albedo
    field = blotches(places, material.size, seed, footprint)
    return np.minimum(albedo * np.clip(1 + material.contrast * field, 0.1, 2.0)[:, None], 0.95)


def shine(
    material: Material, stage: Stage, normals: Array, towards: Array, to_lamp: Array, lamp: Array
) -> Array:
    """(N,) light of highlights of the lamp, and of the sky's mirror image."""
    middle = np.maximum(dot(unit(towards + to_lamp), normals), 0)
    power = material.shininess
    highlight = (power + 8) / 8 * middle**power * lamp
    cosine = dot(towards, normals)
    up = 2 * cosine * normals[:, 2] - towards[:, 2]  # of the mirrored ray
    fresnel = 0.25 + 0.75 * (1 - np.clip(cosine, 0, 1)) ** 5
    mirror = stage.light.ambient * (0.5 + 0.5 * np.tanh(3 * up))
    return material.gloss * (highlight + fresnel * mirror)


def see(lit: Lit, camera: TrueCamera, grid: Grid, size: tuple[int, int]) -> np.ndarray:
    """(H, W, 3) light; many rays a pixel where neighbours show another face."""
    light, body, geometry = trace(lit, camera, grid.centers)
    light = np.minimum(light, MAX_LIGHT)
    chosen = np.flatnonzero(borders(body, geometry, size))
    lattice = (np.arange(RAYS) + 0.5) / RAYS
    offsets = np.column_stack([lattice, np.modf(lattice * RAYS * 0.618034)[0]])
    offsets[:, 1] = (np.argsort(np.argsort(offsets[:, 1])) + 0.5) / RAYS
    finer, _, _ = trace(lit, camera, grid.within(chosen, offsets - 0.5))
    light[chosen] = np.minimum(finer, MAX_LIGHT).reshape(len(chosen), RAYS, 3).mean(axis=1)
    return light.reshape(size[1], size[0], 3)


def borders(body: np.ndarray, geometry: Array, size: tuple[int, int]) -> np.ndarray:
    """(H * W,) whether a pixel differs from one of its eight neighbours in what it shows.

    A straight border that crosses a pixel beside its centre leaves a neighbour on its other side.
    """
    shape = (size[1], size[0])
    body, geometry = body.reshape(shape), geometry.reshape(*shape, 4)
    found = np.zeros(shape, bool)
    after, before, every = np.s_[1:], np.s_[:-1], np.s_[:]
    pairs = (
        ((every, after), (every, before)),
        ((after, every), (before, every)),
        ((after, after), (before, before)),
        ((after, before), (before, after)),
    )
    for one, other in pairs:
        a, b = geometry[one], geometry[other]
        differs = np.einsum("ijk,ijk->ij", a[..., :3], b[..., :3]) < TURN
        differs |= np.abs(a[..., 3] - b[..., 3]) > STEP * np.minimum(a[..., 3], b[..., 3])
        differs &= (body[one] >= 0) | (body[other] >= 0)
        differs |= body[one] != body[other]
        found[one] |= differs
        found[other] |= differs
    return found.ravel()


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """How light becomes a file.

    Attributes:
        gain: Of this view, relative to the others.
        blur_px: Standard deviation of the lens's blur.
        noise: Standard deviation of the noise in dark places, gray levels.
        shot_noise: The same of the part that grows with light, at white.
        quality: Of the JPEG; 0: PNG.
    """

    gain: float
    blur_px: float
    noise: float
    shot_noise: float
    quality: int


def write_image(path: Path, light: np.ndarray, sensor: Sensor, random: Random) -> np.ndarray:
    """Blur, expose, add noise and write; returns the (H, W, 3) gray levels without noise."""
    blurred = cv2.GaussianBlur(light, (0, 0), sensor.blur_px) * sensor.gain
    gray = 255 * np.clip(blurred, 0, 1) ** (1 / GAMMA)
    deviation = np.hypot(sensor.noise, sensor.shot_noise * np.sqrt(gray / 255))
    noisy = gray + random.standard_normal(gray.shape, np.float32) * deviation
    pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, sensor.quality] if sensor.quality else []
    cv2.imwrite(str(path), pixels[..., ::-1], options)
    return gray


def exposed(lit: Lit, cameras: list[TrueCamera], grid: Grid, percentile: float) -> Lit:
    """The same with the light of that percentile of the pixels with a body as `BRIGHT`."""
    seen = []
    for camera in cameras:
        light, body, _ = trace(lit, camera, grid.centers[:: max(1, len(grid.centers) // 2000)])
        seen.append(light[body >= 0].mean(axis=1))
    level = float(np.percentile(np.concatenate(seen), percentile))
    return replace(lit, white=level / BRIGHT / lit.stage.exposure)
