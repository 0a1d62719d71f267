"""The bodies of the demo scene as closed solids, in metres, z up, front towards -y."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold, OpType
from numpy.typing import NDArray

SINK = 0.1  # depth by which a body enters the plinth, so that no two faces coincide
SEGMENTS = 96  # around a full turn; chord error under 0.001 of the radius


@dataclass(frozen=True, kw_only=True)
class Body:
    """A solid, the material of its surface and the object that it belongs to."""

    name: str
    material: str
    solid: Manifold


def make_bodies() -> list[Body]:
    """Return all bodies; bodies that touch overlap a little, so that they unite."""
    makers = (
        ground,
        house,
        arch,
        column,
        washer,
        chamfered_box,
        hexagonal_prism,
        curved_wall,
        pear,
        glossy_sphere,
        glossy_torus,
        railing,
    )
    return [body for make in makers for body in make()]


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Manifold:
    """Return the axis-aligned box between the given bounds."""
    low, high = zip(x, y, z, strict=True)
    size = tuple(b - a for a, b in zip(low, high, strict=True))
    return Manifold.cube(size).translate(low)


def prism(outline: NDArray[np.float64], height: float) -> Manifold:
    """Extrude a counter-clockwise (N, 2) outline from z = 0 to `height`."""
    return Manifold.extrude(CrossSection([outline]), height)


def lathe(profile: NDArray[np.float64], segments: int = SEGMENTS) -> Manifold:
    """Turn a counter-clockwise (N, 2) profile of radius and height about the z axis."""
    return Manifold.revolve(CrossSection([profile]), segments)


def arc(radius: float, start_deg: float, end_deg: float, count: int) -> NDArray[np.float64]:
    """Return `count` points of a circle about the origin, shape (count, 2)."""
    angles = np.radians(np.linspace(start_deg, end_deg, count))
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def ground() -> Iterator[Body]:
    """Yield the plinth: textured, with a two-coloured disc and two stripes let into its top."""
    plinth = box((-5, 5), (-3.75, 3.75), (-0.5, 0))
    disc, ring = (Manifold.cylinder(1, r, circular_segments=SEGMENTS) for r in (0.45, 0.75))
    # Different depths: where the bottoms of two inlays coincide, their union leaves slivers.
    inner, plinth = plinth.split(disc.translate((-2.3, -0.7, -0.2)))
    outer, plinth = plinth.split(ring.translate((-2.3, -0.7, -0.3)))
    wide, plinth = plinth.split(box((-4.6, 1.7), (-3.5, -3.2), (-0.3, 1)))
    oblique = box((-0.9, 0.9), (-0.1, 0.1), (-0.3, 1)).rotate((0, 0, 35))
    narrow, plinth = plinth.split(oblique.translate((3.0, -2.0, 0)))
    yield Body(name="plinth", material="stone", solid=plinth)
    yield Body(name="plinth", material="paint_dark", solid=outer)
    yield Body(name="plinth", material="paint_light", solid=inner)
    yield Body(name="plinth", material="paint_light", solid=wide)
    yield Body(name="plinth", material="paint_dark", solid=narrow)


def house() -> Iterator[Body]:
    """Yield a building: windows, door, steps, painted base, ledge, cornice and gable roof."""
    x, y = (-3.6, 0.2), (1.0, 3.0)
    walls = box(x, y, (-SINK, 2.4)) - house_openings()
    base, walls = walls.split(box((-5, 5), (-5, 5), (-1, 0.3)))
    ledge = box((x[0] - 0.08, x[1] + 0.08), (y[0] - 0.08, y[1] + 0.08), (1.22, 1.34))
    cornice = box((x[0] - 0.2, x[1] + 0.2), (y[0] - 0.2, y[1] + 0.2), (2.35, 2.55))
    gable = np.array([(-1.15, 0.0), (1.15, 0.0), (0.0, 0.95)])
    roof = prism(gable, x[1] - x[0] + 0.2).rotate((90, 0, 90)).translate((x[0] - 0.1, 2.0, 2.5))
    steps = [box((-2.3 - d, -1.1 + d), (0.7 - d, 1.2), (-SINK, 0.3 - d / 3)) for d in (0, 0.3, 0.6)]
    yield Body(name="house", material="stucco", solid=walls)
    yield Body(name="house", material="paint_dark", solid=base)
    yield Body(name="house", material="plaster", solid=ledge + cornice)
    yield Body(name="house", material="tiles", solid=roof)
    yield Body(name="house", material="plaster", solid=steps[0] + steps[1] + steps[2])


def house_openings() -> Manifold:
    """Return the volume of the recessed windows and of the arched door."""
    front = [(c, z) for c in (-3.05, -0.35) for z in (0.5, 1.55)] + [(-1.7, 1.62)]
    windows = [box((c - 0.28, c + 0.28), (0.5, 1.16), (z, z + 0.6)) for c, z in front]
    windows += [
        box((0.0, 0.5), (c - 0.28, c + 0.28), (z, z + 0.6))
        for c in (1.55, 2.45)
        for z in (0.5, 1.55)
    ]
    windows += [box((-4, -3.45), (c - 0.28, c + 0.28), (1.55, 2.15)) for c in (1.55, 2.45)]
    half_disc = arc(0.35, 0, 180, 33) + np.array([0, 0.82])
    outline = np.vstack([[(-0.35, 0.3), (0.35, 0.3)], half_disc])
    door = prism(outline, 1.0).rotate((90, 0, 0)).translate((-1.7, 1.2, 0))
    return Manifold.batch_boolean([*windows, door], OpType.Add)


def arch() -> Iterator[Body]:
    """Yield a gate: two straight legs under a half-ring."""
    outer, inner = arc(1.15, 0, 180, 65), arc(0.72, 180, 0, 49)
    feet = np.array([[(-1.15, -1.3), (-0.72, -1.3)], [(0.72, -1.3), (1.15, -1.3)]])
    outline = np.vstack([outer, feet[0], inner, feet[1]])
    gate = prism(outline, 0.55).rotate((90, 0, 0)).translate((0, 0.275, 1.2))
    yield Body(
        name="arch", material="sandstone", solid=gate.rotate((0, 0, -18)).translate((2.6, 2.2, 0))
    )


def column() -> Iterator[Body]:
    """Yield a drum on a round base under a round capital, all rims sharp."""
    profile = [(0, -SINK), (0.52, -SINK), (0.52, 0.2), (0.36, 0.2), (0.36, 1.45)]
    profile += [(0.5, 1.45), (0.5, 1.65), (0, 1.65)]
    yield Body(
        name="column", material="plaster", solid=lathe(np.array(profile)).translate((4.15, 0.6, 0))
    )


def washer() -> Iterator[Body]:
    """Yield an upright disc with a round hole."""
    disc = Manifold.cylinder(0.22, 0.68, circular_segments=SEGMENTS)
    hole = Manifold.cylinder(1, 0.33, circular_segments=SEGMENTS).translate((0, 0, -0.5))
    upright = (disc - hole).rotate((90, 0, 28)).translate((1.15, 0.35, 0.62))
    yield Body(name="washer", material="ochre", solid=upright)


def chamfered_box() -> Iterator[Body]:
    """Yield a textureless box with one corner cut off and a smaller one on its top."""
    block = box((-0.55, 0.55), (-0.45, 0.45), (-SINK, 1.0))
    block = block.trim_by_plane((-1, 1, -1), -0.93)
    top = box((-0.25, 0.3), (-0.2, 0.25), (0.9, 1.35)).rotate((0, 0, 20))
    yield Body(
        name="box",
        material="matte_white",
        solid=(block + top).rotate((0, 0, 27)).translate((-4.15, -0.6, 0)),
    )


def hexagonal_prism() -> Iterator[Body]:
    """Yield a textureless hexagonal prism with a shallow pyramid as its top."""
    column = Manifold.cylinder(0.8 + SINK, 0.55, circular_segments=6).translate((0, 0, -SINK))
    tip = Manifold.cylinder(0.45, 0.55, 0.0, circular_segments=6).translate((0, 0, 0.8))
    yield Body(
        name="hexagon",
        material="matte_blue",
        solid=(column + tip).rotate((0, 0, 10)).translate((3.9, -1.1, 0)),
    )


def curved_wall() -> Iterator[Body]:
    """Yield an S-shaped wall with a level top: smooth sides, sharp rims."""
    t = np.linspace(-1, 1, 81)
    line = np.column_stack([2.0 * t, 0.45 * np.sin(np.pi * t)])
    tangent = np.gradient(line, t, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normal *= 0.11 / np.linalg.norm(normal, axis=1, keepdims=True)
    outline = np.vstack([line - normal, (line + normal)[::-1]])
    yield Body(
        name="curved_wall",
        material="matte_green",
        solid=prism(outline, 0.55 + SINK).translate((-2.1, -2.25, -SINK)),
    )


def pear() -> Iterator[Body]:
    """Yield a matte smooth body, whose silhouette is view-dependent."""
    t = np.linspace(0, np.pi, 49)
    radius = np.sin(t) * (0.42 - 0.13 * np.cos(t + np.pi)) + 0.05 * np.sin(t) * np.sin(3 * t)
    profile = np.column_stack([radius, -0.7 * np.cos(t) + 0.62])
    profile[[0, -1], 0] = 0.0
    yield Body(name="pear", material="matte_grey", solid=lathe(profile).translate((0.0, -0.9, 0)))


def glossy_sphere() -> Iterator[Body]:
    """Yield a glossy ball, whose silhouette, highlights and reflections are view-dependent."""
    profile = arc(0.5, -90, 90, 49)
    profile[[0, -1], 0] = 0.0
    yield Body(
        name="sphere", material="glossy_red", solid=lathe(profile).translate((2.25, -0.75, 0.47))
    )


def glossy_torus() -> Iterator[Body]:
    """Yield a glossy ring that lies on the plinth."""
    profile = arc(0.17, 0, 360, 41)[:-1] + np.array([0.48, 0])
    yield Body(
        name="torus", material="glossy_black", solid=lathe(profile).translate((1.2, -2.2, 0.13))
    )


def railing() -> Iterator[Body]:
    """Yield thin posts and rails of square section."""
    half = 0.03
    posts = [box((x - half, x + half), (-half, half), (-SINK, 0.75)) for x in np.linspace(-1, 1, 6)]
    rails = [box((-1.05, 1.05), (-0.022, 0.022), (z - 0.022, z + 0.022)) for z in (0.35, 0.68)]
    solid = Manifold.batch_boolean([*posts, *rails], OpType.Add)
    yield Body(
        name="railing",
        material="matte_white",
        solid=solid.rotate((0, 0, 8)).translate((3.65, -3.2, 0)),
    )
