"""The fixed rooms, mostly plain: bodies, materials, lamps, and positions of the cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from zoo import solids
from zoo.camera import View, looking
from zoo.geometry import Body
from zoo.materials import Material
from zoo.solids import Point, body, box, cylinder, prism, unite_all

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


@dataclass(frozen=True)
class Lamp:
    """A luminous rectangle: centre, half sides, direction of its light, and radiance."""

    center: Point
    half_u: Point
    half_v: Point
    towards: Point
    radiance: float


@dataclass(frozen=True, kw_only=True)
class Room:
    """A room with its bodies, lamps and views; lengths in metres, z up."""

    bodies: list[Body]
    lamps: list[Lamp]
    views: list[View]


def around(
    middle: Point, radii: tuple[float, float], reach: float, count: int
) -> list[tuple[Point, Point]]:
    """Positions on an ellipse, each looking across it, and some from near its middle outwards."""
    inside = count // 4

    def at(turn: float, a: float, b: float, height: float) -> Point:
        return middle[0] + a * np.cos(turn), middle[1] + b * np.sin(turn), height

    views = []
    for i, turn in enumerate(np.linspace(0, 2 * np.pi, count - inside, endpoint=False)):
        aim, up = turn + np.pi + 0.5 * np.sin(2.4 * i), 0.55 * np.cos(1.7 * i)
        position = at(turn, *radii, middle[2] + 0.18 * np.sin(3 * turn))
        views.append((position, at(aim, reach, reach, middle[2] - 0.25 + up)))
    near = (-0.35 * radii[0], -0.35 * radii[1])
    for i, turn in enumerate(np.linspace(0.3, 2 * np.pi + 0.3, inside, endpoint=False)):
        position = at(turn, *near, middle[2] + 0.1 * (-1) ** i)
        views.append((position, at(turn, reach, reach, middle[2] - 0.3 + 0.3 * (i % 3))))
    return views


def posed(views: list[tuple[Point, Point]]) -> list[View]:
    """Views with small rolls, like those of a hand-held camera."""
    return [looking(i, *view, 2.5 * np.sin(1.3 * i)) for i, view in enumerate(views)]


def framed(at: Point, turn: float, width: float, height: float) -> Iterator[Body]:
    """A textured picture in a frame on a wall."""
    yield body("frame", "dark_wood", solids.picture_frame(width, height), at, turn)
    yield body("picture", "picture", solids.canvas(width, height), at, turn)


def downlight(x: float, y: float, z: float, half: float, radiance: float) -> Lamp:
    """A square lamp below a ceiling."""
    return Lamp((x, y, z), (half, 0, 0), (0, half, 0), (0, 0, -1), radiance)


def living() -> Room:
    """A living room with a window, and a hall behind a door opening."""
    cavities = box((0, 5.2), (0, 4.2), (-1, 4)) + box((-1.9, -0.15), (0, 4.2), (-1, 4))
    door = box((-0.2, 0.1), (2.6, 3.5), (-1, 2.05))
    window = box((1.6, 3.4), (4.1, 4.7), (0.9, 2.15))
    walls = box((-2.1, 5.4), (-0.2, 4.5), (-0.1, 2.6)) - cavities - door - window
    board = box((-0.05, 5.25), (-0.05, 4.25), (-0.05, 0.08))
    board -= box((0.015, 5.185), (0.015, 4.185), (-1, 1)) + door
    bars = box((1.5, 3.5), (4.34, 4.4), (0.85, 2.2)) - box((1.66, 2.46), (4, 5), (0.96, 2.09))
    bars -= box((2.54, 3.34), (4, 5), (0.96, 2.09))
    pane = box((1.5, 3.5), (4.36, 4.38), (0.85, 2.2))
    bodies = [
        body("room", "floor", box((-2.1, 5.4), (-0.2, 4.5), (-0.2, 0))),
        body("room", "ceiling", box((-2.1, 5.4), (-0.2, 4.5), (2.5, 2.7))),
        body("room", "wall", walls),
        body("board", "white", board),
        body("window", "white", bars),
        body("pane", "glow", pane),
        body("sill", "white", box((1.5, 3.5), (4.05, 4.3), (0.86, 0.9))),
        body("radiator", "white", solids.radiator(1.4), (2.5, 4.19, 0)),
        body("table", "wood", solids.table(1.3, 0.8, 0.74), (3.45, 2.45, 0), 12),
        body("chair", "dark_wood", solids.chair(), (3.15, 3.15, 0), 8),
        body("chair", "dark_wood", solids.chair(), (3.75, 1.7, 0), 196),
        body("chair", "dark_wood", solids.chair(), (4.5, 2.75, 0), -80),
        body("shelf", "white", solids.shelf(1.2, 0.32, 1.9, 5), (0.9, 4.21, 0)),
        body("sofa", "fabric", solids.sofa(1.7), (1.6, 0.5, 0), 180),
        body("rug", "rug", box((-0.8, 0.8), (-0.5, 0.5), (-0.01, 0.012)), (1.6, 1.6, 0), 4),
        body("cupboard", "door", box((-1.91, -1.45), (0.5, 1.7), (-0.02, 1.1))),
        body("lamp", "white", solids.pendant(0.3), (3.45, 2.45, 2.5)),
        body("bulb", "glow", cylinder(0.03, 0.17), (3.45, 2.45, 1.995)),
        body("crate", "wood", box((-0.2, 0.2), (-0.15, 0.15), (-0.02, 0.3)), (4.75, 0.5, 0), 33),
        body("books", "books", box((0.45, 0.8), (3.95, 4.15), (0.99, 1.26))),
        body("books", "books", box((1.0, 1.3), (3.95, 4.12), (0.545, 0.8))),
        *framed((5.2, 1.7, 1.5), -90, 0.9, 0.65),
        *framed((3.6, 0.0, 1.55), 180, 0.5, 0.7),
        *framed((-1.9, 2.9, 1.5), 90, 0.5, 0.6),
    ]
    sky = Lamp((2.5, 4.33, 1.52), (0.85, 0, 0), (0, 0, 0.57), (0, -1, 0), 11.0)
    lamps = [sky, downlight(3.45, 2.45, 1.98, 0.12, 9.0), downlight(-1.0, 2.1, 2.49, 0.15, 14.0)]
    views = around((2.3, 2.0, 1.45), (1.55, 1.1), 2.6, 40)
    views += [((1.2, 2.9 + 0.15 * k, 1.4), (-1.5, 2.9 + 0.15 * k, 1.2)) for k in range(2)]
    views += [((-0.9, y, 1.4), (3.0, t, 1.1)) for y, t in ((2.7, 2.4), (3.4, 2.0))]
    views += [((-0.9, 3.7, 1.4), (-1.3, 0.8, 1.1)), ((-0.6, 0.5, 1.4), (-1.2, 3.5, 1.2))]
    return Room(bodies=bodies, lamps=lamps, views=posed(views))


def attic() -> Room:
    """A room under a roof, on an oblique plan, with a column, a railing, steps and a skylight."""
    plan = np.array([(0, 0), (6.2, 0), (6.2, 2.6), (4.9, 4.6), (0, 4.6)], float)
    outer = np.array([(-0.2, -0.2), (6.4, -0.2), (6.4, 2.7), (5.0, 4.8), (-0.2, 4.8)], float)
    walls = prism(outer, 3.6) - prism(plan, 5.0).translate((0, 0, -1))
    roof = gable(0.25, 7.0) - gable(0.0, 8.0).translate((-0.5, 0, 0))
    hole = box((-0.4, 0.4), (-0.55, 0.55), (-1, 1)).rotate((38.0, 0, 0)).translate((2.4, 0.85, 1.9))
    walls ^= gable(0.1, 7.0)
    platform = box((4.6, 6.3), (-0.1, 1.9), (-0.02, 0.72))
    bodies = [
        body("room", "floor", prism(outer, 0.2).translate((0, 0, -0.2))),
        body("room", "wall_sage", walls.translate((0, 0, -0.05))),
        body("room", "ceiling", roof - hole),
        body("platform", "white", platform),
        body("stairs", "white", solids.stairs(4, 0.9, 0.26, 0.18), (3.6, 0.6, 0)),
        body("railing", "metal", solids.railing(1.5, 11), (5.4, 1.83, 0.72)),
        body("railing", "metal", solids.railing(0.7, 6), (4.68, 1.48, 0.72), 90),
        body("column", "white", cylinder(2.64, 0.14), (3.3, 1.6, -0.05)),
        body("beam", "dark_wood", box((-0.1, 6.3), (2.2, 2.4), (2.55, 2.75))),
        body("table", "wood", solids.round_table(), (1.3, 1.8, 0)),
        body("stool", "metal", solids.stool(), (0.7, 2.4, 0)),
        body("stool", "metal", solids.stool(), (1.7, 1.05, 0)),
        body("shelf", "white", solids.shelf(1.3, 0.3, 0.95, 3), (1.4, 4.61, 0)),
        body("bench", "wood", solids.table(1.1, 0.35, 0.45), (4.0, 4.2, 0)),
        body("chest", "books", box((-0.35, 0.35), (-0.2, 0.2), (-0.02, 0.42)), (0.5, 3.7, 0), 60),
        body("rug", "rug", cylinder(0.03, 0.7), (3.7, 3.1, -0.015)),
        body("box", "door", box((-0.25, 0.25), (-0.2, 0.2), (-0.02, 0.35)), (5.5, 2.7, 0), -33),
        *framed((0.0, 2.3, 1.5), 90, 0.8, 0.6),
        *framed((6.2, 1.2, 1.6), -90, 0.5, 0.5),
        *framed((5.55, 3.6, 1.2), -57, 0.6, 0.45),
    ]
    cos, sin = np.cos(np.radians(38.0)), np.sin(np.radians(38.0))  # of the roof's slope
    sky = Lamp((2.4, 0.72, 2.03), (0.4, 0, 0), (0, 0.55 * cos, 0.55 * sin), (0, sin, -cos), 16.0)
    lamps = [sky, downlight(4.4, 3.0, 2.4, 0.2, 8.0)]
    views = around((2.6, 2.75, 1.45), (1.6, 0.75), 2.6, 38)
    views += [((5.1 + 0.25 * k, 1.4 + 0.05 * k, 1.95), (2.0, 2.6, 0.9)) for k in range(4)]
    views += [((0.6, 1.0 + 0.4 * k, 1.45), (5.2, 1.6, 1.0)) for k in range(4)]
    return Room(bodies=bodies, lamps=lamps, views=posed(views))


def gable(thickness: float, length: float) -> Manifold:
    """The volume below a roof with its ridge along x at y = 2.3, moved outwards by `thickness`."""
    low, high = 1.2 + thickness / np.cos(np.radians(38)), 3.0 + thickness
    outline = np.array(
        [(-1.0, -0.3), (5.6, -0.3), (5.6, low - 0.78), (2.3, high), (-1.0, low - 0.78)]
    )
    return prism(outline, length).rotate((90, 0, 90)).translate((-0.4, 0, 0))


def corridor() -> Room:
    """A corridor that turns, with doors, a rail, a bench and coffers; the camera moves forward."""
    long, side = ((0.0, 11.0), (0.0, 1.9)), ((9.1, 11.0), (0.0, 5.0))
    cavities = box(*long, (-1, 4)) + box(*side, (-1, 4))
    walls = box((-0.2, 11.3), (-0.4, 5.2), (-0.1, 2.5)) - cavities
    doors, leaves = [], []
    for x, y in ((1.6, -0.12), (4.6, -0.12), (7.6, -0.12), (3.0, 2.02)):
        doors.append(box((x - 0.45, x + 0.45), (min(y, 1.0), max(y, 1.0)), (-1, 2.05)))
        into = 0.04 if y < 1 else -0.04  # of the leaf's front into the opening
        leaves.append(box((x - 0.5, x + 0.5), (y - 0.04, y + 0.04), (-0.05, 2.1)))
        handle = min(y, y + 2 * into), max(y, y + 2 * into)
        leaves.append(box((x + 0.3, x + 0.4), handle, (0.98, 1.01)))
    open_door = box((5.9, 6.9), (1.5, 3.6), (-1, 2.1)) + box((5.2, 7.6), (2.2, 4.4), (-1, 4))
    walls -= unite_all([*doors, open_door])
    panels = [box((x - 0.6, x + 0.6), (0.65, 1.25), (2.36, 2.6)) for x in (2.0, 5.0, 8.0)]
    panels += [box((9.75, 10.35), (2.6, 3.8), (2.36, 2.6))]
    ceiling = box((-0.2, 11.3), (-0.4, 5.2), (2.4, 2.7)) - unite_all(panels)
    glow = [box((x - 0.65, x + 0.65), (0.6, 1.3), (2.47, 2.49)) for x in (2.0, 5.0, 8.0)]
    glow += [box((9.7, 10.4), (2.55, 3.85), (2.47, 2.49))]
    rail = unite_rail([(2.2, 4.0), (5.2, 7.0)])
    bodies = [
        body("room", "floor_gray", box((-0.2, 11.3), (-0.4, 5.2), (-0.2, 0))),
        body("room", "ceiling", ceiling),
        body("room", "wall_cool", walls),
        body("panel", "glow", unite_all(glow)),
        body("leaf", "door", unite_all(leaves)),
        body("rail", "wood", rail),
        body("bench", "metal", solids.table(1.4, 0.4, 0.45), (4.4, 1.65, 0)),
        body("bin", "metal", cylinder(0.6, 0.16), (8.7, 1.66, -0.02)),
        body("cabinet", "white", box((10.55, 11.05), (3.6, 4.6), (-0.02, 1.2))),
        body("cart", "door", solids.table(0.8, 0.5, 0.85), (10.3, 0.55, 0), 20),
        body("bed", "white", solids.table(1.2, 0.7, 0.5), (6.3, 3.6, 0), 5),
        *framed((1.3, 1.9, 1.5), 0, 0.6, 0.8),
        *framed((8.0, 1.9, 1.5), 0, 0.8, 0.6),
        *framed((11.0, 1.6, 1.45), -90, 0.7, 0.9),
        *framed((9.1, 3.6, 1.5), 90, 0.6, 0.6),
        body("mat", "rug", box((-0.4, 0.4), (-0.3, 0.3), (-0.01, 0.012)), (10.0, 2.2, 0), 7),
    ]
    down, long, side = (0, 0, -1), ((0.58, 0, 0), (0, 0.28, 0)), ((0.28, 0, 0), (0, 0.58, 0))
    lamps = [Lamp((x, 0.95, 2.46), *long, down, 3.2) for x in (2.0, 5.0, 8.0)]
    lamps.append(Lamp((10.05, 3.2, 2.46), *side, down, 3.2))
    lamps.append(downlight(6.4, 3.3, 2.38, 0.25, 4.0))
    return Room(bodies=bodies, lamps=lamps, views=posed(walk()))


def unite_rail(spans: list[tuple[float, float]]) -> Manifold:
    """Hand rails along x with brackets that reach into the wall at y = 0."""
    parts = [box(span, (0.045, 0.085), (0.85, 0.95)) for span in spans]
    parts += [
        box((x - 0.02, x + 0.02), (-0.02, 0.06), (0.88, 0.92))
        for span in spans
        for x in (span[0] + 0.3, span[1] - 0.3)
    ]
    return unite_all(parts)


def walk() -> list[tuple[Point, Point]]:
    """A camera that moves along a corridor, swaying a little, and round its corner."""
    views: list[tuple[Point, Point]] = []
    for i, x in enumerate(np.linspace(0.4, 9.4, 30)):
        sway = 0.95 + 0.3 * np.sin(0.9 * i)
        turn = 0.25 * np.sin(0.55 * i)
        position = (float(x), float(sway), 1.4 + 0.1 * np.cos(0.7 * i))
        views.append((position, (x + 3.0, sway + 3.0 * turn, 1.25 + 0.15 * np.sin(0.4 * i))))
    for i, turn in enumerate(np.linspace(0.1, 1.0, 6)):
        angle = turn * np.pi / 2
        position = (9.5 + 0.08 * i, 0.95 + 0.1 * i, 1.45 + 0.05 * (-1) ** i)
        target = (position[0] + 3 * np.cos(angle), position[1] + 3 * np.sin(angle), 1.25)
        views.append((position, target))
    for i, y in enumerate(np.linspace(1.6, 3.2, 8)):
        x = 10.0 + 0.25 * np.sin(1.1 * i)
        views.append(((x, float(y), 1.4), (x + 0.4 * np.sin(0.8 * i), y + 3.0, 1.2)))
    return views


ROOMS: dict[str, Callable[[], Room]] = {make.__name__: make for make in (living, attic, corridor)}
