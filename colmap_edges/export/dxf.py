"""Export of curves as DXF: LINE, ARC, CIRCLE, ELLIPSE and SPLINE entities, a layer per kind.

`frame.dxf` is a drawing without entities, of one layer per kind, as the library ezdxf writes it
(R2000, the oldest version with ellipses and splines; no units; fixed dates and identifiers, so
that equal curves give equal files). The entities are written here: as objects of a library they
took most of the time of all exports.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.arrays import FloatArray
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

LAYERS = {kind: name.upper() for kind, name in enumerate(KINDS)}
FIRST_HANDLE = 0x38  # the frame's own are smaller
NEAR_AXIS = 1 / 64  # of DXF's rule for the axes of a plane
Tags = list[tuple[int, Any]]  # codes and values


@checked
def write_dxf(curves: Curves3D, path: Path, *, overwrite: bool = True) -> None:
    """Write a DXF (R2000) with one entity per curve, and one layer per kind, named in capitals.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    frame = files("colmap_edges.export").joinpath("frame.dxf").read_text("utf-8")
    entities = "".join(
        f"{code:3d}\n{value}\n" for tags in entity_tags(curves) for code, value in tags
    )
    last = f"{FIRST_HANDLE + curves.num_curves:X}"
    text = frame.replace("{next_handle}", last).replace("{entities}", entities)
    write_whole(path, text.encode(), "curves", overwrite=overwrite)


def entity_tags(curves: Curves3D) -> Iterator[Tags]:
    """The tags of the entity of each curve."""
    normals, axes = curves.normals, axes_of_planes(curves.normals)
    for curve, kind in enumerate(curves.kinds.tolist()):
        handle, layer = f"{FIRST_HANDLE + curve:X}", LAYERS[kind]
        if kind == LINE:
            name, tags = "LINE", line_tags(curves.frames[curve])
        elif kind == SPLINE:
            name, tags = "SPLINE", spline_tags(curves, curve)
        elif kind in (ARC, CIRCLE):
            name = "ARC" if kind == ARC else "CIRCLE"
            tags = round_tags(curves, curve, axes[curve])
        else:
            name, tags = "ELLIPSE", ellipse_tags(curves, curve, normals[curve])
        # the owner is the frame's model space
        yield [(0, name), (5, handle), (330, 17), (100, "AcDbEntity"), (8, layer), *tags]


def point_tags(code: int, point: FloatArray) -> Tags:
    """The coordinates of a point; their codes are 10 apart."""
    return list(zip(range(code, code + 30, 10), point.tolist(), strict=True))


def line_tags(frame: FloatArray) -> Tags:
    """A line from its start to its end."""
    return [(100, "AcDbLine"), *point_tags(10, frame[0]), *point_tags(11, frame[0] + frame[1])]


def spline_tags(curves: Curves3D, curve: int) -> Tags:
    """A spline without weights."""
    knots = curves.knots[curves.knot_offsets[curve] : curves.knot_offsets[curve + 1]]
    control_points = curves.control_points[curves.control_rows(curve)]
    counts = [(70, 0), (71, DEGREE), (72, len(knots)), (73, len(control_points)), (74, 0)]
    places = [tag for point in control_points for tag in point_tags(10, point)]
    return [(100, "AcDbSpline"), *counts, *((40, knot) for knot in knots.tolist()), *places]


def round_tags(curves: Curves3D, curve: int, axes: FloatArray) -> Tags:
    """A circle or an arc, with centre and angles in the coordinates of its plane."""
    origin, a, b = curves.frames[curve]
    tags = [
        (100, "AcDbCircle"),
        *point_tags(10, turned(axes, origin)),
        (40, float(np.linalg.norm(a))),
    ]
    tags += point_tags(210, axes[2])
    if curves.kinds[curve] == CIRCLE:
        return tags
    ways = [turned(axes, np.cos(t) * a + np.sin(t) * b) for t in curves.spans[curve]]
    start, end = (float(np.degrees(np.arctan2(way[1], way[0]))) for way in ways)
    return [*tags, (100, "AcDbArc"), (50, start), (51, end)]


def ellipse_tags(curves: Curves3D, curve: int, normal: FloatArray) -> Tags:
    """An ellipse or an arc of one."""
    origin, a, b = curves.frames[curve]
    ratio = min(float(np.linalg.norm(b) / np.linalg.norm(a)), 1.0)
    whole = curves.kinds[curve] == ELLIPSE
    start, end = (0.0, 2 * np.pi) if whole else curves.spans[curve].tolist()
    tags = [(100, "AcDbEllipse"), *point_tags(10, origin), *point_tags(11, a)]
    return [*tags, *point_tags(210, normal), (40, ratio), (41, start), (42, end)]


def axes_of_planes(normals: FloatArray) -> FloatArray:
    """(C, 3, 3) rows: x, y and normal of a plane's coordinates (DXF: arbitrary axis algorithm)."""
    steep = np.abs(normals[:, :2]).max(axis=1, initial=0) < NEAR_AXIS
    x = np.cross(np.where(np.asarray(steep)[:, None], (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), normals)
    with np.errstate(invalid="ignore", divide="ignore"):
        x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(normals, x)
    return np.stack([x, y, normals], axis=1)


def turned(axes: FloatArray, point: FloatArray) -> FloatArray:
    """A point (3,) in the coordinates of these axes, with sums in a fixed order."""
    across = axes * point
    return across[:, 0] + across[:, 1] + across[:, 2]
