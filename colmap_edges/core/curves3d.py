"""3D edges as parametric curves: lines, arcs, circles, ellipses and splines, with deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated

import numpy as np

from colmap_edges.core.arrays import (
    ByteArray,
    FloatArray,
    IntArray,
    offsets_of,
    owners_of,
    ranks_of,
)
from colmap_edges.core.checks import (
    MAX_INTEGER,
    check_arrays,
    check_number,
    check_offsets,
    check_points,
    check_shape,
    check_values,
    checked,
)
from colmap_edges.errors import ColmapEdgesError, check_type

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

    from colmap_edges.core.edges3d import Edges3D

KINDS = ("line", "arc", "circle", "elliptic_arc", "ellipse", "spline")
LINE, ARC, CIRCLE, ELLIPTIC_ARC, ELLIPSE, SPLINE = range(len(KINDS))
DEGREE = 3  # of splines


@dataclass(frozen=True, kw_only=True)
class Curves3D:
    """Parametric curves that 3D edges consist of, consecutive along each edge.

    A line is o + t a for t from 0 to 1. A circle, an ellipse or an arc of one is
    o + cos(t) a + sin(t) b, with a perpendicular to b and at least as long; their lengths are the
    radii. A spline is a cubic B-spline with clamped knots.

    Attributes:
        kinds: (C,) uint8 index into `KINDS`.
        edges: (C,) int64 edge of each curve.
        ranges: (C, 2) int64 half-open range of the curve's edge points in `Edges3D.points`; on
            closed edges, indices beyond the edge's last point wrap around to its first.
        arc_groups: (C,) int64 first of the curves that are parts of one curve: arcs of one circle
            with unobserved gaps between them; for all others, the curve itself.
        frames: (C, 3, 3) float64 rows o, a and b, world units; b is 0 of lines, all of splines.
        spans: (C, 2) float64 first and last t: radians of arcs.
        knot_offsets: (C + 1,) int64; curve c has knots[knot_offsets[c]:knot_offsets[c + 1]].
        knots: (K,) float64 knots of splines, from 0 to their length, world units.
        control_points: (M, 3) float64, four fewer than knots for each spline, in the same order.
        position_sigmas: (C, 2) float64 standard deviations, world units: across a line at its
            start and end; of a centre within its plane and across it; NaN for splines.
        direction_sigmas: (C,) float64 of a line's direction or of a plane's normal, radians.
        radius_sigmas: (C, 2) float64 of the radii, world units; NaN for lines and splines.
        control_sigmas: (M,) float64 of control points in each direction, world units.
    """

    kinds: Annotated[ByteArray, "C"]
    edges: Annotated[IntArray, "C"]
    ranges: Annotated[IntArray, "C", 2]
    arc_groups: Annotated[IntArray, "C"]
    frames: Annotated[FloatArray, "C", 3, 3]
    spans: Annotated[FloatArray, "C", 2]
    knot_offsets: Annotated[IntArray, "C+1"]
    knots: Annotated[FloatArray, "K"]
    control_points: Annotated[FloatArray, "M", 3]
    position_sigmas: Annotated[FloatArray, "C", 2]
    direction_sigmas: Annotated[FloatArray, "C"]
    radius_sigmas: Annotated[FloatArray, "C", 2]
    control_sigmas: Annotated[FloatArray, "M"]

    def __repr__(self) -> str:
        """The numbers of curves of each kind, in one line."""
        counts = np.bincount(self.kinds, minlength=len(KINDS)).tolist()
        kinds = [f"{count:,} {kind}" for kind, count in zip(KINDS, counts, strict=True) if count]
        return f"<Curves3D: {', '.join(kinds) or 'none'}>"

    def check(self, name: str = "curves", edges: Edges3D | None = None) -> None:
        """Check shapes, dtypes and values, as all functions of the Python interface do.

        Args:
            name: name of the curves in messages.
            edges: the edges that they belong to; any if None.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        num_edges = edges.num_edges if edges is not None else MAX_INTEGER
        num_points = edges.num_points if edges is not None else MAX_INTEGER
        check_values(f"{name}.kinds", self.kinds, 0, len(KINDS) - 1)
        check_values(f"{name}.edges", self.edges, 0, num_edges - 1)
        check_values(f"{name}.ranges", self.ranges[:, 0], 0, num_points - 1)
        check_values(f"{name}.ranges", np.diff(self.ranges)[:, 0], 1, num_points + 1)
        check_values(f"{name}.arc_groups", self.arc_groups, 0, self.num_curves - 1)
        for entry in ("frames", "spans", "knots", "control_points"):
            check_points(f"{name}.{entry}", getattr(self, entry))
        counts, splines = np.diff(self.knot_offsets), self.kinds == SPLINE
        least = np.where(splines, 2 * DEGREE + 2, 0)
        check_offsets(f"{name}.knot_offsets", self.knot_offsets, len(self.knots), least)
        num_control = int((counts - DEGREE - 1)[splines].sum())
        if counts[~splines].any() or num_control != len(self.control_points):
            raise ColmapEdgesError(
                f"{name}.knots must be four more than the control points of each spline, and none "
                "for other curves"
            )
        self.check_geometry(name)

    def check_geometry(self, name: str) -> None:
        """Check that knots rise, and that round curves span a plane.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        steps = self.knots[DEGREE + 1 :] - self.knots[: -DEGREE - 1]
        owners = owners_of(self.knot_offsets)
        within = owners[DEGREE + 1 :] == owners[: -DEGREE - 1]
        rising = np.diff(self.knots)[np.diff(owners) == 0] >= 0
        if not (rising.all() and (steps[within] > 0).all()):
            raise ColmapEdgesError(f"{name}.knots must rise along each spline; fit it again")
        flat = (
            (self.kinds != LINE) & (self.kinds != SPLINE) & ~np.isfinite(self.normals).all(axis=1)
        )
        if flat.any():
            raise ColmapEdgesError(
                f"{name}.frames[{np.flatnonzero(flat)[0]}] has parallel axes, but its curve is "
                "round; fit it again"
            )

    @classmethod
    def none(cls) -> Curves3D:
        """No curves."""
        return cls(
            kinds=np.zeros(0, np.uint8),
            edges=np.zeros(0, np.int64),
            ranges=np.zeros((0, 2), np.int64),
            arc_groups=np.zeros(0, np.int64),
            frames=np.zeros((0, 3, 3)),
            spans=np.zeros((0, 2)),
            knot_offsets=np.zeros(1, np.int64),
            knots=np.zeros(0),
            control_points=np.zeros((0, 3)),
            position_sigmas=np.zeros((0, 2)),
            direction_sigmas=np.zeros(0),
            radius_sigmas=np.zeros((0, 2)),
            control_sigmas=np.zeros(0),
        )

    @classmethod
    def concatenated(cls, parts: Sequence[Curves3D]) -> Curves3D:
        """The curves of all parts, one part after the other."""
        check_type("parts", parts, (Sequence,))
        for part in parts:
            check_type("a part", part, (cls,))
        parts = [cls.none(), *parts]
        arrays = {
            entry.name: np.concatenate([getattr(part, entry.name) for part in parts])
            for entry in fields(cls)
            if entry.name != "knot_offsets"
        }
        counts = [part.num_curves for part in parts]
        arrays["arc_groups"] += np.repeat(offsets_of(np.array(counts))[:-1], counts)
        lengths = np.concatenate([np.diff(part.knot_offsets) for part in parts])
        return cls(knot_offsets=offsets_of(lengths), **arrays)

    @property
    def num_curves(self) -> int:
        """Number of curves."""
        return len(self.kinds)

    @property
    def radii(self) -> FloatArray:
        """(C, 2) larger and smaller radius; NaN for lines and splines."""
        radii: FloatArray = np.linalg.norm(self.frames[:, 1:], axis=2)
        radii[(self.kinds == LINE) | (self.kinds == SPLINE)] = np.nan
        return radii

    @property
    def normals(self) -> FloatArray:
        """(C, 3) unit normals of the planes of circles, ellipses and their arcs; else NaN."""
        normals = np.cross(self.frames[:, 1], self.frames[:, 2])
        with np.errstate(invalid="ignore", divide="ignore"):
            units: FloatArray = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return units

    def spline(self, curve: int) -> BSpline:
        """A spline curve as scipy's BSpline.

        Raises:
            ColmapEdgesError: if there is no such curve, or it is no spline.
        """
        check_number("curve", curve, 0)
        if curve >= self.num_curves or self.kinds[curve] != SPLINE:
            raise ColmapEdgesError(f"curve is {curve}; there is no spline of this number")
        from scipy.interpolate import BSpline

        first, last = self.knot_offsets[curve : curve + 2]
        control = self.control_points[self.control_rows(curve)]
        return BSpline(self.knots[first:last], control, DEGREE)

    @checked
    def control_rows(self, curve: int) -> slice:
        """The rows of `control_points` of a curve; empty unless it is a spline.

        Raises:
            ColmapEdgesError: if there is no such curve.
        """
        check_values("curve", np.array(curve), 0, self.num_curves - 1)
        before = (DEGREE + 1) * np.count_nonzero(np.diff(self.knot_offsets[: curve + 1]))
        first, last = self.knot_offsets[curve : curve + 2]
        count = max(0, last - first - DEGREE - 1)
        return slice(int(first - before), int(first - before + count))

    @checked
    def at(self, owners: IntArray, places: FloatArray) -> FloatArray:
        """(N, 3) points of the (N,) curves at (N,) parameters from 0 (start) to 1 (end).

        Raises:
            ColmapEdgesError: if there is no curve of an index, or arrays differ in length.
        """
        check_shape("places", places.shape, owners.shape, {})
        check_shape("owners", owners.shape, ("N",), {})
        check_values("owners", owners, 0, self.num_curves - 1)
        t = self.spans[owners, 0] + places * np.diff(self.spans[owners], axis=1)[:, 0]
        origin, a, b = np.moveaxis(self.frames[owners], 1, 0)
        straight = self.kinds[owners] == LINE
        along = np.where(straight, t, np.cos(t))[:, None]
        points: FloatArray = origin + along * a + np.sin(t)[:, None] * b
        for curve in np.flatnonzero(self.kinds == SPLINE).tolist():
            rows = owners == curve
            knots = self.knots[slice(*self.knot_offsets[curve : curve + 2])]
            points[rows] = spline_points(
                knots, self.control_points[self.control_rows(curve)], t[rows]
            )
        return points

    def ends(self) -> FloatArray:
        """(C, 2, 3) start and end points."""
        every = np.arange(self.num_curves)
        sides = (np.zeros(len(every)), np.ones(len(every)))
        return np.stack([self.at(every, side) for side in sides], axis=1)

    def lengths(self) -> FloatArray:
        """(C,) lengths, world units."""
        steps = np.diff(self.sampled_evenly(64)[0].reshape(-1, 65, 3), axis=1)
        return np.asarray(np.linalg.norm(steps, axis=2).sum(axis=1))

    def sampled_evenly(self, steps: int) -> tuple[FloatArray, IntArray]:
        """(C * (steps + 1), 3) points at even parameters of each curve, and their curves."""
        counts = np.full(self.num_curves, steps + 1)
        owners = np.repeat(np.arange(self.num_curves), counts)
        return self.at(owners, ranks_of(counts) / steps), owners

    def sampled(self, spacing: float) -> tuple[FloatArray, IntArray]:
        """(N, 3) points of all curves about `spacing` apart, and (N,) the curve of each.

        Raises:
            ColmapEdgesError: if the spacing is not positive.
        """
        check_number("spacing", spacing, np.finfo(float).tiny, integer=False)
        steps = self.lengths() / spacing
        if steps.sum() > MAX_INTEGER:
            raise ColmapEdgesError(
                f"spacing is {spacing:g}, which makes {steps.sum():.3g} points; give a larger one"
            )
        counts = 2 + np.ceil(steps).astype(np.int64)
        owners = np.repeat(np.arange(self.num_curves), counts)
        places = ranks_of(counts) / np.maximum(counts[owners] - 1, 1)
        return self.at(owners, places), owners


def spline_points(knots: FloatArray, control: FloatArray, t: FloatArray) -> FloatArray:
    """(N, 3) points of a clamped cubic B-spline at (N,) parameters (de Boor's algorithm).

    Importing scipy's splines would take longer than all else that is done with a scene's curves.
    """
    spans = np.clip(np.searchsorted(knots, t, "right") - 1, DEGREE, len(control) - 1)[:, None]
    points = control[spans + np.arange(-DEGREE, 1)]
    for level in range(1, DEGREE + 1):
        ranks = np.arange(level, DEGREE + 1)
        low, high = knots[spans + ranks - DEGREE], knots[spans + ranks + 1 - level]
        share = ((t[:, None] - low) / (high - low))[:, :, None]
        points = (1 - share) * points[:, :-1] + share * points[:, 1:]
    return np.asarray(points[:, 0], np.float64)
