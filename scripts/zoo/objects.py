"""Random solids, 1 or so in size, standing on z = 0: turned and bent ones, and machined ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import CrossSection, Manifold
from scipy.interpolate import PchipInterpolator

from zoo import solids
from zoo.geometry import Array, Random
from zoo.machined import OBJECTS
from zoo.solids import arc, ball, box, lathe, unite_all

SEGMENTS = 128  # around a full turn of machined bodies
PROFILE = 33  # points along the profile of a smooth body
SINK = 0.01  # depth by which a body enters the ground, so that no two faces coincide


def bounds(solid: Manifold) -> Array:
    """(2, 3) lowest and highest coordinates of a solid."""
    return np.array(solid.bounding_box()).reshape(2, 3)


def can(random: Random) -> Manifold:
    """A cylinder with rounded rims and a sunk lid."""
    radius, height = random.uniform(0.25, 0.4), random.uniform(0.5, 1.1)
    profile = [(0, 0), (0.9 * radius, 0), (radius, 0.06), (radius, height - 0.06)]
    profile += [(0.88 * radius, height), (0.83 * radius, height), (0.83 * radius, height - 0.04)]
    return lathe([*profile, (0, height - 0.04)])


def turned(heights: Array, radii: Array, wall: float = 0.0) -> Manifold:
    """A body whose radius goes smoothly through given ones; hollow from above with a wall."""
    z = np.linspace(heights[0], heights[-1], PROFILE)
    outside = np.column_stack([PchipInterpolator(heights, radii)(z), z])
    inside = [(0.0, heights[-1])]
    if wall:
        inner = outside[outside[:, 1] > heights[0] + 2 * wall] - (wall, 0)
        inside = [*inner[::-1], (0.0, inner[0, 1])]
    return lathe([(0.0, heights[0]), *outside, *inside])


def bottle(random: Random) -> Manifold:
    """A bottle with a neck."""
    wide, neck = random.uniform(0.2, 0.32), random.uniform(0.07, 0.1)
    radii = np.array([0.92 * wide, wide, wide, 0.9 * wide, neck, neck])
    return turned(np.array([0, 0.04, 0.5, 0.6, 0.8, 1]) * random.uniform(1, 1.5), radii)


def vase(random: Random) -> Manifold:
    """An open vase."""
    radii = random.uniform(0.15, 0.42, 5)
    return turned(np.linspace(0, random.uniform(0.8, 1.3), 5), radii, wall=0.04)


def cup(random: Random) -> Manifold:
    """A cup with a handle."""
    radius, height = random.uniform(0.28, 0.36), random.uniform(0.55, 0.75)
    body = turned(np.array([0, 0.05, height]), radius * np.array([0.85, 0.95, 1]), wall=0.03)
    handle = ring(0.045, 0.3 * height, 21).rotate((90, 0, 0)).translate((radius, 0, 0.52 * height))
    return body + (handle - solids.cylinder(2, 0.97 * radius, SEGMENTS))


def sphere(random: Random) -> Manifold:
    """A ball."""
    radius = random.uniform(0.25, 0.5)
    return ball(radius, PROFILE + 8).translate((0, 0, radius))


def egg(random: Random) -> Manifold:
    """A body without any crease."""
    t = np.linspace(0, np.pi, PROFILE + 8)
    radius = np.sin(t) * (0.36 + random.uniform(-0.14, 0.14) * np.cos(t))
    profile = np.column_stack([radius, 0.5 * (1 - np.cos(t))])
    profile[[0, -1], 0] = 0
    return lathe(profile).scale((1, 1, random.uniform(0.7, 1.3)))


def torus(random: Random) -> Manifold:
    """A ring, lying or upright."""
    thick, wide = random.uniform(0.1, 0.18), random.uniform(0.3, 0.45)
    lying = ring(thick, wide)
    if random.random() < 0.5:
        return lying.translate((0, 0, thick))
    return lying.rotate((90, 0, 0)).translate((0, 0, wide + thick))


def tube(random: Random) -> Manifold:
    """A bent tube with both its ends on the ground."""
    thick, wide = random.uniform(0.08, 0.14), random.uniform(0.35, 0.5)
    return ring(thick, wide, turn_deg=180).rotate((90, 0, 0))


def ring(thick: float, wide: float, count: int = PROFILE + 8, turn_deg: float = 360) -> Manifold:
    """A ring about the z axis of `count` points around its section, or a part of one."""
    circle = np.add(arc(thick, 0, 360, count)[:-1], (wide, 0))
    return Manifold.revolve(CrossSection([circle]), solids.SEGMENTS, turn_deg)


def block(random: Random) -> Manifold:
    """A box."""
    x, y, z = random.uniform(0.25, 0.5, 3)
    return box((-x, x), (-y, y), (0, 2 * z))


def rounded_block(random: Random) -> Manifold:
    """A plate or box with rounded upright edges."""
    x, y = random.uniform(0.2, 0.45, 2)
    outline = CrossSection([np.array([(-x, -y), (x, -y), (x, y), (-x, y)])])
    rounded = outline.offset(random.uniform(0.05, 0.15), circular_segments=SEGMENTS)
    return Manifold.extrude(rounded, random.uniform(0.2, 1))


def polygon(random: Random) -> Manifold:
    """A prism, frustum or pyramid."""
    count = int(random.integers(3, 9))
    low, high = random.uniform(0.35, 0.5), random.choice([1.0, random.uniform(0.3, 0.9)])
    return solids.cylinder(random.uniform(0.3, 1.0), low, count, low * high)


def cylinder(random: Random) -> Manifold:
    """A cylinder or cone."""
    low, high = random.uniform(0.25, 0.5), random.choice([1.0, random.uniform(0.4, 0.9)])
    return solids.cylinder(random.uniform(0.3, 1), low, SEGMENTS, low * high)


def stepped(random: Random) -> Manifold:
    """A shaft of several steps, some of them cones."""
    radii, levels = random.uniform(0.12, 0.42, 4), np.cumsum(random.uniform(0.12, 0.35, 4))
    profile, below = [(0.0, 0.0), (radii[0], 0.0)], radii[0]
    for radius, level in zip(radii[1:], levels[:-1], strict=True):
        profile += [(below, level), (radius, level)]
        below = radius * random.choice([1.0, 0.85])
    return lathe([*profile, (below, levels[-1]), (0, levels[-1])], SEGMENTS)


def machined(random: Random) -> Manifold:
    """A base with bosses on it, and holes and slots in it."""
    makers = (block, rounded_block, polygon, cylinder)
    solid = makers[random.integers(len(makers))](random)
    low, high = bounds(solid)
    reach = 0.55 * min(high[0], high[1])
    for _ in range(random.integers(1, 3)):
        x, y = random.uniform(-reach, reach, 2)
        boss = cylinder(random) if random.random() < 0.5 else polygon(random)
        size = random.uniform(0.3, 0.6) * (high[0] - low[0])
        solid += boss.scale((size, size, size)).translate((x, y, 0.8 * high[2]))
    top = solid.bounding_box()[5]
    for _ in range(random.integers(1, 5)):
        x, y = random.uniform(-reach, reach, 2)
        depth = random.choice([0.1, 0.3, 2.0])
        hole = solids.cylinder(3, random.uniform(0.05, 0.14), SEGMENTS)
        if random.random() < 0.3:
            solid -= hole.rotate((90, 0, 90 * random.integers(2))).translate((x, y, 0.5 * top))
            solid -= hole.rotate((-90, 0, 90 * random.integers(2))).translate((x, y, 0.45 * top))
        else:
            solid -= hole.translate((x, y, top - depth))
    if random.random() < 0.4:
        solid -= box((-0.07, 0.07), (-2, 2), (0.7 * top, 3)).rotate((0, 0, random.uniform(0, 180)))
    return max(solid.decompose(), key=lambda part: part.volume())  # of its separate parts


def made(random: Random) -> Manifold:
    """One of the hand-made CAD objects, standing."""
    names = sorted(set(OBJECTS) - {"elbow"})  # of too many triangles
    return grounded(OBJECTS[names[random.integers(len(names))]]())


def grounded(solid: Manifold) -> Manifold:
    """The solid moved so that it stands on z = 0 about the z axis."""
    low, high = bounds(solid)
    middle = (low + high) / 2
    return solid.translate((-middle[0], -middle[1], -low[2]))


def sized(solid: Manifold, size: float) -> Manifold:
    """The solid, grounded, with its longest side `size`."""
    low, high = bounds(solid)
    return grounded(solid.scale((size / (high - low).max(),) * 3))


SMOOTH: tuple[Callable[[Random], Manifold], ...] = (
    can, bottle, vase, cup, sphere, egg, torus, tube,
)  # fmt: skip
CAD: tuple[Callable[[Random], Manifold], ...] = (
    machined, made, stepped, rounded_block, polygon, cylinder,
)  # fmt: skip


def bands(random: Random, solid: Manifold) -> Manifold:
    """A region that gives a solid level stripes or slanted ones."""
    low, high = solid.bounding_box()[2], solid.bounding_box()[5]
    count = int(random.integers(1, 4))
    levels = np.linspace(low, high, count + 2)[1:-1] + random.uniform(-0.02, 0.02, count)
    width = random.uniform(0.15, 0.35) * (high - low) / count
    slabs = [box((-5, 5), (-5, 5), (z - width / 2, z + width / 2)) for z in levels]
    slant = random.uniform(5, 30) if random.random() < 0.4 else 0
    turned_about = [
        slab.translate((0, 0, -z)).rotate((slant, 0, 0)).translate((0, 0, z))
        for slab, z in zip(slabs, levels, strict=True)
    ]
    return unite_all(turned_about).rotate((0, 0, random.uniform(0, 360)))


def label(random: Random, solid: Manifold) -> Manifold:
    """A region that prints a rectangle or disc on one side of a solid, or on its top."""
    low, high = bounds(solid)
    height = high[2] - low[2]
    width = 0.5 * min(high[0] - low[0], height)
    shape = box((-width / 2, width / 2), (0, 5), (-width / 3, width / 3))
    if random.random() < 0.4:
        shape = solids.cylinder(5, width / 2.5).rotate((-90, 0, 0))
    side = float(90 * random.integers(4))
    return shape.translate((0, 0, low[2] + random.uniform(0.4, 0.65) * height)).rotate((0, 0, side))


def scattered(random: Random, radii: list[float], gap: float) -> list[tuple[float, float]]:
    """(x, y) positions of discs that do not touch, close to the origin."""
    found: list[tuple[float, float]] = []
    for i, radius in enumerate(radii):
        reach = 0.0
        while True:
            reach += 0.02 * radius
            x, y = random.uniform(-reach, reach, 2)
            if all(
                np.hypot(x - a, y - b) > radius + other + gap
                for (a, b), other in zip(found, radii[:i], strict=True)
            ):
                found.append((float(x), float(y)))
                break
    return found


def ground_radius(solid: Manifold) -> float:
    """Radius of the circle about the z axis that a solid needs."""
    return float(np.abs(bounds(solid)[:, :2]).max() * 1.15)


def plate(radius: float, round_one: bool) -> Manifold:
    """A ground of some thickness, from z = 0 down."""
    if round_one:
        return solids.cylinder(0.1, radius, SEGMENTS).translate((0, 0, -0.1))
    return box((-radius, radius), (-radius, radius), (-0.1, 0))
