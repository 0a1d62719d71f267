"""What views tell of round bodies: whether they show one, which rays meet it, who sees points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    Int32Array,
    IntArray,
    owners_of,
)
from colmap_edges.core.polylines import lengths_of, unit
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.core.view import View
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.round_face import RoundFace

MIN_BOTH = 6  # minimum number of views that show both outlines
# Maximum of the least cosine between directions from the axis to such views: from one direction, a
# post looks like a cylinder.
MAX_COSINE = 0.5
BOTH_SHARE = 0.4  # minimum share of such views, of those that contain the body
MAX_THROUGH = 0.1  # maximum share of rays through the body, of those that do not end before it
MIN_STEPS = 48  # minimum number of points around the full circle
SPACING_PX = 6.5  # maximum distance of points
MIN_COSINE = 0.3  # minimum cosine between a ray to a view and the normal
NUM_SEEING = 6  # maximum number of views of a point, the most frontal ones
DEVIATIONS = 4.0  # minimum distance of a point from the surface, in its standard deviations
DEPTH_SHARE = 0.02  # ... and in its depth

# Of hypotheses of cylinders and of other bodies of revolution.
MAX_BASES = 12  # number of views whose outlines are paired, evenly chosen
NUM_PARTNERS = 4  # number of other such views with which each is combined
MIN_WIDTH_PX = 12.0  # minimum distance of the two outlines of a pair
MIN_ANGLE = np.sin(np.radians(8.0))  # minimum sine between the planes of pairs of two views
SAME_SHARE = 0.3  # maximum share of outlines that are those of a better body
TRIED_SHARE = 0.7  # maximum share of outlines with which other bodies were tried
COVERED_SHARE = 0.4  # minimum number of outlines at a place, relative to the largest number
MAX_GAP = 0.6  # maximum gap between outlines along the axis, in radii


def evenly(count: int, most: int) -> IntArray:
    """At most so many of a number of indices, evenly chosen."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))


def pairs_of_views(centers: FloatArray) -> Iterator[tuple[int, IntArray]]:
    """Some of the views with (V, 3) centres, and others with which to combine each."""
    bases = evenly(len(centers), MAX_BASES)
    for rank, base in enumerate(bases.tolist()):
        later = bases[rank + 1 :]
        later = later[np.argsort(np.linalg.norm(centers[later] - centers[base], axis=1))]
        yield base, later[evenly(len(later), NUM_PARTNERS)]


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
        views: (n,) their views.
        places: (n,) where they meet it, along the axis, in the unit of the body's description.
        through: (n,) whether the point lies behind the surface there.
        before: (n,) whether it lies before it.
    """

    views: Int32Array
    places: FloatArray
    through: BoolArray
    before: BoolArray


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
        return Sight(self.views[rows], places, behind > limits, behind < -limits)
