"""Export as STEP (AP214): lines, circles, ellipses and B-splines, and faces of revolution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
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
from colmap_edges.core.similarity import Similarity
from colmap_edges.errors import ColmapEdgesError, extra
from colmap_edges.export.units import metres
from colmap_edges.runtime.output import write_whole
from colmap_edges.runtime.ownership import PROGRAM
from colmap_edges.surfaces.round_face import RoundFace, moved_round

SMALLEST = 1e-7  # millimetres: OpenCASCADE takes closer points as one (Precision::Confusion)


@dataclass(frozen=True, kw_only=True)
class StepFile:
    """The contents of a written STEP file.

    Attributes:
        num_curves: number of curves in it.
        unit_mm: millimetres that stand for one world unit.
    """

    num_curves: int
    unit_mm: float


@checked
def write_step(
    curves: Curves3D,
    path: Path | str,
    *,
    round_faces: Sequence[RoundFace] = (),
    unit: str = "",
    overwrite: bool = True,
) -> StepFile:
    """Write a STEP file with one edge per curve, and faces of revolution, using OpenCASCADE.

    Each curve has the name of its edge, such as "edge 12", and is on the layer of its kind. Faces
    are cylindrical, conical, spherical or toroidal surfaces, or surfaces of revolution of a
    B-spline, with names such as "cylinder 1". STEP
    files are in millimetres, and programs take points closer than 1e-7 mm as one. Without a unit,
    one world unit becomes one millimetre; if that makes curves too short, a power of ten of
    millimetres. Curves without length, or of less than a ten-millionth of the longest, are left
    out.

    Args:
        curves: the curves.
        path: file to write.
        round_faces: faces of revolution.
        unit: unit of the coordinates, such as "m", or empty if unknown.
        overwrite: replace an existing file.

    Raises:
        ColmapEdgesError: if OpenCASCADE is not installed, the file cannot be written, or exists
            and `overwrite` is false.
    """
    check_kernel()
    from OCP import IFSelect, STEPControl
    from OCP.Interface import Interface_Static
    from OCP.STEPCAFControl import STEPCAFControl_Writer

    be_silent()
    unit_mm = 1000 * metres(unit) if unit else unit_of(curves.lengths())
    in_mm = Similarity(scale=unit_mm, rotation=np.eye(3), translation=np.zeros(3))
    moved = [moved_round(face, in_mm) for face in round_faces]
    document, count = document_of(in_mm.curves(curves), moved)
    writer = STEPCAFControl_Writer()
    Interface_Static.SetIVal_s("write.step.assembly", 0)  # a single part
    Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1)
    writer.Transfer(document, STEPControl.STEPControl_StepModelType.STEPControl_AsIs)
    without_date(writer.ChangeWriter())
    written = BytesIO()
    if writer.WriteStream(written) != IFSelect.IFSelect_ReturnStatus.IFSelect_RetDone:
        raise ColmapEdgesError(f"OpenCASCADE cannot write the curves as STEP; {path} is not made")
    write_whole(Path(path), written.getvalue(), "curves", overwrite=overwrite)
    return StepFile(num_curves=count, unit_mm=unit_mm)


def document_of(curves: Curves3D, round_faces: Sequence[RoundFace] = ()) -> tuple[Any, int]:
    """OpenCASCADE's document of curves and faces in millimetres, and the number of curves in it.

    They have names and layers.
    """
    from OCP import BRep, BRepBuilderAPI, TopoDS
    from OCP.TCollection import TCollection_ExtendedString as Text
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    builder, compound = BRep.BRep_Builder(), TopoDS.TopoDS_Compound()
    builder.MakeCompound(compound)
    made: list[tuple[str, str, Any]] = []
    for curve in np.flatnonzero(curves.lengths() > 10 * SMALLEST).tolist():
        edge = BRepBuilderAPI.BRepBuilderAPI_MakeEdge(*geometry(curves, curve))
        if edge.IsDone():
            kind = KINDS[curves.kinds[curve]]
            made.append((f"edge {curves.edges[curve]}", kind, edge.Edge()))
    count = len(made)
    for i, face in enumerate(round_faces):
        made.append((f"{face.kind} {i + 1}", face.kind, turned_face(face)))
    for *_, shape in made:
        builder.Add(compound, shape)
    document = TDocStd_Document(Text(PROGRAM))
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    layers = XCAFDoc_DocumentTool.LayerTool_s(document.Main())
    part = shapes.AddShape(compound, False)
    TDataStd_Name.Set_s(part, Text("edges"))
    for name, kind, shape in made:
        label = shapes.AddSubShape(part, shape)
        TDataStd_Name.Set_s(label, Text(name))
        layers.SetLayer(label, Text(kind.upper()))
    return document, count


def check_kernel() -> None:
    """Check that OpenCASCADE is installed.

    Raises:
        ColmapEdgesError: if it is not.
    """
    with extra("STEP", "step"):
        import OCP.STEPControl  # noqa: F401


def unit_of(lengths: FloatArray) -> float:
    """Millimetres per world unit: 1, or the power of ten that makes all curves long enough."""
    long = lengths[lengths > SMALLEST * lengths.max(initial=0)]
    shortest = 100 * SMALLEST  # of a curve in the file
    return float(10.0 ** np.ceil(np.log10(shortest / long.min(initial=shortest))))


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


def turned_face(face: RoundFace) -> Any:
    """OpenCASCADE's face of a profile turned around its axis."""
    from OCP import gp
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
    from OCP.collections import Array1_gp_Pnt
    from OCP.GC import GC_MakeArcOfCircle
    from OCP.GeomAPI import GeomAPI_PointsToBSpline

    aside = np.linalg.svd(face.direction[None])[2][1]
    points = face.point + face.profile @ np.array([face.direction, aside])
    corners = [gp.gp_Pnt(*point) for point in points.tolist()]
    if face.kind in ("sphere", "torus"):
        edge = BRepBuilderAPI_MakeEdge(GC_MakeArcOfCircle(*corners).Value())
    elif len(corners) == 2:
        edge = BRepBuilderAPI_MakeEdge(*corners)
    else:
        fitted = GeomAPI_PointsToBSpline(filled(Array1_gp_Pnt, corners))
        edge = BRepBuilderAPI_MakeEdge(fitted.Curve())
    axis = gp.gp_Ax1(gp.gp_Pnt(*face.point.tolist()), gp.gp_Dir(*face.direction.tolist()))
    return BRepPrimAPI_MakeRevol(edge.Edge(), axis).Shape()


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
