"""Depths along rays of views, as measured by the patches that views agree on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray
from colmap_edges.core.checks import check_arrays
from colmap_edges.core.observations import check_views
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.surfaces.faces.grids import Grid
from colmap_edges.surfaces.patches.smoothing import noise_factor


class Depths(NamedTuple):
    """Depths that views measured where images have texture.

    Attributes:
        views: (D,) int32 view of each depth, ascending.
        rays: (D, 2) float64 places in the view's image plane at depth 1.
        depths: (D,) float64 along the optical axis, world units.
        sigmas: (D,) float64 their standard deviations, as if they were independent.
    """

    views: Annotated[Int32Array, "D"]
    rays: Annotated[FloatArray, "D", 2]
    depths: Annotated[FloatArray, "D"]
    sigmas: Annotated[FloatArray, "D"]

    def check(self, name: str, num_views: int | None = None) -> None:
        """Check shapes, dtypes and values.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        check_views(f"{name}.views", self.views, num_views)
        if (np.diff(self.views) < 0).any():
            raise ColmapEdgesError(f"{name}.views do not ascend; sort all arrays by view")


NO_DEPTHS = Depths(np.zeros(0, np.int32), np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def depths_of(
    grids: Sequence[Grid], rows: Int32Array, values: FloatArray, num_agreeing: IntArray
) -> Depths:
    """The depths of accepted patches.

    Args:
        grids: pictures of the views.
        rows: (D, 5) of the kernel's agreed patches.
        values: (D, 7) of the same.
        num_agreeing: (D,) number of other views that agree. Each of them has such a mean of all as
            a patch of its own, so that the variance of each is that many times larger, and once.
    """
    if not len(rows):
        return NO_DEPTHS
    principals = np.array([grid.principal for grid in grids])[rows[:, 0]]
    focals = np.array([grid.focal_px for grid in grids])[rows[:, 0]]
    inverse = values[:, 2]
    sigmas = noise_factor(rows, values) * values[:, 5] * np.sqrt(1 + num_agreeing)
    return Depths(
        views=np.ascontiguousarray(rows[:, 0], np.int32),
        rays=(values[:, :2] + 0.5 - principals) / focals[:, None],
        depths=1 / inverse,
        sigmas=sigmas / inverse**2,
    )
