"""Furnished rooms seen from inside."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np

from zoo import solids
from zoo.camera import Place
from zoo.geometry import Body, Random
from zoo.light import Light, Stage, plain
from zoo.materials import Material, colour
from zoo.plans import around
from zoo.solids import body, box, cylinder, prism

THICK = 0.3  # of walls, metres


def make(random: Random) -> Stage:
    """A room with furniture along its walls and in its middle."""
    plan = SimpleNamespace(  # measures in metres, from (0, 0, 0)
        width=random.uniform(4, 6),
        depth=random.uniform(3.6, 5),
        height=random.uniform(2.4, 2.9),
        slope=bool(random.random() < 0.4),
        window=bool(random.random() < 0.7),
        door=bool(random.random() < 0.8),
        pictures=int(random.integers(1, 4)),
        rug=bool(random.random() < 0.5),
    )
    bodies = [*shell(plan), *along_walls(random, plan), *in_the_middle(random, plan)]
    middle = (plan.width / 2, plan.depth / 2, 1.45)
    radii = (0.32 * plan.width, 0.26 * plan.depth)
    spots = around(middle, radii, 0.5 * plan.width, 60)
    share = random.uniform(0.4, 0.7)
    lamp = np.array([middle[0], middle[1], plan.height - 0.15])
    if plan.window and random.random() < 0.5:
        lamp = np.array([middle[0], plan.depth - 0.1, 1.6])
    return Stage(
        bodies=bodies,
        materials=materials(random),
        light=Light(
            position=lamp, radius=random.uniform(0.1, 0.14), strength=share, ambient=1 - share,
            below=0.6, reach=1.0,
        ),
        place=Place(
            middle=np.array([middle[0], middle[1], 1.2]),
            extent=1.5,
            spots=[(np.array(position), np.array(target)) for position, target in spots],
        ),
        background=plain((0.9, 0.9, 0.9)),
        facts={"plan": plan.__dict__},
    )  # fmt: skip


def materials(random: Random) -> dict[str, Material]:
    """Colours of a room, mostly plain."""
    floor = random.uniform(0.1, 0.3) if random.random() < 0.3 else 0.015
    wood = colour(random, (0.2, 0.5))
    return {
        "wall": Material(albedo=colour(random, (0.65, 0.85))),
        "ceiling": Material(albedo=(0.83, 0.83, 0.82)),
        "floor": Material(albedo=colour(random, (0.3, 0.5)), contrast=floor, size=0.6),
        "white": Material(albedo=(0.82, 0.82, 0.8)),
        "wood": Material(albedo=wood, gloss=0.05),
        "dark": Material(albedo=colour(random, (0.1, 0.25))),
        "fabric": Material(albedo=colour(random, (0.2, 0.5))),
        "door": Material(albedo=colour(random, (0.4, 0.7))),
        "metal": Material(albedo=(0.34, 0.35, 0.36), gloss=0.2, shininess=80),
        "picture": Material(albedo=(0.45, 0.44, 0.42), contrast=0.4, size=0.25),
        "rug": Material(albedo=colour(random, (0.3, 0.5)), contrast=0.3, size=0.5),
        "books": Material(albedo=(0.36, 0.37, 0.34), contrast=0.35, size=0.3),
        "glow": Material(albedo=(0.8, 0.8, 0.8), emission=0.9),
    }


def shell(plan: SimpleNamespace) -> Iterator[Body]:
    """Walls, floor, ceiling, window and door."""
    w, d, h, t = plan.width, plan.depth, plan.height, THICK
    outside = ((-t, w + t), (-t, d + t))
    walls = box(*outside, (-0.1, h + 0.1)) - box((0, w), (0, d), (-1, h + 1))
    if plan.window:
        x = (w / 2 - 0.8, w / 2 + 0.8)
        walls -= box(x, (d - 0.1, d + 0.2), (0.95, 2.05))
        bars = box((x[0] - 0.05, x[1] + 0.05), (d + 0.1, d + 0.16), (0.9, 2.1))
        for low in (x[0] + 0.06, w / 2 + 0.03):
            bars -= box((low, low + 0.71), (d, d + t), (1.01, 1.99))
        yield body("window", "white", bars)
        pane = box((x[0] - 0.05, x[1] + 0.05), (d + 0.12, d + 0.21), (0.9, 2.1))
        yield body("pane", "glow", pane)
        sill = box((x[0] - 0.1, x[1] + 0.1), (d - 0.12, d + 0.12), (0.91, 0.95))
        yield body("sill", "white", sill)
    if plan.door:
        walls -= box((-0.12, 0.5), (0.6, 1.5), (-1, 2.02))
        yield body("door", "door", box((-0.2, -0.08), (0.55, 1.55), (-0.05, 2.07)))
        yield body("handle", "metal", box((-0.1, -0.01), (1.36, 1.4), (1.0, 1.03)))
    yield body("room", "wall", walls)
    yield body("room", "floor", box(*outside, (-0.2, 0)))
    yield body("room", "ceiling", box(*outside, (h, h + 0.2)))
    if plan.slope:
        shape = np.array([(-0.1, h + 0.05), (-0.1, h - 1.0), (1.1, h + 0.05)])
        wedge = prism(shape, d + 0.2).rotate((90, 0, 0)).translate((0, d + 0.1, 0))
        yield body("slope", "ceiling", wedge.mirror((1, 0, 0)).translate((w, 0, 0)))


def along_walls(random: Random, plan: SimpleNamespace) -> Iterator[Body]:
    """Shelves, a sofa, a cupboard, a radiator and pictures on the walls."""
    w, d = plan.width, plan.depth
    height = random.uniform(0.8, 1.9)
    x, width = random.uniform(0.8, 0.25 * w), random.uniform(0.7, 1.1)
    yield body("shelf", "white", solids.shelf(width, 0.3, height, 4), (x, d + 0.01, 0))
    if random.random() < 0.6:
        z = 0.08 + 0.03 - 0.01
        yield body("books", "books", box((x - 0.25, x + 0.1), (d - 0.22, d - 0.02), (z, z + 0.17)))
    if random.random() < 0.7:
        place = (random.uniform(0.4, 0.6) * w, 0.46, 0)
        yield body("sofa", "fabric", solids.sofa(random.uniform(1.3, 1.8)), place, 180)
    if random.random() < 0.7 and not plan.slope:
        y = random.uniform(0.3, 0.5) * d
        shape = box((-0.45, 0.02), (-0.5, 0.5), (-0.02, random.uniform(0.7, 1.3)))
        yield body("cupboard", "door", shape, (w, y, 0))
        yield body("knob", "metal", box((-0.48, -0.44), (-0.1, -0.06), (0.5, 0.54)), (w, y, 0))
    if plan.window:
        yield body("radiator", "white", solids.radiator(1.3), (w / 2, d - 0.02, 0))
    walls = [(0.3 * w, 0.0, 180), (0.7 * w, 0.0, 180), (0.0, 0.65 * d, 90)]
    for x, y, turn in walls[: plan.pictures]:
        size = random.uniform(0.5, 0.9, 2)
        place = (x, y, random.uniform(1.45, 1.6))
        yield body("frame", "dark", solids.picture_frame(*size), place, turn)
        yield body("picture", "picture", solids.canvas(*size), place, turn)


def in_the_middle(random: Random, plan: SimpleNamespace) -> Iterator[Body]:
    """A table with chairs, a rug, a crate, and a lamp above."""
    x, y = plan.width * random.uniform(0.45, 0.6), plan.depth * random.uniform(0.5, 0.6)
    turn = random.uniform(0, 360)
    if plan.rug:
        rug = box((-1.0, 1.0), (-0.8, 0.8), (-0.01, 0.012))
        yield body("rug", "rug", rug, (x, y, 0), random.uniform(-20, 20))
    if random.random() < 0.6:
        table, seat = solids.table(1.2, 0.75, 0.74), solids.chair()
    else:
        table, seat = solids.round_table(), solids.stool()
    yield body("table", "wood", table, (x, y, 0), turn)
    for side in (0, 90, 180, 270)[: random.integers(1, 5)]:
        away = (0.62 if side % 180 == 0 else 0.85) + random.uniform(0, 0.12)
        around_it = np.radians(turn + side + 90)
        place = (x + away * np.cos(around_it), y + away * np.sin(around_it), 0)
        yield body("seat", "dark", seat, place, turn + side)
    if random.random() < 0.6:
        bowl = cylinder(0.15, 0.08, 128, 0.16)
        yield body("bowl", "metal", bowl, (x, y, 0.71))
    if random.random() < 0.5:
        shade = solids.pendant(plan.height - 2.1)
        yield body("lamp", "white", shade, (x + 0.5, y, plan.height))
    crate = box((-0.2, 0.2), (-0.15, 0.15), (-0.02, 0.3))
    yield body("crate", "wood", crate, (plan.width - 0.5, 0.45, 0), random.uniform(0, 90))
