"""A lamp, the sky and gloss: light that falls on bodies directly, for the random scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pycolmap

from zoo.camera import Place, direction
from zoo.casting import Caster
from zoo.geometry import Array, Body, Random, Surface, dot, unit, unite_shaded
from zoo.materials import Material, painted
from zoo.render import Lit

RAYS = 12  # through a pixel at borders; their rows and columns are all different
PARTS = 1 / 6  # triangles per pixel, about, between which light is interpolated; those of the
MIN_PARTS = 1 / 20  # bodies count, and at least so many are of the size that follows
SKY_RAYS, LAMP_RAYS = 72, 20
CLEAR = 1e-4  # of the scene's size, that rays start above a surface
INWARDS = 0.3  # of the way from a vertex to the middle of its triangles


@dataclass(frozen=True, kw_only=True)
class Light:
    """A round lamp, and light from all around."""

    position: Array  # (3,) of the lamp; the sun is a lamp far away
    radius: float  # of the lamp, for soft shadows
    strength: float  # light of the lamp on a face at the scene's middle that it shines on squarely
    ambient: float  # light from straight above where nothing hides the sky
    below: float = 0.4  # the same from below, as a share of `ambient`
    reach: float = np.inf  # bodies farther away than this do not hide ambient light


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A scene before it is seen."""

    bodies: list[Body]  # what is there; they may overlap
    materials: dict[str, Material]  # of the bodies, by name
    light: Light  # the lamp and the sky
    place: Place  # where cameras may be
    # Gives the light (N, 3) of unit directions (N, 3) without a surface, of 1 at white.
    background: Callable[[Array], Array]
    facts: dict[str, Any] = field(default_factory=dict)  # what was drawn, for scene.json
    exposure: float = 1.0  # 1: right; more: bodies are saturated


def sun(random: Random, extent: float, towards_deg: tuple[float, float] = (0, 360)) -> Light:
    """A lamp far above a scene about the origin, and the sky."""
    azimuth = np.radians(random.uniform(*towards_deg))
    towards = direction(azimuth, np.radians(random.uniform(30, 65)))
    distance = 50 * extent
    share = random.uniform(0.35, 0.75)  # of the light that comes from the lamp
    radius = distance * np.tan(np.radians(random.uniform(4, 15)))
    return Light(position=distance * towards, radius=radius, strength=share, ambient=1 - share)


def plain(level: tuple[float, ...]) -> Callable[[Array], Array]:
    """A background of one colour."""
    return lambda rays: np.broadcast_to(np.asarray(level), rays.shape)


