"""What views tell of round bodies: whether they show one, which rays meet it, who sees points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_closing
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    owners_of,
)
from colmap_edges.core.polylines import lengths_of, unit
from colmap_edges.core.seen_points import MIN_COSINE, SeenPoints
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.round_face import RoundFace

MIN_BOTH = 6  # minimum number of views that show both outlines
# Maximum of the least cosine between directions from the axis to such views: from one direction, a
# post looks like a cylinder.
MAX_COSINE = 0.5
BOTH_SHARE = 0.4  # minimum share of such views, of those that contain the body
MIN_STEPS = 48  # minimum number of points around the full circle
SPACING_PX = 8.0  # maximum distance of points
END_PX = 1.0  # distance of points from the ends, where outlines bend into rims
NUM_SEEING = 6  # maximum number of views of a point, the most frontal ones
DEVIATIONS = 4.0  # minimum distance of a point from the surface, in its standard deviations
DEPTH_SHARE = 0.02  # ... and in its depth
# Maximum share of rays through a body, of those that touch it or end on it or behind its surface:
# outlines give false points behind it.
MAX_THROUGH = 0.2
MAX_PASSED = 0.25  # maximum share of a body's points next to which rays pass through it
MIN_STEEP = 0.3  # minimum cosine between such a ray and the normal

# Of hypotheses of cylinders and of other bodies of revolution.
MIN_WIDTH_PX = 12.0  # minimum distance of the two outlines of a pair
MIN_ASPECT = 0.25  # minimum length, relative to the distance of outlines or the radius
MIN_ANGLE = np.sin(np.radians(8.0))  # minimum sine between the planes of pairs of two views
SAME_SHARE = 0.3  # maximum share of outlines that are those of a better body
TRIED_SHARE = 0.7  # maximum share of outlines with which other bodies were tried
COVERED_SHARE = 0.4  # minimum number of outlines at a place, relative to the largest number
MAX_GAP = 0.6  # maximum gap between outlines along the axis, in radii


class FoundRound(NamedTuple):
    """The faces of a scene's round bodies that a search found.

    Attributes:
        faces: the faces.
        points: points on them, with views that see them.
        num_tried: number of hypotheses.
        num_fitted: number of those that were fitted to outlines.
    """

    faces: list[RoundFace]
    points: SeenPoints
    num_tried: int
    num_fitted: int


class Sight(NamedTuple):
    """Rays to observed points that meet a body.

    Attributes:
        places: (n,) where they meet it, along the axis, in the unit of the body's description.
        through: (n,) whether the point lies behind the surface there.
        before: (n,) whether it lies before it.
        entries: (m, 3) where the rays of points behind it meet it.
        directions: (m, 3) unit directions of these rays.
    """

    places: FloatArray
    through: BoolArray
    before: BoolArray
    entries: FloatArray
    directions: FloatArray

    def are_steep(self, normals: FloatArray) -> BoolArray:
        """(m,) whether the rays do not graze the surface, with (m, 3) unit normals at entries."""
        cosines = -np.einsum("ij,ij->i", self.directions, normals)
        return np.asarray(cosines > MIN_STEEP)


class Rays(NamedTuple):
    """Rays from views to the points that they observe.

    Attributes:
        views: (N,) their views.
        starts: (N, 3) the views' centres.
        directions: (N, 3) unit directions.
        lengths: (N,) distances of the points.
        limits: (N,) distances from a point within which it lies on a surface.
    """

    views: Int32Array
    starts: FloatArray
    directions: FloatArray
    lengths: FloatArray
    limits: FloatArray

    @classmethod
    def of(cls, evidence: Evidence, views: Sequence[View]) -> Rays:
        """The rays of all observations."""
        owners, seeing = owners_of(evidence.offsets), evidence.views
        starts = np.array([view.center for view in views])[seeing]
        away = evidence.points[owners] - starts
        lengths = lengths_of(away)
        limits = np.maximum(DEVIATIONS * evidence.ray_sigmas[owners], DEPTH_SHARE * lengths)
        return cls(seeing, starts, unit(away), lengths, limits)

    def met(self, rows: IntArray, reach: FloatArray, places: FloatArray) -> Sight:
        """What (n,) rays say that enter a body after (n,) lengths at (n,) places of its axis."""
        behind, limits = self.lengths[rows] - reach, self.limits[rows]
        through = behind > limits
        directions = self.directions[rows[through]]
        entries = self.starts[rows[through]] + reach[through, None] * directions
        return Sight(places, through, behind < -limits, entries, directions)


def on_both_sides(shown: BoolArray) -> BoolArray:
    """(V,) whether views show outlines on both sides, of (V, 2, B) whether they do at a bin."""
    sides: BoolArray = np.asarray(shown.any(axis=2))
    return np.asarray(sides[:, 0] & sides[:, 1])


def is_believed(shown: BoolArray, axis: FloatArray, views: Sequence[View]) -> bool:
    """Whether views all around show both outlines of a body.

    Args:
        shown: (V, 2, B) whether a view shows the outline of a side at a bin.
        axis: (2, 3) ends of the stretch of the axis.
        views: the V views, of which most of those that contain it are to show its outlines.
    """
    along = axis[0] + np.linspace(0, 1, 9)[:, None] * (axis[1] - axis[0])
    inside = np.array([view.holds(*view.project(along)).mean() > 0.5 for view in views])
    showing = np.flatnonzero(on_both_sides(shown) & inside)
    if len(showing) < max(MIN_BOTH, BOTH_SHARE * inside.sum()):
        return False
    direction = unit(axis[1] - axis[0])
    away = np.array([views[v].center for v in showing.tolist()]) - axis[0]
    toward = unit(away - np.outer(away @ direction, direction))
    return bool(np.min(toward @ toward.T) <= MAX_COSINE)


def longest_run(mask: BoolArray, weights: IntArray) -> tuple[int, int]:
    """The run of true values with the largest sum of weights: its start and end."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    runs = borders.reshape(-1, 2)
    first, last = runs[int(np.argmax([weights[a:b].sum() for a, b in runs]))].tolist()
    return first, last


