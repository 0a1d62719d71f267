"""Bodies on a plate: a few smooth ones, or everything that is at hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from manifold3d import Manifold

from zoo import objects
from zoo.camera import Place
from zoo.geometry import Body, Random
from zoo.light import Stage, plain, sun
from zoo.materials import Material, colour, paints
from zoo.solids import box, parts, unite_all

Maker = Callable[[Random], Manifold]
Thing = tuple[Manifold, dict[str, Any]]  # a solid that stands about the origin, and its paint
MARKS = {"bands": objects.bands, "label": objects.label}


def smooth(random: Random) -> Stage:
    """One to five cans, bottles, vases, rings, tubes or balls: plain, striped or glossy."""
    count = int(random.integers(1, 6))
    chosen = random.choice(len(objects.SMOOTH), count, replace=False)
    things = [draw_thing(random, objects.SMOOTH[i], marks=("bands",), textured=0.0) for i in chosen]
    return set_table(random, things, ground_textured=bool(random.random() < 0.6), tiled=False)


def clutter(random: Random) -> Stage:
    """Everything on a table, some of it textured."""
    makers = (*objects.SMOOTH, *objects.CAD, objects.block, objects.block, objects.rounded_block)
    count = int(random.integers(7, 14))
    chosen = random.choice(len(makers), count, replace=False)
    things = [draw_thing(random, makers[i], marks=tuple(MARKS), textured=0.4) for i in chosen]
    return set_table(random, things, bool(random.random() < 0.4), tiled=bool(random.random() < 0.4))


def draw_thing(random: Random, make: Maker, marks: tuple[str, ...], textured: float) -> Thing:
    """A body of random size."""
    solid = make(random)
    if make in objects.CAD:
        solid = objects.sized(solid, random.uniform(0.5, 1.0))
    look = {
        "shape": make.__name__,
        "mark": str(random.choice(marks)) if random.random() < 0.5 else None,
        "glossy": bool(random.random() < 0.4),
        "textured": bool(random.random() < textured),
    }
    return objects.grounded(solid), look


def set_table(random: Random, things: list[Thing], ground_textured: bool, tiled: bool) -> Stage:
    """The stage with things on a plate."""
    radii = [objects.ground_radius(solid) for solid, _ in things]
    spots = objects.scattered(random, radii, 0.08)
    reach = max(np.hypot(x, y) + radius for (x, y), radius in zip(spots, radii, strict=True))
    ground = Material(
        albedo=colour(random, (0.3, 0.7)),
        contrast=random.uniform(0.15, 0.35) if ground_textured else 0.0,
        size=random.uniform(0.3, 0.8),
    )
    materials = {"ground": ground, "grid": replace(ground, albedo=colour(random, (0.1, 0.25)))}
    plate = objects.plate(reach * random.uniform(1.1, 1.6), bool(random.random() < 0.5))
    bodies = [Body("ground", "ground", plate)]
    if tiled:
        bodies = list(parts("ground", plate, grid(random, reach), ("ground", "grid")))
    for i, ((solid, look), (x, y)) in enumerate(zip(things, spots, strict=True)):
        looks = paints(random, look["glossy"], look["textured"])
        materials |= {f"{key}{i}": paint for key, paint in looks.items()}
        stood = solid.rotate((0, 0, random.uniform(0, 360))).translate((x, y, -objects.SINK))
        name, mark = f"{look['shape']}{i}", MARKS.get(look["mark"])
        region = mark(random, stood.translate((-x, -y, 0))).translate((x, y, 0)) if mark else None
        bodies += parts(name, stood, region, (f"main{i}", f"mark{i}"))
    height = max(solid.bounding_box()[5] for solid, _ in things)
    extent = float(np.hypot(reach, height / 2))
    return Stage(
        bodies=bodies,
        materials=materials,
        light=sun(random, extent),
        place=Place(middle=np.array([0, 0, 0.4 * height]), extent=extent, elevation_deg=(12, 50)),
        background=plain(tuple(np.full(3, random.uniform(0.05, 0.9)))),
        facts={
            "things": [look for _, look in things],
            "ground_textured": ground_textured,
            "tiled": tiled,
        },
    )


def grid(random: Random, reach: float) -> Manifold:
    """The joints between tiles."""
    lines = np.arange(-2 * reach, 2 * reach, random.uniform(0.4, 0.7) * reach)
    half, far = 0.012 * reach, 4 * reach
    bars = [box((-far, far), (y - half, y + half), (-0.03, 1)) for y in lines]
    bars += [box((x - half, x + half), (-far, far), (-0.03, 1)) for x in lines]
    return unite_all(bars)