@dataclass(frozen=True, kw_only=True)
class LampLit(Lit):
    """A finely cut surface with its normals, and the light that reaches its vertices.

    `vectors` (V, 5) hold of each vertex: normal, share of the lamp that it sees, and light from all
    around.
    """

    stage: Stage  # the scene
    light: Light  # the lamp
    pixel: float  # size of a pixel at distance 1

    precision = np.float32
    offsets = np.column_stack(
        [np.arange(RAYS), np.argsort(np.argsort(np.modf((np.arange(RAYS) + 0.5) * 0.618034)[0]))]
    )
    offsets = (offsets + 0.5) / RAYS - 0.5
    max_light = max_alone = 1.5

    def background(self, rays: np.ndarray) -> Array:
        """Of the stage."""
        return self.stage.background(rays)

    def shade(
        self, faces: np.ndarray, centre: Array, rays: np.ndarray, where: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light from the lamp, from all around, and of highlights."""
        values, distance = self.between(faces, where), where[:, 3]
        values[:, :3] = unit(values[:, :3])
        normals, seen, sky = values[:, :3], values[:, 3], values[:, 4]
        stage, light = self.stage, self.light
        places = centre.astype(np.float32) + distance[:, None] * rays
        to_lamp = light.position.astype(np.float32) - places
        fall = np.sum((light.position - stage.place.middle) ** 2) / dot(to_lamp, to_lamp)
        to_lamp, towards = unit(to_lamp), -unit(rays)
        lamp = np.float32(light.strength) * fall.astype(np.float32) * seen
        diffuse = sky + lamp * np.maximum(dot(to_lamp, normals), 0)
        footprint = np.float32(self.pixel) * distance / np.maximum(dot(towards, normals), 0.05)
        result, body = np.empty(places.shape, np.float32), self.labels[faces]
        for i in np.unique(body):
            own = np.flatnonzero(body == i)
            material = stage.materials[stage.bodies[i].material]
            paint = painted(material, places[own], int(i), footprint[own])
            result[own] = paint * diffuse[own, None] + np.float32(material.emission)
            if material.gloss:
                ways = (normals[own], towards[own], to_lamp[own])
                result[own] += shine(material, stage, *ways, lamp[own])[:, None]
        geometry = np.column_stack([normals, distance])
        return result / np.float32(self.white), geometry

    def relit(self, light: Light) -> LampLit:
        """The same with the lamp elsewhere."""
        normals = self.vectors[:, :3].astype(np.float64)
        vectors = self.vectors.copy()
        starts = light_points(self.caster, normals)
        vectors[:, 3] = lamp_share(self.caster, starts, normals, light)
        return replace(self, vectors=vectors, light=light)


def illuminate(stage: Stage, surface: Surface, camera: pycolmap.Camera) -> LampLit:
    """Light a stage whose united surface is given."""
    pixels = camera.width * camera.height
    parts = max(PARTS * pixels - len(surface.faces), MIN_PARTS * pixels)
    area = float(np.linalg.norm(surface.crosses, axis=1).sum() / 2)
    fine, normals = unite_shaded(stage.bodies, 2 * np.sqrt(area / parts))
    caster = Caster(fine)
    starts = light_points(caster, normals)
    seen = lamp_share(caster, starts, normals, stage.light)
    sky = ambient(caster, starts, normals, stage.light)
    return LampLit(
        caster=caster,
        corners=fine.faces,
        vectors=np.column_stack([normals, seen, sky]).astype(np.float32),
        labels=fine.face_body,
        stage=stage,
        light=stage.light,
        pixel=1 / camera.focal_length_x,
    )


def light_points(caster: Caster, normals: Array) -> Array:
    """(V, 3) points for which light is computed: vertices, moved off the borders of their faces.

    On a border they would lie in the plane of the next face, which hides all or nothing.
    """
    surface = caster.surface
    centers = surface.corners.mean(axis=1)
    total, count = np.zeros_like(normals), np.zeros(len(normals))
    for corner in surface.faces.T:
        np.add.at(total, corner, centers)
        np.add.at(count, corner, 1)
    step = INWARDS * (total / np.maximum(count, 1)[:, None] - surface.vertices)
    moved = surface.vertices + step - dot(step, normals)[:, None] * normals
    return moved + CLEAR * caster.unit * normals


def sphere(count: int) -> Array:
    """(count, 3) directions spread evenly over a sphere."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])


def ambient(caster: Caster, starts: Array, normals: Array, light: Light) -> Array:
    """(N,) light from all around that reaches points with normals (N, 3)."""
    total = np.zeros(len(starts))
    for towards in sphere(SKY_RAYS):
        cosine = normals @ towards
        facing = np.flatnonzero(cosine > 0)
        rays = np.broadcast_to(towards, (len(facing), 3))
        found, distance = caster.hits(starts[facing], rays)
        free = (found < 0) | (distance > light.reach)
        brightness = light.ambient * (light.below + (1 - light.below) * (1 + towards[2]) / 2)
        total[facing] += 4 / SKY_RAYS * brightness * cosine[facing] * free
    return total


def lamp_share(caster: Caster, starts: Array, normals: Array, light: Light) -> Array:
    """(N,) share of the lamp that points with normals (N, 3) see."""
    total = np.zeros(len(starts))
    for spot in sphere(LAMP_RAYS) * light.radius + light.position:
        rays = spot - starts
        facing = np.flatnonzero(dot(rays, normals) > 0)
        found, distance = caster.hits(starts[facing], rays[facing])
        total[facing] += (found < 0) | (distance > 1)
    return total / LAMP_RAYS


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