def closed_along(shown: BoolArray, gap: int) -> BoolArray:
    """(..., B) flags with gaps of up to `gap` bins closed."""
    ends = [*[(0, 0)] * (shown.ndim - 1), (gap, gap)]
    closed = binary_closing(np.pad(shown, ends), np.ones((1,) * (shown.ndim - 1) + (gap + 1,)))
    return np.asarray(closed[..., gap:-gap])


class Frontal(NamedTuple):
    """The most frontal views of points on a body.

    Attributes:
        order: (P, n) indices of views, the most frontal one first.
        kept: (P, n) whether such a view sees the point.
        toward: (P, V, 3) unit directions to all views.
    """

    order: IntArray
    kept: BoolArray
    toward: FloatArray


def frontal_views(
    points: FloatArray, normals: FloatArray, seen: BoolArray, centers: FloatArray
) -> Frontal:
    """The most frontal views of (P, 3) points, of those that see them.

    Args:
        points: (P, 3) points on the body.
        normals: (P, 3) their unit normals.
        seen: (P, V) whether a view sees the body where a point is.
        centers: (V, 3) the views' centres.
    """
    toward = unit(centers - points[:, None])
    cosines = np.einsum("pvj,pj->pv", toward, normals)
    visible = seen & (cosines > MIN_COSINE)
    order = np.argsort(-np.where(visible, cosines, -1), axis=1, kind="stable")[:, :NUM_SEEING]
    return Frontal(order, np.take_along_axis(visible, order, axis=1), toward)


def seen_on_body(
    points: FloatArray,
    normals: FloatArray,
    frontal: Frontal,
    views: IntArray,
    evidence: Evidence,
    sight: Sight,
    step: float,
) -> SeenPoints | None:
    """Points that views see, away from edges and from where rays pass through the body.

    Args:
        points: (P, 3) points on a body.
        normals: (P, 3) their unit normals.
        frontal: their views, as indices into `views`.
        views: (V,) numbers of the views.
        evidence: the edge points.
        sight: the rays that meet the body.
        step: within which a point is next to an edge or a ray, world units.

    Returns:
        The points; None if rays pass next to many: it is no body, but the tips of a gear's teeth.
    """
    edges = evidence.points[evidence.edge_ids >= 0]
    some = frontal.kept.any(axis=1) & ~are_near(points, edges, step)
    passed = some & are_passed(points, normals, sight, step)
    if passed.sum() > MAX_PASSED * some.sum():
        return None
    some &= ~passed
    kept = frontal.kept[some]
    chosen = views[frontal.order[some][kept]].astype(np.int32)
    return SeenPoints(points[some], offsets_of(kept.sum(axis=1)), chosen)


def are_passed(points: FloatArray, normals: FloatArray, sight: Sight, step: float) -> BoolArray:
    """(P,) whether a ray passes through the body next to points on it, but for grazing ones.

    False points of outlines are behind those, so that their rays graze the body.
    """
    nearest = cKDTree(points).query(sight.entries)[1]
    return are_near(points, sight.entries[sight.are_steep(normals[nearest])], step)


def are_near(points: FloatArray, others: FloatArray, reach: float) -> BoolArray:
    """(P,) whether one of (M, 3) other points lies within a distance of (P, 3) points."""
    if not len(others):
        return np.zeros(len(points), bool)
    return np.asarray(np.isfinite(cKDTree(others).query(points, distance_upper_bound=reach)[0]))
