"""Cans, bottles, vases, tubes and balls on a ground: plain, striped, glossy."""

from __future__ import annotations

import numpy as np
from demo_scene.bodies import Body

from zoo import objects
from zoo.stage import Material, Place, Random, Stage, colour, plain, sun


def make(random: Random) -> Stage:
    """One to five smooth bodies on a plate."""
    count = int(random.integers(1, 6))
    chosen = [objects.SMOOTH[i] for i in random.choice(len(objects.SMOOTH), count, replace=False)]
    solids = [objects.grounded(make(random)) for make in chosen]
    radii = [objects.ground_radius(solid) for solid in solids]
    spots = objects.scattered(random, radii, 0.1)
    textured = bool(random.random() < 0.6)
    ground = Material(
        albedo=colour(random, (0.3, 0.7)),
        contrast=random.uniform(0.15, 0.35) if textured else 0.0,
        size=random.uniform(0.3, 0.8),
    )
    materials: dict[str, Material] = {"ground": ground}
    bodies: list[Body] = []
    facts = []
    for i, (shape, solid, (x, y)) in enumerate(zip(chosen, solids, spots, strict=True)):
        striped, glossy = random.random() < 0.5, random.random() < 0.5
        paints = objects.paints(random, glossy, textured=False)
        materials |= {f"{key}{i}": paint for key, paint in paints.items()}
        stood = solid.rotate((0, 0, random.uniform(0, 360))).translate((x, y, -objects.SINK))
        name = f"{shape.__name__}{i}"
        facts.append({"name": name, "striped": bool(striped), "glossy": bool(glossy)})
        if striped:
            region = objects.bands(random, stood)
            bodies += objects.parts(name, stood, region, (f"main{i}", f"mark{i}"))
        else:
            bodies.append(Body(name=name, material=f"main{i}", solid=stood))
    reach = max(np.hypot(x, y) + radius for (x, y), radius in zip(spots, radii, strict=True))
    plate = objects.plate(reach * random.uniform(1.1, 1.8), bool(random.random() < 0.5))
    bodies.insert(0, Body(name="ground", material="ground", solid=plate))
    height = max(solid.bounding_box()[5] for solid in solids)
    extent = float(np.hypot(reach, height / 2))
    return Stage(
        bodies=bodies,
        materials=materials,
        light=sun(random, extent),
        place=Place(middle=np.array([0, 0, 0.4 * height]), extent=extent, elevation_deg=(12, 50)),
        background=plain(tuple(np.full(3, random.uniform(0.05, 0.9)))),
        facts={"objects": facts, "textured_ground": textured},
    )
