"""Points with the views that see them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    joined_offsets,
    offsets_of,
)
from colmap_edges.core.checks import check_arrays, check_offsets
from colmap_edges.core.observations import check_views

if TYPE_CHECKING:
    from colmap_edges.colmap.model import Model
    from colmap_edges.core.edges3d import Edges3D


# Minimum cosine between the normal of a smooth body and the ray of a view that sees it there: 73
# degrees; beyond, it would be an outline.
MIN_COSINE = 0.3


class SeenPoints(NamedTuple):
    """Points with the views that see them.

    Attributes:
        points: (P, 3) float64, world units.
        track_offsets: (P + 1,) int64; the views of point i are
            track_views[track_offsets[i]:track_offsets[i + 1]].
        track_views: (T,) int32 indices into the model's views.
    """

    points: Annotated[FloatArray, "P", 3]
    track_offsets: Annotated[IntArray, "P+1"]
    track_views: Annotated[Int32Array, "T"]

    @classmethod
    def of_model(cls, model: Model) -> SeenPoints:
        """The SfM points."""
        return cls(model.points3D_xyz, model.track_offsets, model.track_views)

    @classmethod
    def of_edges(cls, edges: Edges3D) -> SeenPoints:
        """The edge points."""
        return cls(edges.points, edges.observations.offsets, edges.observations.views)

    def check(self, name: str, num_views: int | None = None) -> None:
        """Check shapes, dtypes and values.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        check_offsets(f"{name}.track_offsets", self.track_offsets, len(self.track_views))
        check_views(f"{name}.track_views", self.track_views, num_views)

    def chosen(self, rows: IntArray) -> SeenPoints:
        """The points of these (K,) rows."""
        counts = np.diff(self.track_offsets)[rows]
        views = self.track_views[entries_of(self.track_offsets, rows)]
        return SeenPoints(self.points[rows], offsets_of(counts), views)


def joined_seen(parts: Sequence[SeenPoints]) -> SeenPoints:
    """The points of all parts, one after the other."""
    return SeenPoints(
        np.concatenate([part.points for part in parts]),
        joined_offsets([part.track_offsets for part in parts]),
        np.concatenate([part.track_views for part in parts]),
    )


NO_POINTS = SeenPoints(np.zeros((0, 3)), np.zeros(1, np.int64), np.zeros(0, np.int32))
