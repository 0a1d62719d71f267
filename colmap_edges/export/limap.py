"""Export of curves as 3D lines in LIMAP 2.0's format, the folder `structures`."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import colmap_edges
from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import LINE, Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.runtime.output import new_folder, write_whole
from colmap_edges.runtime.ownership import PROGRAM, STRUCTURES

CHORD_DEG = 10.0  # turn of a curve per chord
NO_SCORE = 1.0  # LIMAP's score of 2D segments of detectors without scores


@dataclass(frozen=True, kw_only=True)
class Line3D:
    """One straight line with its 2D segments.

    Attributes:
        ends: (2, 3) its ends, world units.
        views: (O,) views that observe it.
        segments: (O, 2, 2) ends of the observed 2D segments, image pixels.
        sigma: standard deviation across it, world units.
    """

    ends: FloatArray
    views: IntArray
    segments: FloatArray
    sigma: float


@checked
def write_structures(
    edges: Edges3D, curves: Curves3D, model: Model, folder: Path, *, overwrite: bool = False
) -> int:
    """Write LIMAP 2.0's `structures`: lines with 2D segments; bent curves as chords.

    Lines observed by fewer than two views are left out. The folder appears complete, or not at all.
    A record in it names its files, so that only those are ever replaced.

    Args:
        edges: the edges.
        curves: the curves that they consist of.
        model: the model whose views observations refer to; LIMAP needs it next to the folder.
        folder: output folder, made here.
        overwrite: replace an earlier output of this function.

    Returns:
        The number of lines.

    Raises:
        ColmapEdgesError: if the folder cannot be made or must not be replaced.
    """
    edges.check("edges", len(model.views))
    curves.check("curves", edges)
    lines = [line for line in straight_lines(edges, curves) if len(line.views) > 1]
    images = model.reconstruction.images
    detections: list[list[tuple[FloatArray, int]]] = [[] for _ in model.views]
    content = [struct.pack("<Q", len(lines))]
    for index, line in enumerate(lines):
        content.append(struct.pack("<Q6dQ", index, *line.ends.ravel(), len(line.views)))
        for view, segment in zip(line.views.tolist(), line.segments, strict=True):
            content.append(struct.pack("<2I", model.views[view].image_id, len(detections[view])))
            detections[view].append((segment, index))
        content.append(struct.pack("<d", line.sigma if np.isfinite(line.sigma) else 0.0))
    files = {"lines3D.bin": b"".join(content)}
    content = [struct.pack("<Q", len(model.views))]
    for view, found in zip(model.views, detections, strict=True):
        num_points = images[view.image_id].num_points2D()
        content.append(struct.pack("<2IQ", view.image_id, num_points, len(found)))
        content += [struct.pack("<5dQ", *ends.ravel(), NO_SCORE, index) for ends, index in found]
        content.append(struct.pack("<2Q", 0, 0))  # no groups and no links
    files["structures2d.bin"] = b"".join(content)
    for name in ("groups3D.bin", "wireframe3D.bin"):  # required by LIMAP
        files[name] = struct.pack("<Q", 0)
    record: dict[str, Any] = {"versions": {PROGRAM: colmap_edges.__version__}}
    record["files"] = {name: len(data) for name, data in files.items()}
    files[STRUCTURES.record] = f"{json.dumps(record, indent=2)}\n".encode()
    with new_folder(folder, STRUCTURES, overwrite) as new:
        for name, data in files.items():
            write_whole(new / name, data, "lines")
    return len(lines)


def straight_lines(edges: Edges3D, curves: Curves3D) -> list[Line3D]:
    """Lines, and chords of all other curves."""
    found = []
    for curve in range(curves.num_curves):
        first, end = curves.ranges[curve].tolist()
        count = min(chords_of(curves, curve), max(1, (end - first) // 2))
        places = np.linspace(0, 1, count + 1)
        points = curves.at(np.full(count + 1, curve), places)
        start = int(edges.edge_offsets[curves.edges[curve]])
        size = int(edges.edge_offsets[curves.edges[curve] + 1]) - start
        rows = start + (np.arange(first, end) - start) % size
        parts = np.minimum((np.linspace(0, 1, len(rows)) * count).astype(np.int64), count - 1)
        for part in range(count):
            chosen = rows[parts == part]
            views, segments = observed_segments(edges, chosen)
            sigma = float(np.median(edges.sigmas[chosen])) if len(chosen) else np.nan
            ends = points[part : part + 2]
            found.append(Line3D(ends=ends, views=views, segments=segments, sigma=sigma))
    return found


def chords_of(curves: Curves3D, curve: int) -> int:
    """Number of chords of a curve: one per `CHORD_DEG` of its turn."""
    if curves.kinds[curve] == LINE:
        return 1
    points = curves.at(np.full(65, curve), np.linspace(0, 1, 65))
    steps = np.diff(points, axis=0)
    steps /= np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-300)
    cosines = np.clip(np.einsum("ij,ij->i", steps[1:], steps[:-1]), -1, 1)
    turn = np.degrees(np.arccos(cosines).sum())
    return max(1, int(np.ceil(turn / CHORD_DEG)))


def observed_segments(edges: Edges3D, rows: IntArray) -> tuple[IntArray, FloatArray]:
    """Views that observe at least two of (n,) edge points, with the first and last pixel."""
    observations = edges.observations.select(rows)
    views = observations.views
    order = np.argsort(views, kind="stable")
    present, firsts, counts = np.unique(views[order], return_index=True, return_counts=True)
    several = counts > 1
    first, last = order[firsts[several]], order[(firsts + counts - 1)[several]]
    segments = np.stack([observations.pixels[first], observations.pixels[last]], axis=1)
    return present[several].astype(np.int64), segments
