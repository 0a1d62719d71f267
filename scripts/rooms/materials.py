"""Colours and blotches of the rooms' surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WAVES = 12  # in each octave of the blotches
OCTAVES = 5


@dataclass(frozen=True, kw_only=True)
class Material:
    """A matte surface.

    Attributes:
        albedo: Share of red, green and blue light that it reflects.
        contrast: Standard deviation of its blotches over their mean; 0: plain.
        size: Length of the longest blotches in metres; the shortest are 1/16 of it.
        emission: Emitted light, in units of the light reflected by a white wall.
    """

    albedo: tuple[float, float, float]
    contrast: float = 0.0
    size: float = 0.4
    emission: float = 0.0


MATERIALS = {
    "wall": Material(albedo=(0.80, 0.79, 0.76)),
    "wall_cool": Material(albedo=(0.74, 0.77, 0.79)),
    "wall_sage": Material(albedo=(0.66, 0.71, 0.64)),
    "ceiling": Material(albedo=(0.83, 0.83, 0.82)),
    "white": Material(albedo=(0.82, 0.82, 0.80)),
    "floor": Material(albedo=(0.46, 0.38, 0.31), contrast=0.015, size=0.8),
    "floor_gray": Material(albedo=(0.45, 0.46, 0.46), contrast=0.015, size=0.8),
    "wood": Material(albedo=(0.50, 0.35, 0.22)),
    "dark_wood": Material(albedo=(0.26, 0.18, 0.13)),
    "fabric": Material(albedo=(0.30, 0.36, 0.45)),
    "metal": Material(albedo=(0.34, 0.35, 0.36)),
    "door": Material(albedo=(0.70, 0.68, 0.62)),
    "picture": Material(albedo=(0.45, 0.44, 0.42), contrast=0.45, size=0.25),
    "rug": Material(albedo=(0.42, 0.30, 0.27), contrast=0.35, size=0.5),
    "books": Material(albedo=(0.36, 0.37, 0.34), contrast=0.40, size=0.3),
    "glow": Material(albedo=(0.8, 0.8, 0.8), emission=1.6),
}


def albedo(names: list[str], index: NDArray[np.int32], places: NDArray[np.float64]) -> NDArray:
    """(N, 3) albedo at `places` (N, 3) of the materials `names[index]`, (N,)."""
    result = np.array([MATERIALS[name].albedo for name in names])[index]
    for i, name in enumerate(names):
        material = MATERIALS[name]
        if material.contrast:
            on = np.flatnonzero(index == i)
            field = blotches(places[on], material.size, seed=len(name) + ord(name[0]))
            result[on] *= np.clip(1 + material.contrast * field, 0.1, 2.0)[:, None]
    return np.minimum(result, 0.95)


def blotches(places: NDArray[np.float64], size: float, seed: int) -> NDArray[np.float64]:
    """(N,) smooth noise of unit deviation at (N, 3) places: waves of all directions."""
    random = np.random.default_rng(seed)
    total, weight = np.zeros(len(places)), 0.0
    for octave in range(OCTAVES):
        directions = random.normal(size=(WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        turns = places @ (directions.T * (2 * np.pi * 2**octave / size))
        strength = 0.8**octave
        waves = np.cos(turns + random.uniform(0, 2 * np.pi, WAVES)).sum(axis=1)
        total += strength * waves * np.sqrt(2 / WAVES)
        weight += strength**2
    return total / np.sqrt(weight)
