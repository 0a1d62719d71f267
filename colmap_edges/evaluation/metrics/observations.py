"""Selection of a model's points, and the rays of its pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, offsets_of


def select_points(model: Model, keep: BoolArray) -> Model:
    """The model with only the points where `keep` (N,) is true; `reconstruction` stays whole."""
    kept = np.repeat(keep, np.diff(model.track_offsets))
    counts = np.diff(model.track_offsets)[keep]
    return replace(
        model,
        points3D_xyz=model.points3D_xyz[keep],
        point3D_ids=model.point3D_ids[keep],
        points3D_rgb=model.points3D_rgb[keep],
        track_offsets=offsets_of(counts),
        track_views=model.track_views[kept],
        track_points2D=model.track_points2D[kept],
    )
