"""The numbers of items left after each step of a run, from edge pixels to edges and faces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from colmap_edges.options import PipelineOptions
from colmap_edges.report.findings import Counts

PIXELS, SAMPLES, POINTS = "pixels of the images", "samples along 2D edges", "points in 3D"


class ChainStep(NamedTuple):
    """A step of tracing by depths along chains: names of counts, unit, and name of the result."""

    after: str
    before: str
    unit: str
    name: str


CHAIN_STEPS = (
    ChainStep("samples", "", SAMPLES, "placed on 2D edges"),
    ChainStep("samples_with_depth", "samples", SAMPLES, "with a depth that views agree on"),
    ChainStep("samples_confirmed", "samples_with_depth", SAMPLES, "confirmed by another view"),
    ChainStep("samples_in_runs", "samples_confirmed", SAMPLES, "in runs of confirmed depths"),
    ChainStep("points_traced", "", POINTS, "traced from each view"),
    ChainStep("points_observed_enough", "points_traced", POINTS, "observed in enough views"),
    ChainStep("points_of_curves", "points_observed_enough", POINTS, "kept by the a-contrario test"),
)


@dataclass(frozen=True)
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


def counts_by_stage(stages: Sequence[Mapping[str, Any]]) -> dict[str, Counts]:
    """The counts of each stage by its name, with the counts of details merged in."""
    found: dict[str, Counts] = {}
    for stage in stages:
        counts = stage["counts"]
        found[stage["name"]] = {**counts, **counts.get("details", {})}
    return found


def funnel(stages: Sequence[Mapping[str, Any]], options: PipelineOptions) -> list[Step]:
    """The number left after each step of tracing, from edge pixels to edge points."""
    counts = counts_by_stage(stages)
    detect, trace = counts.get("detect", {}), counts.get("trace")
    if trace is None:
        return []
    steps = [Step("2D edge pixels", detect.get("edge_pixels", 0), PIXELS)]
    for after, before, unit, name in CHAIN_STEPS if options.tracing.method == "chains" else ():
        if after in trace:
            part = trace[after] / trace[before] if before and trace.get(before) else None
            steps.append(Step(name, trace[after], unit, part))
    steps += point_steps(trace)
    steps.append(Step("3D edges", trace.get("edges", 0), "edges"))
    return steps + face_steps(counts["faces"]) if "faces" in counts else steps


def point_steps(trace: Counts) -> Iterator[Step]:
    """The last steps of tracing, which keep of each edge one copy and separate contours."""
    points, before = trace.get("edge_points", 0), trace.get("points_of_curves", 0)
    if not before:
        yield Step("3D edge points", points, POINTS)
        return
    left = before - trace.get("points_of_contours", 0)
    yield Step("not on view-dependent contours", left, POINTS, left / before)
    name = "3D edge points, after copies from other views are merged"
    yield Step(name, points, POINTS, points / max(left, 1))


def face_steps(faces: Counts) -> list[Step]:
    """The number left after each step of face detection, from image cells to faces."""
    unit, names = "cells of the images", ("cells", "cells_on_planes", "cells_believed")
    cells, on_planes, believed = (faces[name] for name in names)
    return [
        Step("cells", cells, unit),
        Step("on a plane", on_planes, unit, on_planes / max(cells, 1)),
        Step("confirmed by other views", believed, unit, believed / max(on_planes, 1)),
        Step("planar faces", faces["planar_faces"], "faces"),
    ]
