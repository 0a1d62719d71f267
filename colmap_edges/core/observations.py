"""Observations of 3D points on the chains of views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
    RaggedTable,
    joined_offsets,
    offsets_of,
)
from colmap_edges.core.checks import (
    MAX_INTEGER,
    check_arrays,
    check_offsets,
    check_points,
    check_values,
)
from colmap_edges.core.view import rows_by_view
from colmap_edges.errors import ColmapEdgesError

Kind = TypeVar("Kind", bound="ChainObservations")


@dataclass(frozen=True, kw_only=True)
class ChainObservations(RaggedTable):
    """Positions on chains at which points are observed, in CSR arrays by point.

    Tracing uses these; `edges2d.edge_index.look_up` converts them to `Observations` in the end.

    Attributes:
        offsets: (N + 1,) int64; observations of point i are rows offsets[i]:offsets[i + 1].
        views: (T,) int32 indices into the model's views; each view at most once per point.
        positions: (T,) float64 positions on the view's chains: index of a chain point in the
            view's edge graph, plus the fraction of the way to the next one; NaN if unknown.
    """

    offsets: Annotated[IntArray, "N+1"]
    views: Annotated[Int32Array, "T"]
    positions: Annotated[FloatArray, "T"]

    @classmethod
    def none(cls: type[Kind]) -> Kind:
        """No observations, of no points."""
        return cls(
            offsets=np.zeros(1, np.int64), views=np.zeros(0, np.int32), positions=np.zeros(0)
        )

    @classmethod
    def concatenated(cls: type[Kind], parts: Sequence[Kind]) -> Kind:
        """The concatenated observations of all parts."""
        parts = parts or [cls.none()]
        names = [entry.name for entry in fields(cls) if entry.name != "offsets"]
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(offsets=joined_offsets([part.offsets for part in parts]), **arrays)

    @property
    def counts(self) -> IntArray:
        """(N,) number of observations of each point."""
        return self.lengths

    @property
    def points(self) -> IntArray:
        """(T,) point of each observation."""
        return self.owners

    @classmethod
    def of_table(
        cls: type[Kind], views: IntArray, positions: FloatArray, **more: NDArray[Any]
    ) -> Kind:
        """Observations of N points from (N, K) positions in (K,) views, NaN for none, and more."""
        known = np.isfinite(positions)
        columns = np.nonzero(known)[1]
        return cls(
            offsets=offsets_of(known.sum(axis=1)),
            views=views[columns].astype(np.int32),
            positions=positions[known],
            **{name: values[known] for name, values in more.items()},
        )

    def keep(self: Kind, mask: BoolArray) -> Kind:
        """The observations where (T,) `mask` is true; all points stay."""
        left = offsets_of(mask.astype(np.int64))
        return self.cut(np.flatnonzero(mask), np.diff(left[self.offsets]))

    def by_view(self) -> Iterator[tuple[int, IntArray]]:
        """Observing views, ascending, each with the ascending rows of its observations."""
        parts = rows_by_view(self.views, int(self.views.max(initial=-1)) + 1)
        return ((view, rows) for view, rows in enumerate(parts) if len(rows))


@dataclass(frozen=True, kw_only=True)
class Observations(ChainObservations):
    """Observations of the points of 3D edges, in CSR arrays by point.

    Attributes:
        offsets, views, positions: those of `ChainObservations`.
        chains: (T,) int32 index of the polyline in the view's edge graph; -1 if unknown.
        pixels: (T, 2) float64 observed image pixels, COLMAP's origin.
        normals: (T, 2) float32 unit normals of the chain there, in undistorted pixels; NaN if
            unknown.

    While edges are linked, the last three hold no column, (T, 0), since they take most of the
    memory: `of_positions` makes such observations, and `edges2d.edge_index.look_up` fills them in.
    """

    chains: Annotated[Int32Array, "T"]
    pixels: Annotated[FloatArray, "T", 2]
    normals: Annotated[Float32Array, "T", 2]

    def check(self, name: str, num_views: int | None = None, **sizes: int) -> None:
        """Check shapes, dtypes and values.

        Args:
            name: name of the observations in messages.
            num_views: number of views of the model; any if None.
            sizes: `N`, the number of points, if known.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self, **sizes)
        check_offsets(f"{name}.offsets", self.offsets, len(self.views))
        check_views(f"{name}.views", self.views, num_views)
        check_points(f"{name}.pixels", self.pixels)

    @classmethod
    def none(cls) -> Observations:
        """No observations, of no points."""
        return cls.of_pixels(np.zeros(1, np.int64), np.zeros(0, np.int32), np.zeros((0, 2)))

    @classmethod
    def of_positions(cls, observed: ChainObservations) -> Observations:
        """Observations whose chains, pixels and normals are arrays without columns."""
        count = len(observed.views)
        return cls(
            offsets=observed.offsets,
            views=observed.views,
            positions=observed.positions,
            chains=np.zeros((count, 0), np.int32),
            pixels=np.zeros((count, 0)),
            normals=np.zeros((count, 0), np.float32),
        )

    @classmethod
    def of_pixels(cls, offsets: IntArray, views: Int32Array, pixels: FloatArray) -> Observations:
        """Observations with known pixels but unknown chains.

        Args:
            offsets: (N + 1,) CSR offsets of the observations by point.
            views: (T,) views of the observations.
            pixels: (T, 2) image pixels, COLMAP's origin.
        """
        return cls(
            offsets=offsets,
            views=views,
            positions=np.full(len(views), np.nan),
            chains=np.full(len(views), -1, np.int32),
            pixels=pixels,
            normals=np.full((len(views), 2), np.nan, np.float32),
        )


def check_views(name: str, views: Int32Array, num_views: int | None) -> None:
    """Check indices of views against the number of views of the model; any number if None.

    Raises:
        ColmapEdgesError: if a view does not exist.
    """
    if num_views is not None and len(views) and views.max() >= num_views:
        raise ColmapEdgesError(
            f"{name} holds view {views.max()}, but the model has {num_views} images with poses; "
            "give the model that they were found in"
        )
    check_values(name, views, 0, MAX_INTEGER)
