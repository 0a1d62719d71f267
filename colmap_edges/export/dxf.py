"""Export of curves as DXF: LINE, ARC, CIRCLE, ELLIPSE and SPLINE entities, a layer per kind."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.curves3d import (
    ARC,
    CIRCLE,
    DEGREE,
    ELLIPSE,
    KINDS,
    LINE,
    SPLINE,
    Curves3D,
)

LAYERS = {kind: name.upper() for kind, name in enumerate(KINDS)}
VERSION = "R2000"  # oldest version with ellipses and splines


def write_dxf(curves: Curves3D, path: Path) -> None:
    """Write a DXF (R2000) with one entity per curve, and one layer per kind, named in capitals."""
    import ezdxf

    with fixed_dates(ezdxf):
        drawing = ezdxf.new(VERSION, units=0)
        for kind, name in LAYERS.items():
            drawing.layers.add(name, color=1 + kind)
        space = drawing.modelspace()
        for curve in range(curves.num_curves):
            add_entity(space, curves, curve)
        text = io.StringIO()
        drawing.write(text)
    path.write_text(text.getvalue(), encoding="utf-8")


@contextmanager
def fixed_dates(ezdxf: Any) -> Iterator[None]:
    """Let ezdxf write constant dates and identifiers, so that equal curves give equal files."""
    before = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True
    try:
        yield
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = before


def add_entity(space: Any, curves: Curves3D, curve: int) -> None:
    """Add the entity of a curve to a layout of ezdxf."""
    kind = int(curves.kinds[curve])
    attributes: dict[str, Any] = {"layer": LAYERS[kind]}
    origin, a, b = curves.frames[curve]
    if kind == LINE:
        space.add_line(origin.tolist(), (origin + a).tolist(), dxfattribs=attributes)
        return
    if kind == SPLINE:
        spline = curves.spline(curve)
        space.add_open_spline(spline.c.tolist(), DEGREE, knots=spline.t, dxfattribs=attributes)
        return
    attributes["extrusion"] = tuple(curves.normals[curve].tolist())
    if kind in (ARC, CIRCLE):
        add_round(space, curves, curve, attributes)
        return
    ratio = float(np.linalg.norm(b) / np.linalg.norm(a))
    span = (0.0, 2 * np.pi) if kind == ELLIPSE else curves.spans[curve].tolist()
    space.add_ellipse(origin.tolist(), a.tolist(), min(ratio, 1.0), *span, dxfattribs=attributes)


def add_round(space: Any, curves: Curves3D, curve: int, attributes: dict[str, Any]) -> None:
    """Add a circle or an arc, with centre and angles in the coordinates of its plane."""
    from ezdxf.math import OCS

    origin, a, b = curves.frames[curve]
    plane = OCS(attributes["extrusion"])
    center, radius = plane.from_wcs(origin.tolist()), float(np.linalg.norm(a))
    if curves.kinds[curve] == CIRCLE:
        space.add_circle(center, radius, dxfattribs=attributes)
        return
    ways = [(np.cos(t) * a + np.sin(t) * b).tolist() for t in curves.spans[curve]]
    start, end = (plane.from_wcs(way).angle_deg for way in ways)
    space.add_arc(center, radius, start, end, dxfattribs=attributes)
