"""Points on outlines of smooth bodies, with the views that see them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.checks import check_arrays
from colmap_edges.core.seen_points import SeenPoints


@dataclass(frozen=True, kw_only=True)
class Outlines:
    """Points at which viewing rays touch smooth bodies, with the views that see them frontally.

    Attributes:
        points: (N, 3) float64 world points.
        normals: (N, 3) float64 unit normals of the surface, out of the body.
        sigmas: (N,) float64 standard deviations across the surface, world units.
        colors: (N, 3) uint8 RGB.
        track_offsets: (N + 1,) int64; the views that see point i are
            track_views[track_offsets[i]:track_offsets[i + 1]].
        track_views: (T,) int32 indices into the model's views.
    """

    points: Annotated[FloatArray, "N", 3]
    normals: Annotated[FloatArray, "N", 3]
    sigmas: Annotated[FloatArray, "N"]
    colors: Annotated[ByteArray, "N", 3]
    track_offsets: Annotated[IntArray, "N+1"]
    track_views: Annotated[Int32Array, "T"]

    @property
    def seen(self) -> SeenPoints:
        """The points with the views that see them."""
        return SeenPoints(self.points, self.track_offsets, self.track_views)

    def check(self, name: str, num_views: int | None = None) -> None:
        """Check shapes, dtypes and values.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        self.seen.check(name, num_views)


NO_OUTLINES = Outlines(
    points=np.zeros((0, 3)),
    normals=np.zeros((0, 3)),
    sigmas=np.zeros(0),
    colors=np.zeros((0, 3), np.uint8),
    track_offsets=np.zeros(1, np.int64),
    track_views=np.zeros(0, np.int32),
)
