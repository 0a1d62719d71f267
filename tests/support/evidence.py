"""Evidence of points that are no edges, made by hand."""

import numpy as np

from colmap_edges.surfaces.faces.evidence import Evidence


def evidence_of(points, offsets, views, sigma):
    """(N, 3) points that are observed from above, by (T,) views between (N + 1,) offsets."""
    count = len(points)
    return Evidence(
        points=points,
        tangents=np.zeros((count, 3)),
        rays=np.tile([0.0, 0, 1], (count, 1)),
        sigmas=np.full(count, sigma),
        ray_sigmas=np.full(count, sigma),
        weights=np.ones(count),
        edge_ids=np.full(count, -1),
        offsets=offsets,
        views=views,
    )


def points_behind(views, middle):
    """Of each view points that lie half as far again as (n, 3) points of a body."""
    points = np.concatenate([middle + 0.5 * (middle - view.center) for view in views])
    seen_by = np.repeat(np.arange(len(views), dtype=np.int32), len(middle))
    return evidence_of(points, np.arange(len(points) + 1), seen_by, 1e-3)
