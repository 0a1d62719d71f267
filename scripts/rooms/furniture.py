"""Pieces of furniture as closed solids in metres, z up, standing about the origin."""

from __future__ import annotations

import numpy as np
from demo_scene.bodies import box, lathe
from manifold3d import Manifold, OpType

SINK = 0.02  # depth by which a piece enters the floor, so that no two faces coincide


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


def stool(height: float = 0.46, radius: float = 0.17) -> Manifold:
    """A round seat on a turned foot."""
    profile = [(0, -SINK), (0.16, -SINK), (0.16, 0.03), (0.03, 0.05), (0.03, height - 0.05)]
    profile += [(radius, height - 0.04), (radius, height), (0, height)]
    return lathe(np.array(profile))


def round_table(radius: float, height: float) -> Manifold:
    """A round top on one thick foot."""
    profile = [(0, -SINK), (0.28, -SINK), (0.28, 0.03), (0.06, 0.07), (0.06, height - 0.08)]
    profile += [(0.2, height - 0.03), (radius, height - 0.03), (radius, height), (0, height)]
    return lathe(np.array(profile))


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
    x, z, t = width / 2 - 0.03, height / 2 - 0.03, 0.0
    return box((-x, x), (-0.015, 0.015), (-z + t, z - t))


def pendant(radius: float, height: float, length: float) -> Manifold:
    """A shade (a truncated cone) that hangs on a rod from z = 0."""
    shade = Manifold.cylinder(height, radius, 0.4 * radius, circular_segments=96)
    rod = box((-0.012, 0.012), (-0.012, 0.012), (-length, 0.02))
    return unite_all([shade.translate((0, 0, -length - height + 0.01)), rod])


def unite_all(parts: list[Manifold]) -> Manifold:
    """The union of solids."""
    return Manifold.batch_boolean(parts, OpType.Add)
