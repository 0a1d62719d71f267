"""Closed solids in metres, z up: simple ones, and furniture that stands about the origin."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from manifold3d import CrossSection, Manifold, OpType

from zoo.geometry import Array, Body

Span = tuple[float, float]
Point = tuple[float, float, float]
SEGMENTS = 96  # around a full turn; chord error under 0.001 of the radius
SINK = 0.02  # depth by which a piece enters the floor, so that no two faces coincide


def box(x: Span, y: Span, z: Span) -> Manifold:
    """The axis-aligned box between the given bounds."""
    low, high = zip(x, y, z, strict=True)
    size = tuple(b - a for a, b in zip(low, high, strict=True))
    return Manifold.cube(size).translate(low)


def prism(outline: Any, height: float) -> Manifold:
    """A counter-clockwise (N, 2) outline extruded from z = 0 to `height`."""
    return Manifold.extrude(CrossSection([np.asarray(outline)]), height)


def lathe(profile: Any, segments: int = SEGMENTS) -> Manifold:
    """A counter-clockwise (N, 2) profile of radius and height turned about the z axis."""
    return Manifold.revolve(CrossSection([np.asarray(profile)]), segments)


def cylinder(height: float, radius: float, segments: int = SEGMENTS, top: float = -1.0) -> Manifold:
    """An upright cylinder from z = 0 on; a cone with another radius at its top."""
    return Manifold.cylinder(height, radius, top, segments)


def ball(radius: float, count: int, segments: int = SEGMENTS) -> Manifold:
    """A ball about the origin, with `count` points from pole to pole."""
    profile = arc(radius, -90, 90, count)
    profile[[0, -1], 0] = 0
    return lathe(profile, segments)


def arc(radius: float, start_deg: float, end_deg: float, count: int) -> Array:
    """`count` points of a circle about the origin, shape (count, 2)."""
    angles = np.radians(np.linspace(start_deg, end_deg, count))
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def unite_all(parts: Iterable[Manifold]) -> Manifold:
    """The union of solids."""
    return Manifold.batch_boolean(list(parts), OpType.Add)


def body(name: str, material: str, solid: Manifold, at: Point = (0, 0, 0), turn: float = 0) -> Body:
    """A body turned by `turn` degrees about z and moved to `at`."""
    return Body(name, material, solid.rotate((0, 0, turn)).translate(at))


def parts(
    name: str, solid: Manifold, region: Manifold | None, materials: tuple[str, str]
) -> Iterator[Body]:
    """A body of two materials: the second is that of its part in a region, if there is one."""
    inside, outside = (Manifold(), solid) if region is None else solid.split(region)
    for material, part in zip(materials, (outside, inside), strict=True):
        if not part.is_empty():
            yield Body(name, material, part)


def table(length: float, width: float, height: float) -> Manifold:
    """A table with four square legs and a frame below its top."""
    x, y, leg = length / 2, width / 2, 0.06
    top = box((-x, x), (-y, y), (height - 0.035, height))
    frame = box((-x + 0.05, x - 0.05), (-y + 0.05, y - 0.05), (height - 0.12, height - 0.02))
    frame -= box((-x + 0.08, x - 0.08), (-y + 0.08, y - 0.08), (0, height - 0.035))
    return unite_all([top, frame, *legs(x - 0.03, y - 0.03, leg, height - 0.02)])


def legs(x: float, y: float, width: float, height: float) -> list[Manifold]:
    """Four square legs whose outer corners are at (+-x, +-y)."""
    spans = [(-1, (0.0, width)), (1, (-width, 0.0))]
    return [
        box((i * x + a[0], i * x + a[1]), (j * y + b[0], j * y + b[1]), (-SINK, height))
        for i, a in spans
        for j, b in spans
    ]


def chair() -> Manifold:
    """A chair with four legs and a back of three slats, its front towards -y."""
    parts = [box((-0.22, 0.22), (-0.22, 0.22), (0.43, 0.46)), *legs(0.21, 0.21, 0.04, 0.44)]
    parts += [box((s - 0.02, s + 0.02), (0.17, 0.21), (0.4, 0.9)) for s in (-0.19, 0.19)]
    parts += [box((-0.18, 0.18), (0.18, 0.2), (z, z + 0.07)) for z in (0.56, 0.68, 0.8)]
    return unite_all(parts)


def stool() -> Manifold:
    """A round seat on a turned foot."""
    radius, height = 0.17, 0.46
    profile = [(0, -SINK), (0.16, -SINK), (0.16, 0.03), (0.03, 0.05), (0.03, height - 0.05)]
    profile += [(radius, height - 0.04), (radius, height), (0, height)]
    return lathe(profile)


def round_table() -> Manifold:
    """A round top on one thick foot."""
    radius, height = 0.5, 0.72
    profile = [(0, -SINK), (0.28, -SINK), (0.28, 0.03), (0.06, 0.07), (0.06, height - 0.08)]
    profile += [(0.2, height - 0.03), (radius, height - 0.03), (radius, height), (0, height)]
    return lathe(profile)


def shelf(width: float, depth: float, height: float, boards: int) -> Manifold:
    """An open shelf along x with its front towards -y; y = 0 is its back."""
    t, x = 0.03, width / 2
    outside = box((-x, x), (-depth, 0), (-SINK, height))
    levels = np.linspace(0.08, height - t, boards)
    for low, high in zip(levels[:-1] + t, levels[1:], strict=True):
        outside -= box((-x + t, x - t), (-depth - 1, -0.015), (low, high))
    return outside


def sofa(width: float) -> Manifold:
    """A sofa along x with its front towards -y: seat, two cushions, back, arms and feet."""
    x = width / 2
    parts = [box((-x, x), (-0.42, 0.42), (0.12, 0.32)), box((-x, x), (0.22, 0.42), (0.12, 0.8))]
    parts += [box((s * x - 0.08, s * x + 0.08), (-0.4, 0.4), (0.12, 0.58)) for s in (-1, 1)]
    half = (x - 0.1) / 2
    parts += [
        box((c - half, c + half), (-0.44, 0.25), (0.3, 0.44)) for c in (-half - 0.005, half + 0.005)
    ]
    parts += legs(x, 0.4, 0.06, 0.15)
    return unite_all(parts)


def radiator(width: float) -> Manifold:
    """A ribbed radiator along x, its back at y = 0.03 so that it hangs before the wall."""
    x = width / 2
    parts = [box((-x, x), (-0.1, -0.05), (0.15, 0.72))]
    parts += [
        box((c - 0.015, c + 0.015), (-0.12, -0.03), (0.13, 0.74))
        for c in np.linspace(-x + 0.04, x - 0.04, round(width / 0.1))
    ]
    parts += [box((s - 0.02, s + 0.02), (-0.06, 0.03), (0.6, 0.64)) for s in (-x / 2, x / 2)]
    return unite_all(parts)


def railing(length: float, posts: int, height: float = 0.95) -> Manifold:
    """Square posts along x under a hand rail, with a thin rail at half the height."""
    x = length / 2
    parts = [box((-x, x), (-0.03, 0.03), (height - 0.05, height))]
    parts += [box((-x, x), (-0.012, 0.012), (height / 2 - 0.012, height / 2 + 0.012))]
    parts += [
        box((c - 0.018, c + 0.018), (-0.018, 0.018), (-SINK, height - 0.02))
        for c in np.linspace(-x + 0.05, x - 0.05, posts)
    ]
    return unite_all(parts)


def stairs(steps: int, width: float, run: float, rise: float) -> Manifold:
    """Steps that rise along +x from x = 0, with their middle at y = 0."""
    return unite_all(
        [
            box((i * run, steps * run), (-width / 2, width / 2), (-SINK - 0.01 * i, (i + 1) * rise))
            for i in range(steps)
        ]
    )


def picture_frame(width: float, height: float) -> Manifold:
    """A frame in the plane y = 0, its front towards -y, its back 2 cm inside of the wall."""
    x, z, t = width / 2, height / 2, 0.04
    frame = box((-x, x), (-0.03, 0.02), (-z, z))
    return frame - box((-x + t, x - t), (-1, -0.012), (-z + t, z - t))


def canvas(width: float, height: float) -> Manifold:
    """The picture inside such a frame."""
    x, z = width / 2 - 0.03, height / 2 - 0.03
    return box((-x, x), (-0.015, 0.015), (-z, z))


def pendant(length: float) -> Manifold:
    """A shade (a truncated cone) that hangs on a rod from z = 0."""
    radius = height = 0.2
    shade = cylinder(height, radius, top=0.4 * radius)
    rod = box((-0.012, 0.012), (-0.012, 0.012), (-length, 0.02))
    return unite_all([shade.translate((0, 0, -length - height + 0.01)), rod])
