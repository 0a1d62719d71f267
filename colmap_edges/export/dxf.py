"""Export of curves as DXF: LINE, ARC, CIRCLE, ELLIPSE and SPLINE entities, a layer per kind."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.checks import checked
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
from colmap_edges.runtime.output import write_whole

VERSION = "R2000"  # the oldest with ellipses and splines
LAYERS = [kind.upper() for kind in KINDS]


@checked
def write_dxf(curves: Curves3D, path: Path, *, overwrite: bool = True) -> None:
    """Write a DXF (R2000) with one entity per curve, and one layer per kind, named in capitals.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    import ezdxf

    text = StringIO()
    with fixed_dates(ezdxf.options):
        drawing = ezdxf.new(VERSION, units=0)
        for kind, name in enumerate(LAYERS):
            drawing.layers.add(name, color=1 + kind)
        space = drawing.modelspace()
        for curve in range(curves.num_curves):
            add_entity(space, curves, curve)
        drawing.write(text)
    write_whole(path, text.getvalue().encode(), "curves", overwrite=overwrite)


@contextmanager
def fixed_dates(settings: Any) -> Iterator[None]:
    """Let ezdxf write constant dates and identifiers, so that equal curves give equal files."""
    before = settings.write_fixed_meta_data_for_testing
    settings.write_fixed_meta_data_for_testing = True
    try:
        yield
    finally:
        settings.write_fixed_meta_data_for_testing = before


def add_entity(space: Any, curves: Curves3D, curve: int) -> None:
    """Add the entity of a curve to a layout of ezdxf."""
    from ezdxf.math import OCS

    kind = int(curves.kinds[curve])
    attributes: dict[str, Any] = {"layer": LAYERS[kind]}
    origin, a, b = curves.frames[curve]
    if kind == LINE:
        space.add_line(origin.tolist(), (origin + a).tolist(), attributes)
        return
    if kind == SPLINE:
        spline = curves.spline(curve)
        space.add_open_spline(spline.c.tolist(), DEGREE, spline.t.tolist(), attributes)
        return
    attributes["extrusion"] = curves.normals[curve].tolist()
    if kind not in (ARC, CIRCLE):
        ratio = min(float(np.linalg.norm(b) / np.linalg.norm(a)), 1.0)
        span = (0.0, 2 * np.pi) if kind == ELLIPSE else curves.spans[curve].tolist()
        space.add_ellipse(origin.tolist(), a.tolist(), ratio, *span, attributes)
        return
    # Circles and arcs are in the coordinates of their plane.
    plane = OCS(attributes["extrusion"])
    center, radius = plane.from_wcs(origin.tolist()), float(np.linalg.norm(a))
    if kind == CIRCLE:
        space.add_circle(center, radius, attributes)
        return
    ways = [(np.cos(t) * a + np.sin(t) * b).tolist() for t in curves.spans[curve]]
    start, end = (plane.from_wcs(way).angle_deg for way in ways)
    space.add_arc(center, radius, start, end, True, attributes)
