"""Straight 3D lines with their 2D segments, and their conversion to 3D edges."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError


@dataclass(frozen=True, kw_only=True)
class Line:
    """One straight 3D line.

    Attributes:
        segments: (S, 2, 3) its 3D segments, by their ends.
        image_ids: (O,) COLMAP ids of the images that see it.
        ends2D: (O, 2, 2) ends of the 2D segments seen there, pixels; NaN if the format holds
            none, in which case the whole line counts as seen.
        sigma: standard deviation across it, world units; NaN if unknown.
    """

    segments: FloatArray
    image_ids: IntArray
    ends2D: FloatArray = field(default_factory=lambda: np.empty((0, 2, 2)))
    sigma: float = np.nan


def sample_lines(lines: Iterable[Line], model: Model, spacing_px: float = 4.0) -> Edges3D:
    """Points along every 3D segment, observed where their projections are on the 2D segment.

    A view does not observe points more than two pixels beyond the ends of its 2D segment. Points
    observed by fewer than two views are dropped; each remaining unbroken run becomes an edge.
    """
    views = {view.image_id: index for index, view in enumerate(model.views)}
    edges: list[_Run] = []
    for line in lines:
        missing = set(line.image_ids.tolist()) - set(views)
        if missing:
            raise ColmapEdgesError(
                f"a line is observed in image {min(missing)}, which is not in the model"
            )
        indices = np.array([views[i] for i in line.image_ids.tolist()], dtype=np.int32)
        for ends in line.segments:
            edges += _sample_segment(ends, indices, line.ends2D, model.views, spacing_px)
    return _as_edges(edges)


@dataclass(frozen=True)
class _Run:
    points: FloatArray  # (N, 3)
    seen: BoolArray  # (N, V)
    views: Int32Array  # (V,)
    pixels: FloatArray  # (N, V, 2)


def _sample_segment(
    ends: FloatArray,
    indices: Int32Array,
    ends2D: FloatArray,
    views: Sequence[View],
    spacing_px: float,
) -> list[_Run]:
    if not len(indices):
        return []
    projected = np.array([views[index].project(ends)[0] for index in indices])
    lengths = np.linalg.norm(projected[:, 1] - projected[:, 0], axis=1)
    if not np.isfinite(lengths).any():
        return []
    count = int(np.ceil(np.nanmax(lengths) / spacing_px)) + 1
    points = ends[0] + np.linspace(0, 1, max(count, 2))[:, None] * (ends[1] - ends[0])
    unique, columns = np.unique(indices, return_inverse=True)
    pixels = np.stack([views[index].project(points)[0] for index in unique], axis=1)
    seen = np.zeros((len(points), len(unique)), dtype=bool)
    for column, end2D in zip(columns, ends2D, strict=True):
        seen[:, column] |= _on_segment(pixels[:, column], end2D)
    kept = seen.sum(axis=1) >= 2
    breaks = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    runs = [slice(a, b) for a, b in breaks.reshape(-1, 2) if b - a >= 2]
    return [_Run(points[run], seen[run], unique, pixels[run]) for run in runs]


def _on_segment(pixels: FloatArray, ends: FloatArray, margin_px: float = 2.0) -> BoolArray:
    known = np.asarray(np.isfinite(pixels).all(axis=1))
    length = np.linalg.norm(ends[1] - ends[0])
    if not np.isfinite(length) or length == 0:
        return known
    along = (pixels - ends[0]) @ (ends[1] - ends[0]) / length
    return np.asarray(known & (along >= -margin_px) & (along <= length + margin_px))


def _as_edges(runs: list[_Run]) -> Edges3D:
    if not runs:
        return Edges3D.none()
    views = [np.broadcast_to(run.views, run.seen.shape)[run.seen] for run in runs]
    observations = Observations.of_pixels(
        offsets=offsets_of(np.concatenate([run.seen.sum(axis=1) for run in runs])),
        views=np.concatenate(views),
        pixels=np.concatenate([run.pixels[run.seen] for run in runs]),
    )
    lengths = np.array([len(run.points) for run in runs], np.int64)
    return Edges3D.of_polylines(np.concatenate([r.points for r in runs]), lengths, observations)
