"""One machined part before a plain background: plain, two-tone, overexposed or dark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoo import objects
from zoo.camera import Place
from zoo.geometry import Body, Random
from zoo.light import Stage, plain, sun
from zoo.materials import Material, paints
from zoo.solids import parts

LOOKS = {"plain": 1.0, "two_tone": 1.0, "overexposed": 3.0, "dark": 0.12}  # and their exposure


def make(random: Random) -> Stage:
    """A part of a machine, or two that are united."""
    shape = objects.CAD[random.choice(len(objects.CAD), p=(0.4, 0.3, 0.1, 0.1, 0.05, 0.05))]
    solid = objects.sized(shape(random), 1.0)
    look = list(LOOKS)[random.integers(len(LOOKS))]
    painted = paints(random, bool(random.random() < 0.3), textured=False)
    materials: dict[str, Material] = {"main": painted["main"], "mark": painted["mark"]}
    bodies = [Body("part", "main", solid)]
    if look == "two_tone":
        region = (objects.bands if random.random() < 0.5 else objects.label)(random, solid)
        bodies = list(parts("part", solid, region, ("main", "mark")))
    standing = bool(random.random() < 0.3)
    height = solid.bounding_box()[5]
    radius = objects.ground_radius(solid)
    if standing:
        materials["ground"] = replace(painted["mark"], albedo=(0.5, 0.5, 0.5), gloss=0.0)
        plate = objects.plate(1.6 * radius, round_one=False).translate((0, 0, objects.SINK))
        bodies.insert(0, Body("ground", "ground", plate))
    extent = float(np.hypot(radius, height / 2))
    background = float(random.choice([0.02, 0.3, 0.9]))
    return Stage(
        bodies=bodies,
        materials=materials,
        light=sun(random, extent),
        place=Place(
            middle=np.array([0, 0, height / 2]),
            extent=extent,
            elevation_deg=(15, 60) if standing else (-45, 60),
        ),
        background=plain((background,) * 3),
        facts={"shape": shape.__name__, "look": look, "standing": standing},
        exposure=LOOKS[look],
    )
