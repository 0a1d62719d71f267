"""Hand-made CAD objects as closed solids."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from zoo.geometry import Array
from zoo.solids import arc, ball, box, lathe, prism
from zoo.solids import cylinder as coarse_cylinder

SEGMENTS = 192  # around a full turn


def cylinder(height: float, radius: float) -> Manifold:
    """An upright cylinder from z = 0 on."""
    return coarse_cylinder(height, radius, SEGMENTS)


def polar(angle: Array, radius: float | Array) -> Array:
    """(N, 2) points at (N,) angles and radii."""
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def bracket() -> Manifold:
    """An angle with a rib, holes and a bore."""
    solid = box((0, 1), (0, 0.6), (0, 0.12)) + box((0, 0.12), (0, 0.6), (0, 0.7))
    for x in (0.4, 0.8):
        for y in (0.15, 0.45):
            solid -= cylinder(1, 0.07).translate((x, y, -0.3))
    solid -= cylinder(1, 0.15).rotate((0, 90, 0)).translate((-0.3, 0.3, 0.45))
    rib = prism([(0.1, 0.1), (0.5, 0.1), (0.1, 0.5)], 0.08)
    return solid + rib.rotate((90, 0, 0)).translate((0, 0.34, 0))


def gear() -> Manifold:
    """Teeth, hub, keyway and five holes."""
    teeth = np.arange(18 * 4)
    outline = polar(2 * np.pi * teeth / len(teeth), np.where(teeth % 4 < 2, 0.5, 0.42))
    solid = prism(outline, 0.15) + cylinder(0.3, 0.2)
    solid -= cylinder(1, 0.1).translate((0, 0, -0.2)) + box((-0.03, 0.03), (0, 0.14), (-1, 1))
    for x, y in polar(np.arange(5) * 0.4 * np.pi, 0.3):
        solid -= cylinder(1, 0.06).translate((x, y, -0.3))
    return solid


def shaft() -> Manifold:
    """A stepped shaft with a keyway and a flat: mostly smooth."""
    profile = [(0, 0), (0.1, 0), (0.1, 0.2), (0.16, 0.2), (0.16, 0.3), (0.13, 0.33), (0.13, 0.7)]
    profile += [(0.09, 0.7), (0.09, 0.96), (0.05, 1), (0, 1)]
    keyway = box((-0.03, 0.03), (0.08, 0.3), (0.42, 0.62))
    flat = box((-0.3, 0.3), (0.06, 0.2), (0.78, 2)).rotate((0, 0, 30))
    return lathe(profile, SEGMENTS) - keyway - flat


def tray() -> Manifold:
    """A tray with rounded corners and a bushing."""
    outline = CrossSection([np.array([(0, 0), (0.8, 0), (0.8, 0.5), (0, 0.5)])])
    outer = outline.offset(0.1, circular_segments=128)
    inner = outer.offset(-0.06, circular_segments=128)
    solid = Manifold.extrude(outer, 0.2) - Manifold.extrude(inner, 0.3).translate((0, 0, 0.05))
    solid += cylinder(0.18, 0.12).translate((0.4, 0.25, 0.02))
    return solid - cylinder(0.3, 0.05).translate((0.4, 0.25, -0.1))


def elbow() -> Manifold:
    """A bent pipe with two counterbored flanges: mostly smooth."""
    flanges = cylinder(0.08, 0.22).rotate((90, 0, 0)).translate((0.4, 0.06, 0))
    flanges += cylinder(0.08, 0.22).rotate((0, 90, 0)).translate((-0.04, 0.4, 0))
    outside, inside = (
        Manifold.revolve(
            CrossSection([np.add(arc(radius, 0, 360, SEGMENTS + 1)[:-1], (0.4, 0))]), SEGMENTS, 90
        )
        for radius in (0.12, 0.08)
    )
    bores = cylinder(0.4, 0.1).rotate((90, 0, 0)).translate((0.4, 0.03, 0))
    bores += cylinder(0.4, 0.1).rotate((0, 90, 0)).translate((-0.37, 0.4, 0))
    return outside + flanges - inside - bores


def plate() -> Manifold:
    """Rows of square and round holes, with many collinear edges."""
    solid = box((0, 1), (0, 0.7), (0, 0.06))
    for i in range(6):
        for j in range(4):
            hole = cylinder(1, 0.04) if (i + j) % 2 else box((-0.04, 0.04), (-0.04, 0.04), (0, 1))
            solid -= hole.translate((0.12 + 0.152 * i, 0.12 + 0.152 * j, -0.4))
    return solid + box((0, 1), (0, 0.05), (0, 0.25))


def impeller() -> Manifold:
    """Seven curved blades on a disc and a cone."""
    along = np.linspace(0, 1, 40)
    middle = polar(0.9 * along, 0.08 + 0.38 * along)
    half = 0.012 * polar(0.9 * along + 0.6 + np.pi / 2, 1.0)
    blade = prism(np.concatenate([middle - half, (middle + half)[::-1]]), 0.22)
    solid = cylinder(0.06, 0.5) + coarse_cylinder(0.35, 0.12, SEGMENTS, 0.07)
    for k in range(7):
        solid += blade.rotate((0, 0, k * 360 / 7)).translate((0, 0, 0.03))
    return solid - cylinder(2, 0.035).translate((0, 0, -0.5))


def wedge() -> Manifold:
    """Slanted faces, a spherical hollow and a slot."""
    corners = [(0, 0, 0), (0.9, 0, 0), (0.8, 0.6, 0), (0.1, 0.7, 0), (0.3, 0.2, 0.6)]
    hollow = ball(0.22, 97, SEGMENTS).translate((0.5, 0.2, 0.5))
    solid = Manifold.hull_points(np.array([*corners, (0.6, 0.3, 0.5)]))
    return solid - hollow - box((0.1, 0.2), (-1, 1), (0.05, 0.12))


def knob() -> Manifold:
    """A turned knob with grooves and a hexagonal socket."""
    profile = [(0, 0), (0.3, 0), (0.3, 0.08), (0.22, 0.12), (0.22, 0.5), (0.26, 0.55)]
    solid = lathe([*profile, (0.26, 0.68), (0.2, 0.74), (0, 0.74)], SEGMENTS)
    for x, y in polar(np.arange(12) * np.pi / 6, 0.27):
        solid -= cylinder(0.5, 0.035).translate((x, y, 0.5))
    return solid - coarse_cylinder(0.3, 0.1, 6).translate((0, 0, 0.6))


OBJECTS = {
    make.__name__: make
    for make in (bracket, gear, shaft, tray, elbow, plate, impeller, wedge, knob)
}
