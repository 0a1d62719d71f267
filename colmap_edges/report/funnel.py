"""The numbers left after each step of a run, from edge pixels to edge points and faces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from colmap_edges.options import PipelineOptions
from colmap_edges.report.diagnosis import Counts, counts_by_stage


@dataclass(frozen=True, kw_only=True)
class Step:
    """Number of items left after one step of a run.

    Attributes:
        name: name of the step's result.
        count: number of items left.
        unit: pixels, samples, points or edges.
        share: share of the previous step's count, if both have the same unit.
    """

    name: str
    count: int
    unit: str
    share: float | None = None


def funnel(stages: Sequence[Mapping[str, Any]], options: PipelineOptions) -> list[Step]:
    """The number left after each step of tracing, from edge pixels to edge points."""
    counts = counts_by_stage(stages)
    detect, trace = counts.get("detect", {}), counts.get("trace")
    if trace is None:
        return []
    steps = [Step(name="2D edge pixels", count=detect.get("edge_pixels", 0), unit=PIXELS)]
    for key, before, unit, name in CHAIN_FUNNEL if options.tracing.method == "chains" else ():
        if key in trace:
            part = trace[key] / trace[before] if before and trace.get(before) else None
            steps.append(Step(name=name, count=trace[key], unit=unit, share=part))
    steps += point_steps(trace)
    steps.append(Step(name="3D edges", count=trace.get("edges", 0), unit="edges"))
    return steps + face_steps(counts["faces"]) if "faces" in counts else steps


def point_steps(trace: Counts) -> Iterator[Step]:
    """The last steps of tracing, which keep of each edge one copy and separate contours."""
    points, before = trace.get("edge_points", 0), trace.get("points_of_curves", 0)
    if not before:
        yield Step(name="3D edge points", count=points, unit=POINTS)
        return
    left = before - trace.get("points_of_contours", 0)
    yield Step(name="not on view-dependent contours", count=left, unit=POINTS, share=left / before)
    name = "3D edge points, after copies from other views are merged"
    yield Step(name=name, count=points, unit=POINTS, share=points / max(left, 1))


def face_steps(faces: Counts) -> list[Step]:
    """The number left after each step of face detection, from image cells to faces."""
    cells, on_planes, believed = (faces[name] for name in FACE_CELLS)
    return [
        Step(name="cells", count=cells, unit=CELLS),
        Step(name="on a plane", count=on_planes, unit=CELLS, share=on_planes / max(cells, 1)),
        Step(
            name="confirmed by other views",
            count=believed,
            unit=CELLS,
            share=believed / max(on_planes, 1),
        ),
        Step(name="planar faces", count=faces["planar_faces"], unit="faces"),
    ]


CELLS, FACE_CELLS = "cells of the images", ("cells", "cells_on_planes", "cells_believed")
PIXELS, SAMPLES, POINTS = "pixels of the images", "samples along 2D edges", "points in 3D"
CHAIN_FUNNEL = (
    ("samples", "", SAMPLES, "placed on 2D edges"),
    ("samples_with_depth", "samples", SAMPLES, "with a depth that views agree on"),
    ("samples_confirmed", "samples_with_depth", SAMPLES, "confirmed by another view"),
    ("samples_in_runs", "samples_confirmed", SAMPLES, "in runs of confirmed depths"),
    ("points_traced", "", POINTS, "traced from each view"),
    ("points_observed_enough", "points_traced", POINTS, "observed in enough views"),
    ("points_of_curves", "points_observed_enough", POINTS, "kept by the a-contrario test"),
)
