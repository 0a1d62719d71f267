"""Limit on the number of SfM points per view used for tracing."""

from __future__ import annotations

import numpy as np

from colmap_edges.colmap.model import Model

MAX_OBSERVED = 100_000  # SfM points per view; COLMAP extracts 8,192 features per image by default


def thinned(model: Model, random_seed: int, max_observed: int = MAX_OBSERVED) -> Model:
    """The model with a limited number of SfM observations per view.

    Dense models have millions of points, which do not improve view selection, depth ranges or
    occlusion tests. All views prefer the same random points, so that views still share points.

    Args:
        model: the model; returned unchanged if no view exceeds the limit.
        random_seed: seed of the random choice of points.
        max_observed: maximum number of observations per view.

    Returns:
        A model for tracing with the remaining points; its `reconstruction` is complete.
    """
    counts = np.bincount(model.track_views, minlength=len(model.views))
    if counts.max(initial=0) <= max_observed:
        return model
    ranks = np.random.default_rng(random_seed).permutation(len(model.point3D_ids))
    kept = np.ones(len(model.track_views), bool)
    for view in np.flatnonzero(counts > max_observed):
        rows = np.flatnonzero(model.track_views == view)
        of_rows = ranks[model.track_points[rows]]
        last = np.partition(of_rows, max_observed - 1)[max_observed - 1]
        kept[rows] = of_rows < last
        kept[rows[of_rows == last][: max_observed - int(kept[rows].sum())]] = True
    lengths = np.bincount(model.track_points[kept], minlength=len(model.point3D_ids))
    return model.selected(lengths > 0, kept)
