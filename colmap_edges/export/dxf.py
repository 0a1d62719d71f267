"""Export as DXF: curves as LINE, ARC, CIRCLE, ELLIPSE and SPLINE, or edges as 3D polylines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.arrays import FloatArray, parts_of
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
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.export.units import IMPERIAL, INSUNITS, metres
from colmap_edges.runtime.output import write_whole

PROGRAM = "COLMAP_EDGES"  # of the extended data
POLYLINES = "EDGES"  # layer of polylines
LAYERS = [kind.upper() for kind in KINDS]


@checked
def write_dxf(
    curves: Curves3D, path: Path | str, *, unit: str = "", overwrite: bool = True
) -> None:
    """Write a DXF (R2000) with one entity per curve, and one layer per kind, named in capitals.

    The extended data of an entity hold the number of its edge, under the name COLMAP_EDGES.

    Args:
        curves: the curves.
        path: file to write.
        unit: unit of the coordinates, such as "mm", or empty if unknown.
        overwrite: replace an existing file.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    points = curves.sampled_evenly(64)[0]
    with new_drawing(points, unit, LAYERS) as drawing:
        space = drawing.modelspace()
        for curve in range(curves.num_curves):
            add_entity(space, curves, curve)
            tag(space[-1], int(curves.edges[curve]))
        data = text_of(drawing)
    write_whole(Path(path), data, "curves", overwrite=overwrite)


@checked
def write_dxf_polylines(
    edges: Edges3D, path: Path | str, *, unit: str = "", overwrite: bool = True
) -> None:
    """Write a DXF (R2000) with one 3D polyline per edge, for programs without curves in space.

    Args:
        edges: the edges.
        path: file to write.
        unit: unit of the coordinates, such as "mm", or empty if unknown.
        overwrite: replace an existing file.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    with new_drawing(edges.points, unit, [POLYLINES]) as drawing:
        space = drawing.modelspace()
        for edge, points in enumerate(parts_of(edges.points, edges.edge_offsets)):
            closed = bool(edges.closed[edge])
            polyline = space.add_polyline3d(
                points.tolist(), close=closed, dxfattribs={"layer": POLYLINES}
            )
            tag(polyline, edge)
        data = text_of(drawing)
    write_whole(Path(path), data, "edges", overwrite=overwrite)


@contextmanager
def new_drawing(points: FloatArray, unit: str, layers: Sequence[str]) -> Iterator[Any]:
    """A drawing of ezdxf with a view of (N, 3) points from above."""
    import ezdxf

    metres(unit)
    with fixed_dates(ezdxf.options):
        # The oldest version with ellipses and splines.
        drawing = ezdxf.new("R2000", units=INSUNITS[unit])
        drawing.header["$MEASUREMENT"] = 0 if unit in IMPERIAL else 1
        drawing.appids.new(PROGRAM)
        for number, name in enumerate(layers):
            drawing.layers.add(name, color=1 + number)
        if len(points):
            low, high = points.min(axis=0), points.max(axis=0)
            drawing.header["$EXTMIN"], drawing.header["$EXTMAX"] = low.tolist(), high.tolist()
            space = drawing.modelspace()
            space.reset_extents(low.tolist(), high.tolist())
            middle, size = (low + high)[:2] / 2, high - low
            # The first view is a tenth higher than the scene, and 1.6 times as wide as high.
            height = 1.1 * max(float(size[1]), float(size[0]) / 1.6)
            drawing.set_modelspace_vport(height or 1.0, middle.tolist())
        yield drawing


def text_of(drawing: Any) -> bytes:
    """The bytes of the file of a drawing."""
    text = StringIO()
    drawing.write(text)
    return text.getvalue().encode()


def tag(entity: Any, edge: int) -> None:
    """Give an entity the number of its edge as extended data."""
    entity.set_xdata(PROGRAM, [(1000, f"edge {edge}"), (1071, edge)])


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
