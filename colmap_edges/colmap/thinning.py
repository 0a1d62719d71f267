"""Limits the number of SfM points that tracing uses in each view."""

from __future__ import annotations

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.view import rows_by_view

MAX_OBSERVED = 100_000  # SfM points a view; COLMAP extracts 8,192 features of an image by default


def thinned(model: Model, random_seed: int, max_observed: int = MAX_OBSERVED) -> Model:
    """The model with at most so many observations of SfM points in each view.

    Dense models have millions, of which neighbours, depths and what hides edges are told no better.
    Views take the same random points as far as they observe them, so that they still share them.

    Args:
        model: the model; it is returned as it is where no view observes more.
        random_seed: decides which points are left out.
        max_observed: most points that one view observes.

    Returns:
        A model of the points that are still observed, for tracing only: `reconstruction` has all.
    """
    counts = np.bincount(model.track_views, minlength=len(model.views))
    if counts.max(initial=0) <= max_observed:
        return model
    ranks = np.random.default_rng(random_seed).permutation(len(model.point3D_ids))
    kept = np.zeros(len(model.track_views), bool)
    for rows in rows_by_view(model.track_views, len(model.views)):
        first = np.argsort(ranks[model.track_points[rows]], kind="stable")[:max_observed]
        kept[rows[first]] = True
    lengths = np.bincount(model.track_points[kept], minlength=len(model.point3D_ids))
    return model.selected(lengths > 0, kept)
