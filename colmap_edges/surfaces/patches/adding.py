"""Choice of the patches that a mesh lacks."""

from __future__ import annotations

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    order_of,
    owners_of,
)
from colmap_edges.core.view import views_with_rows
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.patches.finding import Patches

MAX_SIGMAS = 4.0  # distance of a patch from a mesh that explains it, in standard deviations
MIN_OFF = 2  # views in which a mesh is elsewhere


def what_they_add(
    patches: Patches, model: Model, vertices: FloatArray, faces: Int32Array, num_threads: int
) -> IntArray:
    """Indices of the patches that a mesh lacks: it is elsewhere in several of their views.

    Args:
        patches: the patches.
        model: the model of the views.
        vertices: (N, 3) of the mesh without patches.
        faces: (F, 3) of the same.
        num_threads: threads.
    """
    seen = patches.points
    if not len(seen.points):
        return np.zeros(0, np.int64)
    owners, views = owners_of(seen.track_offsets), seen.track_views
    order = order_of(views, len(model.views))
    rays, depths = np.zeros((len(views), 2)), np.zeros(len(views))
    for view, rows in views_with_rows(model.views, views):
        local = view.cam_from_world(seen.points[owners[rows]])
        rays[rows], depths[rows] = local[:, :2] / local[:, 2:], local[:, 2]
    inverse = np.zeros(len(views))
    found, _ = _kernels.mesh_depths(
        np.array([view.rotation for view in model.views]),
        np.array([view.translation for view in model.views]),
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int32),
        offsets_of(np.bincount(views, minlength=len(model.views))),
        rays[order],
        num_threads,
    )
    inverse[order] = found
    with np.errstate(divide="ignore"):
        off = np.abs(1 / inverse - depths) > MAX_SIGMAS * patches.tolerances[owners]
    away = np.bincount(owners, off, len(seen.points))
    return np.flatnonzero(away >= MIN_OFF)
