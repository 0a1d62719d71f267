"""How surfaces look: colours, blotches and gloss."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np

from zoo.geometry import Array, Random


@dataclass(frozen=True, kw_only=True)
class Material:
    """How a surface looks."""

    # Share of red, green and blue light that it reflects to all sides.
    albedo: tuple[float, float, float]
    contrast: float = 0.0  # standard deviation of its blotches over their mean; 0: plain
    # Length of the longest blotches, in units of the scene; the shortest are 1/8 of it.
    size: float = 0.3
    gloss: float = 0.0  # share of light in highlights and mirror images; 0: matte
    shininess: float = 60.0  # exponent of the highlights (Blinn and Phong)
    emission: float = 0.0  # emitted light, in units of the light reflected by a white face


def colour(random: Random, value: tuple[float, float] = (0.25, 0.7)) -> tuple[float, float, float]:
    """A random albedo, more often pale than vivid."""
    hue, saturation = random.random(), 0.6 * random.random() ** 1.5
    return colorsys.hsv_to_rgb(hue, saturation, random.uniform(*value))


def paints(random: Random, glossy: bool, textured: bool) -> dict[str, Material]:
    """Two materials that differ clearly."""
    gloss = random.uniform(0.1, 0.4) if glossy else 0.0
    shininess = 10 ** random.uniform(1.3, 2.6)
    first, second = colour(random, (0.45, 0.8)), colour(random, (0.08, 0.3))
    if random.random() < 0.5:
        first, second = second, first
    contrast = random.uniform(0.15, 0.35) if textured else 0.0
    size = random.uniform(0.15, 0.4)
    common = {"gloss": gloss, "shininess": shininess, "contrast": contrast, "size": size}
    return {"main": Material(albedo=first, **common), "mark": Material(albedo=second, **common)}


def painted(
    material: Material, places: Array, seed: int, footprint: Array | None = None
) -> np.ndarray:
    """(N, 3) albedo of a material at places (N, 3); see `blotches`."""
    kind = np.float64 if footprint is None else np.float32
    albedo = np.broadcast_to(np.array(material.albedo, kind), places.shape)
    if not material.contrast:
        return albedo
    field = blotches(places, material.size, seed, footprint)
    return np.minimum(albedo * np.clip(1 + material.contrast * field, 0.1, 2.0)[:, None], 0.95)


def blotches(places: Array, size: float, seed: int, footprint: Array | None = None) -> np.ndarray:
    """(N,) smooth noise of unit deviation at (N, 3) places: a sum of waves of all directions.

    With footprints (N,) it is the mean over each, where a wave shorter than its footprint vanishes;
    in single precision, of fewer waves, which the longer ones bend so that no pattern repeats.
    """
    random = np.random.default_rng(seed)
    fast = footprint is not None
    kind, octaves, count, bend = (np.float32, 4, 6, 0.8) if fast else (np.float64, 5, 12, 0.0)
    total, weight = np.zeros(len(places), kind), 0.0
    points = places.astype(kind)
    for octave in range(octaves):
        directions = random.normal(size=(count, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        shift = random.uniform(-0.4, 0.4, count) if fast else np.zeros(count)
        turns = points @ (directions.T * (2 * np.pi * 2 ** (octave + shift) / size)).astype(kind)
        turns += random.uniform(0, 2 * np.pi, count).astype(kind) + kind(bend) * total[:, None]
        waves = np.cos(turns, out=turns).sum(axis=1) * np.sqrt(2 / count)
        strength = 0.8**octave
        scale = 0.4 * 2 * np.pi * 2**octave / size
        seen = np.exp(-0.5 * (scale * footprint) ** 2) if footprint is not None else 1.0
        total += (strength * seen * waves).astype(kind)
        weight += strength**2
    return total / kind(np.sqrt(weight))
