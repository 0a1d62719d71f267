"""Rejection of observations of occluded points.

Where edges are dense, an occluded point also projects near some chain, which is mistaken for an
observation. Such points lie behind the edges and SfM points that the view sees around them.
"""

from __future__ import annotations

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.executors import in_threads

# maximum tangent of the angle between the surface through neighbours and the image plane
MAX_SLOPE = 3.0
FARTHEST_PX = 1e6  # distance from the principal point beyond which projections are ignored


def find_hidden(
    model: Model,
    points: FloatArray,
    sigmas: FloatArray,
    curves: IntArray,
    track_points: IntArray,
    track_views: Int32Array,
    radius_px: float,
    num_threads: int,
) -> BoolArray:
    """(T,) whether each observation is of an occluded point.

    Args:
        model: the views and the SfM points; SfM and edge points occlude edge points.
        points: (N, 3) world points on edges.
        sigmas: (N,) standard deviations of their depths, world units.
        curves: (N,) curve of each point; a curve does not occlude itself.
        track_points: (T,) point of each observation.
        track_views: (T,) view of each observation.
        radius_px: image radius around a point within which other points are counted.
        num_threads: threads to use; the result does not depend on it.
    """
    hidden = np.zeros(len(track_points), bool)
    own_rows = rows_by_view(track_views, len(model.views))
    sfm_rows = rows_by_view(model.track_views, len(model.views))

    def find_in(index: int) -> None:
        own, sfm = own_rows[index], sfm_rows[index]
        seen = track_points[own]
        around = model.points3D_xyz[model.track_points[sfm]]
        nearer, agreeing = count_around(
            model.views[index],
            np.concatenate([points[seen], around]),
            np.concatenate([sigmas[seen], np.zeros(len(around))]),
            np.concatenate([curves[seen], np.full(len(around), -1)]),
            radius_px,
        )
        # Of the neighbours at the same depth.
        hidden[own] = (nearer > 0.5 * agreeing)[: len(own)]

    in_threads(find_in, [v for v, own in enumerate(own_rows) if len(own)], num_threads)
    return hidden


def count_around(
    view: View,
    points: FloatArray,
    sigmas: FloatArray,
    curves: IntArray,
    radius_px: float,
) -> tuple[IntArray, IntArray]:
    """Count, for each of (N, 3) points, its neighbours in an image that are nearer or equally far.

    Points behind the camera or in its plane are ignored. Points of no curve (-1) count as
    neighbours, but have no counts of their own, since there may be millions of them.
    """
    undistorted, depths = view.project_undistorted(points)
    x, y = np.abs(undistorted.T)  # one by one: reductions of two elements are slow
    with np.errstate(invalid="ignore"):
        ahead = np.flatnonzero((depths > 0) & (x < FARTHEST_PX) & (y < FARTHEST_PX))
    counts = _kernels.count_around(
        undistorted[ahead],
        depths[ahead],
        # An occluder is nearer by 0.2 % of the depth, and by three standard deviations.
        0.002 / 2 * depths[ahead] + 3.0 * sigmas[ahead],
        curves[ahead],
        max(radius_px, 0.01),  # neighbours may coincide in the image
        MAX_SLOPE / view.focal_px,
        num_threads=1,
    )
    nearer, agreeing = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    nearer[ahead], agreeing[ahead] = counts
    return nearer, agreeing
