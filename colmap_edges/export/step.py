"""Export of curves as a STEP (AP214) wireframe: lines, circles, ellipses, B-splines."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import ARC, CIRCLE, DEGREE, ELLIPSE, LINE, SPLINE, Curves3D
from colmap_edges.errors import ColmapEdgesError

PRODUCT = re.compile(r"PRODUCT\('[^']*',\s*'[^']*'")
SMALLEST = 1e-7  # minimum length of an edge in OpenCASCADE (Precision::Confusion)


@checked
def write_step(curves: Curves3D, path: Path) -> None:
    """Write a STEP file with one edge per curve, using OpenCASCADE.

    STEP files are in millimetres; one world unit becomes one millimetre. Lines of length zero,
    which OpenCASCADE does not support, are left out.

    Raises:
        ColmapEdgesError: if OpenCASCADE is not installed or writing fails.
    """
    try:
        from OCP import BRep, BRepBuilderAPI, IFSelect, Interface, STEPControl, TopoDS
    except ImportError as error:
        raise ColmapEdgesError(
            f"{path.name} needs a CAD kernel: pip install 'colmap-edges[step]'"
        ) from error
    be_silent()
    builder, compound = BRep.BRep_Builder(), TopoDS.TopoDS_Compound()
    builder.MakeCompound(compound)
    long = curves.lengths() > 10 * SMALLEST
    for curve in np.flatnonzero(long).tolist():
        made = BRepBuilderAPI.BRepBuilderAPI_MakeEdge(*geometry(curves, curve))
        if made.IsDone():
            builder.Add(compound, made.Edge())
    writer = STEPControl.STEPControl_Writer()
    Interface.Interface_Static.SetIVal_s("write.step.assembly", 0)  # a single part
    writer.Transfer(compound, STEPControl.STEPControl_StepModelType.STEPControl_AsIs)
    without_date(writer)
    if writer.Write(str(path)) != IFSelect.IFSelect_ReturnStatus.IFSelect_RetDone:
        raise ColmapEdgesError(
            f"cannot write {path} as STEP; check that its folder exists and is writable"
        )
    # OpenCASCADE appends a counter to the name.
    text = PRODUCT.sub("PRODUCT('edges','edges'", path.read_text(encoding="ascii"), count=1)
    path.write_text(text, encoding="ascii")


def be_silent() -> None:
    """Let OpenCASCADE print only failures."""
    from OCP.Message import Message, Message_Gravity

    for printer in Message.DefaultMessenger_s().Printers():
        printer.SetTraceLevel(Message_Gravity.Message_Fail)


def without_date(writer: Any) -> None:
    """Set a constant date and program name, so that equal curves give equal files."""
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.TCollection import TCollection_HAsciiString

    header = APIHeaderSection_MakeHeader(writer.Model())
    header.SetTimeStamp(TCollection_HAsciiString("2000-01-01T00:00:00"))
    header.SetName(TCollection_HAsciiString("3D edges by colmap-edges"))


def geometry(curves: Curves3D, curve: int) -> tuple[Any, ...]:
    """Arguments of OpenCASCADE's edge builder: a curve with its parameter range, or points."""
    from OCP import gp

    kind = int(curves.kinds[curve])
    origin, a, b = curves.frames[curve].tolist()
    if kind == LINE:
        return gp.gp_Pnt(*origin), gp.gp_Pnt(*(curves.frames[curve, 0] + a).tolist())
    if kind == SPLINE:
        return (spline_of(curves.spline(curve)),)
    larger, smaller = curves.radii[curve].tolist()
    axes = gp.gp_Ax2(gp.gp_Pnt(*origin), gp.gp_Dir(*np.cross(a, b).tolist()), gp.gp_Dir(*a))
    round_: Any = gp.gp_Circ(axes, larger)
    if kind not in (ARC, CIRCLE):
        round_ = gp.gp_Elips(axes, larger, min(smaller, larger))
    span = () if kind in (CIRCLE, ELLIPSE) else tuple(curves.spans[curve].tolist())
    return (round_, *span)


def spline_of(spline: Any) -> Any:
    """Convert scipy's B-spline to OpenCASCADE's."""
    from OCP import gp
    from OCP.collections import Array1_double, Array1_gp_Pnt, Array1_int
    from OCP.Geom import Geom_BSplineCurve

    knots, times = np.unique(spline.t, return_counts=True)
    points = filled(Array1_gp_Pnt, [gp.gp_Pnt(*point) for point in spline.c.tolist()])
    places, counts = filled(Array1_double, knots.tolist()), filled(Array1_int, times.tolist())
    return Geom_BSplineCurve(points, places, counts, DEGREE)


def filled(kind: Any, values: list[Any]) -> Any:
    """An OpenCASCADE array, whose indices start at 1."""
    array = kind(1, len(values))
    for place, value in enumerate(values):
        array.SetValue(place + 1, value)
    return array
