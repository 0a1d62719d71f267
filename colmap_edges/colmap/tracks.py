"""Observations of points by images, in CSR by point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from colmap_edges.colmap.binary_files import NO_POINT3D
from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, offsets_of
from colmap_edges.errors import ColmapEdgesError


def tracks_by_point(
    points2D: Sequence[NDArray[np.void]], point3D_ids: IntArray
) -> tuple[IntArray, Int32Array, FloatArray]:
    """Observations in CSR by point: offsets (N + 1,), views (T,), pixels (T, 2).

    Args:
        points2D: `POINT2D` records of each view.
        point3D_ids: (N,) ascending.

    Raises:
        ColmapEdgesError: if a view observes an unknown point.
    """
    # Column by column, as records are copied slowly.
    ids = np.concatenate([np.zeros(0, np.uint64), *(of["point3D_id"] for of in points2D)])
    pixels = np.concatenate([np.zeros((0, 2)), *(of["xy"] for of in points2D)])
    views = np.repeat(np.arange(len(points2D), dtype=np.int32), [len(of) for of in points2D])
    seen = ids != NO_POINT3D
    if not seen.all():
        ids, pixels, views = ids[seen], pixels[seen], views[seen]
    points = places_among(point3D_ids, ids.astype(np.int64))
    if (points < 0).any():
        raise ColmapEdgesError(
            f"the images of the model observe point3D {ids[points < 0][0]}, which it does "
            "not have; its images and points3D files do not belong together"
        )
    order = np.argsort(points, kind="stable")
    offsets = offsets_of(np.bincount(points, minlength=len(point3D_ids)))
    return offsets, views[order], pixels[order]


def places_among(ids: IntArray, wanted: IntArray) -> IntArray:
    """(n,) indices of the wanted ids among (N,) ascending ones; -1 for others."""
    if len(ids) and ids[0] >= 0 and ids[-1] < 4 * len(ids):  # a table is faster than a search
        table = np.full(ids[-1] + 2, -1)
        table[ids] = np.arange(len(ids))
        return np.asarray(table[np.where(wanted < 0, ids[-1] + 1, np.minimum(wanted, ids[-1] + 1))])
    places = np.searchsorted(ids, wanted)
    return np.where(np.append(ids, -1)[places] == wanted, places, -1)
