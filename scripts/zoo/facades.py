"""Fronts of buildings: windows, arches, gables, chimneys, a lawn, and a sky."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
from manifold3d import Manifold

from zoo.camera import Place
from zoo.geometry import Array, Body, Random
from zoo.light import Stage, sun
from zoo.materials import Material, blotches, colour
from zoo.objects import SEGMENTS
from zoo.solids import arc, box, cylinder, parts, prism, unite_all

SKIES = ("plain", "gradient", "cloudy")
FLOOR = 2.9  # height of a storey, metres


def make(random: Random) -> Stage:
    """A building with a lawn."""
    columns = int(random.integers(3, 7))
    width = columns * random.uniform(2.0, 2.8)
    house = SimpleNamespace(  # measures in metres; its front is at y = 0 towards -y
        width=width,
        depth=random.uniform(0.5, 0.9) * width,
        floors=int(random.integers(1, 4)),
        columns=columns,
        window=(random.uniform(0.8, 1.3), random.uniform(1.2, 1.8)),
        recess=random.uniform(0.1, 0.3),
        arched=bool(random.random() < 0.4),
        gable_in_front=bool(random.random() < 0.4),
        pitch=random.uniform(0.5, 1.1),
        chimneys=int(random.integers(0, 4)),
    )
    sky = SKIES[random.integers(len(SKIES))]
    bodies = [*lawn(random, house), *walls(random, house), *openings(house), *roof(random, house)]
    extent = float(np.hypot(house.width, top_of(house)) / 2)
    return Stage(
        bodies=bodies,
        materials=materials(random),
        light=sun(random, extent, towards_deg=(-70, 70)),
        place=Place(
            middle=np.array([0, 0, 0.5 * top_of(house)]),
            extent=1.1 * extent,
            azimuth_deg=(-random.uniform(25, 55), random.uniform(25, 55)),
            elevation_deg=(2, 18),
        ),
        background=heaven(random, sky),
        facts={"house": house.__dict__, "sky": sky},
    )


def top_of(house: SimpleNamespace) -> float:
    """Height of the walls."""
    return house.floors * FLOOR + 0.4


def materials(random: Random) -> dict[str, Material]:
    """Colours of a building; its walls are plain or stuccoed."""
    rough = random.uniform(0.12, 0.3) if random.random() < 0.5 else 0.0
    return {
        "lawn": Material(albedo=(0.16, 0.27, 0.09), contrast=0.3, size=random.uniform(0.8, 2.0)),
        "path": Material(albedo=(0.5, 0.48, 0.45), contrast=0.12, size=0.6),
        "wall": Material(albedo=colour(random, (0.5, 0.85)), contrast=rough, size=1.0),
        "base": Material(albedo=colour(random, (0.2, 0.4))),
        "trim": Material(albedo=colour(random, (0.6, 0.9))),
        "frame": Material(albedo=colour(random, (0.3, 0.9))),
        "door": Material(albedo=colour(random, (0.1, 0.4))),
        "glass": Material(albedo=(0.04, 0.05, 0.06), gloss=0.35, shininess=400),
        "roof": Material(albedo=(0.36, 0.16, 0.11), contrast=random.uniform(0, 0.3), size=0.8),
    }


def lawn(random: Random, house: SimpleNamespace) -> Iterator[Body]:
    """The ground with a path to the door."""
    x = house.width * random.uniform(0.9, 1.4)
    ground = box((-x, x), (-1.3 * x, house.depth + 0.5), (-0.5, 0))
    path = box((-0.9, 0.9), (-40, 0.5), (-0.3, 1))
    yield from parts("ground", ground, path, ("lawn", "path"))


def walls(random: Random, house: SimpleNamespace) -> Iterator[Body]:
    """The walls with their openings, a painted base, a cornice, and a ledge on each floor."""
    half, top = house.width / 2, top_of(house)
    solid = box((-half, half), (0, house.depth), (-0.2, top)) - holes(house)
    below = box((-50, 50), (-50, 50), (-1, random.uniform(0.4, 0.8)))
    yield from parts("house", solid, below, ("wall", "base"))
    out = random.uniform(0.08, 0.25)
    levels = [top - 0.12, *(FLOOR * i + 0.15 for i in range(1, house.floors))]
    for i, z in enumerate(levels[: random.integers(1, len(levels) + 1)]):
        reach = out if i == 0 else out / 2
        ledge = box((-half - reach, half + reach), (-reach, house.depth), (z, z + 0.18))
        yield Body("house", "trim", ledge)


def cells(house: SimpleNamespace) -> Iterator[tuple[float, float, bool]]:
    """Middle and sill of each window, and whether it is the door."""
    for floor in range(house.floors):
        for column in range(house.columns):
            x = house.width * ((column + 0.5) / house.columns - 0.5)
            door = floor == 0 and column == house.columns // 2
            yield x, 0.1 if door else FLOOR * floor + 0.95, door


def outline(house: SimpleNamespace, door: bool, shrink: float = 0.0) -> Array:
    """(N, 2) corners of a window or the door about its middle, from its sill up."""
    width, height = (1.15, 2.2) if door else house.window
    x = width / 2 - shrink
    if not house.arched:
        return np.array([(-x, shrink), (x, shrink), (x, height - shrink), (-x, height - shrink)])
    top = np.add(arc(x, 0, 180, 49), (0, height - width / 2))
    return np.vstack([[(-x, shrink), (x, shrink)], top])


def upright(shape: Array, front: float, back: float) -> Manifold:
    """A prism of an outline in x and z between two values of y."""
    return prism(shape, back - front).rotate((90, 0, 0)).translate((0, back, 0))


def holes(house: SimpleNamespace) -> Manifold:
    """The openings of windows and door, to be cut from the walls."""
    return unite_all(
        upright(outline(house, door), -1, house.recess).translate((x, 0, z))
        for x, z, door in cells(house)
    )


def openings(house: SimpleNamespace) -> Iterator[Body]:
    """Panes, bars and sills of the windows, and the door."""
    back = house.recess
    for x, z, door in cells(house):
        whole = upright(outline(house, door, -0.02), back - 0.06, back + 0.02)
        pane = upright(outline(house, door, 0.07), back - 0.03, back + 0.04)
        frame = whole - upright(outline(house, door, 0.06), -1, 1)
        if door:
            leaf = upright(outline(house, door, 0.04), back - 0.03, back + 0.04)
            yield Body("door", "door", leaf.translate((x, 0, z)))
        else:
            width, height = house.window
            bars = box((-0.03, 0.03), (back - 0.06, back), (0, height - 0.02))
            bars += box((-width / 2, width / 2), (back - 0.055, back), (0.55, 0.6))
            sill = box((-width / 2 - 0.1, width / 2 + 0.1), (-0.09, 0.05), (-0.09, -0.01))
            frame += bars ^ upright(outline(house, door, 0.02), -1, 1)
            yield Body("pane", "glass", pane.translate((x, 0, z)))
            yield Body("sill", "trim", sill.translate((x, 0, z)))
        yield Body("frame", "frame", frame.translate((x, 0, z)))


def roof(random: Random, house: SimpleNamespace) -> Iterator[Body]:
    """A gable roof with chimneys."""
    over, top = 0.35, top_of(house) + 0.05
    span = house.width if house.gable_in_front else house.depth
    length = house.depth if house.gable_in_front else house.width
    half = span / 2 + over
    ridge = half * house.pitch
    tiles = prism([(-half, 0), (half, 0), (0, ridge)], length + 2 * over)
    tiles -= prism([(-half, -0.3), (half, -0.3), (0, ridge - 0.3)], 99)
    attic = prism([(-half, -0.2), (half, -0.2), (0, ridge - 0.2)], length)
    attic ^= box((-span / 2, span / 2), (-0.2, 99), (-1, 99))
    for name, material, solid, front in (
        ("roof", "roof", tiles, over), ("house", "wall", attic, 0.0),
    ):  # fmt: skip
        upright = solid.rotate((90, 0, 0)).translate((0, length / 2 + front, 0))
        turned = upright if house.gable_in_front else upright.rotate((0, 0, 90))
        yield Body(name, material, turned.translate((0, house.depth / 2, top)))
    for _ in range(house.chimneys):
        x = random.uniform(-0.4, 0.4) * house.width
        y = random.uniform(0.25, 0.45) * house.depth
        chimney = box((x - 0.3, x + 0.3), (y - 0.3, y + 0.3), (top, top + 1.05 * ridge + 0.6))
        if random.random() < 0.3:
            chimney = cylinder(1.05 * ridge + 0.6, 0.3, SEGMENTS).translate((x, y, top))
        yield Body("chimney", "base", chimney)


def heaven(random: Random, sky: str) -> Callable[[Array], Array]:
    """Light from infinity: sky above the horizon, haze below."""
    blue = np.array([0.25, 0.42, 0.75]) * random.uniform(0.7, 1.3)
    pale = np.array([0.75, 0.8, 0.85]) * random.uniform(0.8, 1.2)
    if random.random() < 0.3:
        blue = pale * 0.9  # overcast
    haze, seed = np.array([0.3, 0.33, 0.3]), int(random.integers(1 << 30))

    def light(rays: Array) -> Array:
        up = np.clip(rays[:, 2:], 0, 1)
        result = np.broadcast_to(blue, rays.shape)
        if sky != "plain":
            result = pale + (blue - pale) * np.minimum(2 * up, 1)
        if sky == "cloudy":
            still = np.zeros(len(rays))
            cloud = np.clip(0.5 + 0.6 * blotches(rays, 0.7, seed, still), 0, 1)[:, None]
            result = result + cloud**2 * (0.95 - result)
        return np.where(rays[:, 2:] < 0, haze, result)

    return light
