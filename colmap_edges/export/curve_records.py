"""Conversion of curves to records of edges.json, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, offsets_of
from colmap_edges.core.curves3d import DEGREE, KINDS, LINE, SPLINE, Curves3D

Record = dict[str, Any]


def curve_records(curves: Curves3D, edge_offsets: IntArray) -> list[Record]:
    """One mapping per curve: edge, range of points, kind, parameters and standard deviations.

    Args:
        curves: the curves.
        edge_offsets: (E + 1,) offsets of the points of their edges.
    """
    records = []
    normals, radii = curves.normals, curves.radii
    for curve in range(curves.num_curves):
        first, end = (curves.ranges[curve] - edge_offsets[curves.edges[curve]]).tolist()
        kind = int(curves.kinds[curve])
        record: Record = {"edge": int(curves.edges[curve]), "points": [first, end]}
        record["kind"] = KINDS[kind]
        if curves.arc_groups[curve] != curve:
            record["part_of"] = int(curves.arc_groups[curve])
        if kind == LINE:
            record |= line_record(curves, curve)
        elif kind == SPLINE:
            record |= spline_record(curves, curve)
        else:
            record |= round_record(curves, curve, normals[curve], radii[curve])
        records.append(record)
    return records


def line_record(curves: Curves3D, curve: int) -> Record:
    """Parameters of a line."""
    start, way, _ = curves.frames[curve]
    return {
        "start": start.tolist(),
        "end": (start + way).tolist(),
        "sigma_start": number(curves.position_sigmas[curve, 0]),
        "sigma_end": number(curves.position_sigmas[curve, 1]),
        "sigma_direction_deg": number(np.degrees(curves.direction_sigmas[curve])),
    }


def round_record(curves: Curves3D, curve: int, normal: FloatArray, radii: FloatArray) -> Record:
    """Parameters of a circle, an ellipse or an arc of one."""
    return {
        "center": curves.frames[curve, 0].tolist(),
        "normal": normal.tolist(),
        "major": (curves.frames[curve, 1] / radii[0]).tolist(),
        "radii": radii.tolist(),
        "angles_deg": np.degrees(curves.spans[curve]).tolist(),
        "sigma_center": number(curves.position_sigmas[curve, 0]),
        "sigma_plane": number(curves.position_sigmas[curve, 1]),
        "sigma_normal_deg": number(np.degrees(curves.direction_sigmas[curve])),
        "sigma_radii": [number(sigma) for sigma in curves.radius_sigmas[curve]],
    }


def spline_record(curves: Curves3D, curve: int) -> Record:
    """Parameters of a spline."""
    knots = curves.knots[curves.knot_offsets[curve] : curves.knot_offsets[curve + 1]]
    rows = curves.control_rows(curve)
    return {
        "degree": DEGREE,
        "knots": knots.tolist(),
        "control_points": curves.control_points[rows].tolist(),
        "sigma_control_points": [number(sigma) for sigma in curves.control_sigmas[rows]],
    }


def number(value: float) -> float | None:
    """`value` to six digits; None if it is not finite."""
    return float(f"{value:.6g}") if np.isfinite(value) else None


def curves_of_records(records: Sequence[Record], edge_offsets: IntArray) -> Curves3D:
    """The curves of records; the inverse of `curve_records`.

    Raises:
        KeyError, IndexError, TypeError, ValueError: if a record is invalid.
    """
    curves = Curves3D.concatenated([curve_of(record, edge_offsets) for record in records])
    arc_groups = [int(record.get("part_of", curve)) for curve, record in enumerate(records)]
    if arc_groups and not 0 <= min(arc_groups) <= max(arc_groups) < len(arc_groups):
        raise ValueError("a curve is part of a curve that does not exist")
    return replace(curves, arc_groups=np.array(arc_groups, np.int64))


def curve_of(record: Record, edge_offsets: IntArray) -> Curves3D:
    """The curve of a record."""
    kind, edge = KINDS.index(record["kind"]), int(record["edge"])
    points = np.array(record["points"], np.int64).reshape(1, 2)
    knots = np.array(record.get("knots", []), np.float64)
    control = np.array(record.get("control_points", []), np.float64).reshape(-1, 3)
    if kind == SPLINE and len(knots) != len(control) + DEGREE + 1:
        raise ValueError("a spline has four knots more than control points")
    if not 0 <= edge < len(edge_offsets) - 1:
        raise ValueError(f"a curve belongs to edge {edge}, which does not exist")
    frame, span, positions, direction, radii = placed(record, kind, knots)
    return Curves3D(
        kinds=np.array([kind], np.uint8),
        edges=np.array([edge]),
        ranges=points + edge_offsets[edge],
        arc_groups=np.zeros(1, np.int64),
        frames=frame[None],
        spans=np.array([span], np.float64),
        knot_offsets=offsets_of(np.array([len(knots)])),
        knots=knots,
        control_points=control,
        position_sigmas=values(positions)[None],
        direction_sigmas=np.radians(values([direction])),
        radius_sigmas=values(radii)[None],
        control_sigmas=values(record.get("sigma_control_points", [])),
    )


def placed(record: Record, kind: int, knots: FloatArray) -> tuple[Any, Any, Any, Any, Any]:
    """Frame, span and deviations of position, direction in degrees, and radii, of a record."""
    nothing = (None, None)
    if kind == SPLINE:
        return np.zeros((3, 3)), knots[[0, -1]], nothing, None, nothing
    if kind == LINE:
        start, end = np.array(record["start"], float), np.array(record["end"], float)
        frame = np.stack([start, end - start, np.zeros(3)])
        sigmas = record.get("sigma_start"), record.get("sigma_end")
        return frame, (0.0, 1.0), sigmas, record.get("sigma_direction_deg"), nothing
    center, normal, major = (np.array(record[k], float) for k in ("center", "normal", "major"))
    larger, smaller = record["radii"]
    frame = np.stack([center, larger * major, smaller * np.cross(normal, major)])
    sigmas = record.get("sigma_center"), record.get("sigma_plane")
    span = np.radians(np.array(record["angles_deg"], float))
    radii = record.get("sigma_radii", nothing)
    return frame, span, sigmas, record.get("sigma_normal_deg"), radii


def values(numbers: Sequence[float | None]) -> FloatArray:
    """Numbers of JSON as an array, NaN for null."""
    return np.array([np.nan if number is None else number for number in numbers], np.float64)
