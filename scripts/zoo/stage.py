"""What a family gives to the maker of scenes: bodies, materials, light, and where views may be."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from demo_scene.bodies import Body
from numpy.typing import NDArray

Array = NDArray[np.float64]
Random = np.random.Generator
OCTAVES, WAVES = 4, 6  # of blotches
BEND = np.float32(0.8)  # of waves by the longer ones, so that no pattern repeats


@dataclass(frozen=True, kw_only=True)
class Material:
    """How a surface looks.

    Attributes:
        albedo: Share of red, green and blue light that it reflects to all sides.
        contrast: Standard deviation of its blotches over their mean; 0: plain.
        size: Length of the longest blotches, in units of the scene; the shortest are 1/8 of it.
        gloss: Share of light in highlights and mirror images; 0: matte.
        shininess: Exponent of the highlights (Blinn and Phong).
        emission: Emitted light, in units of the light reflected by a white face.
    """

    albedo: tuple[float, float, float]
    contrast: float = 0.0
    size: float = 0.3
    gloss: float = 0.0
    shininess: float = 60.0
    emission: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Light:
    """A round lamp, and light from all around.

    Attributes:
        position: (3,) of the lamp; the sun is a lamp far away.
        radius: Of the lamp, for soft shadows.
        strength: Light of the lamp on a face at the scene's middle that it shines on squarely.
        ambient: Light from straight above where nothing hides the sky.
        below: The same from below, as a share of `ambient`.
        reach: Bodies farther away than this do not hide ambient light.
    """

    position: Array
    radius: float
    strength: float
    ambient: float
    below: float = 0.4
    reach: float = np.inf


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where cameras may stand: around `middle`, or at `spots` that each look at a target.

    Attributes:
        middle: (3,) point that views look at.
        extent: Radius around it that they show.
        azimuth_deg: Span of directions that they look from; 0 is the front, towards -y.
        elevation_deg: Span of elevations.
        spots: Positions and targets where there is no free circle around the scene.
    """

    middle: Array
    extent: float
    azimuth_deg: tuple[float, float] = (0.0, 360.0)
    elevation_deg: tuple[float, float] = (10.0, 50.0)
    spots: list[tuple[Array, Array]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A scene before it is seen.

    Attributes:
        bodies: What is there; they may overlap.
        materials: Of the bodies, by name.
        light: The lamp and the sky.
        place: Where cameras may be.
        background: Gives the light (N, 3) of unit directions (N, 3) without a surface, of 1 at
            white.
        facts: What was drawn, for scene.json.
        exposure: 1: right; more: bodies are saturated.
    """

    bodies: list[Body]
    materials: dict[str, Material]
    light: Light
    place: Place
    background: Callable[[Array], Array]
    facts: dict[str, Any]
    exposure: float = 1.0


def colour(random: Random, value: tuple[float, float] = (0.25, 0.7)) -> tuple[float, float, float]:
    """A random albedo, more often pale than vivid."""
    hue, saturation = random.random(), 0.6 * random.random() ** 1.5
    return colorsys.hsv_to_rgb(hue, saturation, random.uniform(*value))


def sun(random: Random, extent: float, towards_deg: tuple[float, float] = (0, 360)) -> Light:
    """A lamp far above a scene about the origin, and the sky."""
    azimuth = np.radians(random.uniform(*towards_deg))
    elevation = np.radians(random.uniform(30, 65))
    direction = np.array(
        [np.cos(elevation) * np.sin(azimuth), -np.cos(elevation) * np.cos(azimuth),
         np.sin(elevation)]
    )  # fmt: skip
    distance = 50 * extent
    share = random.uniform(0.35, 0.75)  # of the light that comes from the lamp
    spread = np.radians(random.uniform(4, 15))
    return Light(
        position=distance * direction, radius=distance * np.tan(spread), strength=share,
        ambient=1 - share,
    )  # fmt: skip


def blotches(places: Array, size: float, seed: int, footprint: Array) -> Array:
    """(N,) smooth noise of unit deviation at (N, 3) places, the mean over each footprint (N,).

    It is a sum of waves of all directions; a wave shorter than its footprint vanishes.
    """
    random = np.random.default_rng(seed)
    total, weight = np.zeros(len(places), np.float32), 0.0
    points = places.astype(np.float32)
    for octave in range(OCTAVES):
        directions = random.normal(size=(WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        numbers = 2 * np.pi * 2 ** (octave + random.uniform(-0.4, 0.4, WAVES)) / size
        turns = points @ (directions.T * numbers).astype(np.float32)
        turns += random.uniform(0, 2 * np.pi, WAVES).astype(np.float32) + BEND * total[:, None]
        waves = np.cos(turns, out=turns).sum(axis=1) * np.sqrt(2 / WAVES)
        strength = 0.8**octave
        seen = np.exp(-0.5 * (0.4 * 2 * np.pi * 2**octave / size * footprint) ** 2)
        total += (strength * seen * waves).astype(np.float32)
        weight += strength**2
    return total / np.float32(np.sqrt(weight))


def plain(level: tuple[float, float, float]) -> Callable[[Array], Array]:
    """A background of one colour."""
    return lambda rays: np.broadcast_to(np.asarray(level), rays.shape)
