"""Points on smooth bodies without edges, where viewing rays touch the visual hull.

In front of a background every view sees the silhouette of a body. The viewing ray of a silhouette
pixel touches the body in the interval that projects to the foreground of all views. If the interval
is short, its midpoint is taken as a surface point ("viewing edges": Lazebnik, Furukawa and Ponce,
Projective Visual Hulls, IJCV 2007).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    evenly_chosen,
    offsets_of,
    order_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.seen_points import NO_POINTS, SeenPoints
from colmap_edges.core.view import View, cells_seen
from colmap_edges.errors import check_type
from colmap_edges.images.background import (
    BackgroundMask,
    BackgroundRays,
    background_rays,
    shows_holes,
)
from colmap_edges.images.files import square

logger = logging.getLogger(__name__)

# Maximum share of edge points that project onto the background: 0.03 to 0.3 % for true backdrops,
# 1.7 % and more for black frames around photographs and fisheye images.
MAX_CONTRADICTED = 0.01
# ... in a single view: 0 to 2.4 % for true backdrops, 3 to 69 % where a face of a body has the
# backdrop's colour.
MAX_CONTRADICTED_IN_VIEW = 0.03
NUM_SAMPLES = 4000  # number of edge points checked, and of viewing rays tried, over all views
NUM_VIEWS = 40  # number of views with silhouettes, which also test for foreground, spread around
NUM_STEPS = 256  # steps along a viewing ray, across the sphere around all edges
MAX_STRETCH = 0.25  # maximum length of the interval, relative to that sphere's diameter
NUM_SEEING = 8  # maximum number of views of a point, the most frontal ones
# minimum cosine of the angle between the surface normal and the direction to a view
MIN_COSINE = 0.5
NUM_SIGHT_STEPS = 40  # steps from the point to the view, all of which must be free
EDGE_PX = 10  # distance from a projected edge within which a silhouette belongs to the edge
DIRECTION_PX = 2.5  # standard deviation of the blur for the silhouette's direction


@dataclass(frozen=True)
class Background:
    """Free space and silhouette points, derived from the visible background.

    Attributes:
        rays: background rays, which pass through free space only.
        silhouettes: silhouette points of smooth bodies.
    """

    rays: BackgroundRays
    silhouettes: SeenPoints

    def check(self, name: str = "background", num_views: int | None = None) -> None:
        """Check shapes, dtypes and values, as all functions of the Python interface do.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_type(f"{name}.rays", self.rays, (BackgroundRays,))
        self.rays.check(f"{name}.rays", num_views)
        check_type(f"{name}.silhouettes", self.silhouettes, (SeenPoints,))
        self.silhouettes.check(f"{name}.silhouettes", num_views)


class Body(NamedTuple):
    """Foreground of a view as a mask (h, w), possibly at reduced resolution."""

    view: View
    mask: BoolArray

    def at(self, points: FloatArray) -> tuple[IntArray, BoolArray]:
        """(K,) indices of the (N, 3) points in the image, (K,) whether in the foreground."""
        seen, rows, columns = cells_seen(self.view, points, self.mask.shape)
        return seen, self.mask[rows, columns]

    def holds(self, points: FloatArray) -> BoolArray:
        """(N,) false for (N, 3) points that project to the background.

        True for points that project to the foreground or outside the image.
        """
        held = np.ones(len(points), bool)
        seen, is_body = self.at(points)
        held[seen] = is_body
        return held

    def dilated(self) -> Body:
        """The mask dilated by a pixel."""
        return Body(self.view, cv2.dilate(self.mask.astype(np.uint8), square(1)) > 0)

    def eroded(self) -> Body:
        """The mask eroded by a pixel."""
        return Body(self.view, cv2.erode(self.mask.astype(np.uint8), square(1)) > 0)


def find_background(
    model: Model, background_masks: Sequence[BackgroundMask], are_masks: bool, edges: Edges3D
) -> Background | None:
    """Find background rays and silhouette points; None if no reliable background is visible.

    Args:
        model: the V views, and the SfM points, used if there are no edges.
        background_masks: (V,) background of their images.
        are_masks: whether these are masks of the user, all of which are trusted.
        edges: the 3D edges; their silhouettes need no further points.
    """
    rays = background_rays(model.views, background_masks, are_masks)
    if rays is None:
        return None
    if not any(mask.body_pixels[0] for mask in background_masks):
        logger.warning(
            "masks_are_background is 1, but masks hide all of every image; the mesh is made "
            "without them; invert them if they are the other way round: black hides"
        )
        return None
    known = edges.points if edges.num_points else model.points3D_xyz
    if not are_masks and is_contradicted(model.views, background_masks, known):
        return None  # colours of backdrops are compared by direction then, see `find_sky`
    bodies = spread_bodies(model.views, background_masks, known)
    contradicted = contradicted_share(list(bodies.values()), known)
    if contradicted > MAX_CONTRADICTED:
        if not are_masks:
            return None  # probably a frame around the images
        logger.warning(
            "masks_are_background is 1, but masks hide %.1f %% of the 3D points that are in an "
            "image; it is meant for masks that hide nothing but the background",
            100 * contradicted,
        )
    # Bodies of the backdrop's brightness may seem truncated.
    if not shows_holes(background_masks):
        return Background(rays, NO_POINTS)
    if not edges.num_points:  # some SfM points lie on the background
        known = known[within(list(bodies.values()), known)]
    return Background(rays, silhouette_points(bodies, known) if len(known) else NO_POINTS)


def spread_bodies(
    views: Sequence[View], background_masks: Sequence[BackgroundMask], known: FloatArray
) -> dict[int, Body]:
    """Foregrounds of `NUM_VIEWS` views, spread around (N, 3) points, by index of the view."""
    seen = [i for i, background_mask in enumerate(background_masks) if background_mask.is_seen]
    center = known.mean(axis=0) if len(known) else np.zeros(3)
    away = np.array([views[i].center for i in seen]) - center
    chosen = np.sort(spread(away, NUM_VIEWS)).tolist()
    return {seen[k]: Body(views[seen[k]], background_masks[seen[k]].body()) for k in chosen}


def is_contradicted(
    views: Sequence[View], background_masks: Sequence[BackgroundMask], known: FloatArray
) -> bool:
    """Whether many of (N, 3) points lie on the background of a view.

    A face of a body, in the light or in the dark, has the backdrop's colour there.
    """
    return any(
        contradicted_share([Body(view, mask.body())], known) > MAX_CONTRADICTED_IN_VIEW
        for view, mask in zip(views, background_masks, strict=True)
        if mask.is_seen
    )


def contradicted_share(bodies: Sequence[Body], known: FloatArray) -> float:
    """Share of the projections of (N, 3) points of bodies that lie on the background."""
    points = known[:: max(1, len(known) // NUM_SAMPLES)]
    hidden = total = 0
    for body in bodies:
        _, is_body = body.dilated().at(points)
        hidden += int(np.sum(~is_body))
        total += len(is_body)
    return hidden / total if total else 0.0


def silhouette_points(bodies: Mapping[int, Body], known: FloatArray) -> SeenPoints:
    """Silhouette points away from edges.

    Args:
        bodies: foregrounds by index of the view.
        known: (N, 3) points of edges, or SfM points of bodies; not empty.
    """
    if len(bodies) < 2:
        return NO_POINTS
    low, high = known.min(axis=0), known.max(axis=0)
    center, radius = (low + high) / 2, 0.55 * float(np.linalg.norm(high - low))
    indices, seen = np.array(list(bodies), np.int32), list(bodies.values())
    centers = np.array([body.view.center for body in seen])
    around = [body.dilated() for body in seen]
    count = -(-NUM_SAMPLES // len(bodies))
    found = [touched(body, around, known, (center, radius), count) for body in seen]
    points = np.concatenate([points for points, _ in found])
    normals = np.concatenate([normals for _, normals in found])
    if len(points) == 0:
        return NO_POINTS
    rows, columns = seeing(points, normals, centers, [body.eroded() for body in seen], radius)
    order = order_of(rows, len(points))
    offsets = offsets_of(np.bincount(rows, minlength=len(points)))
    return SeenPoints(points, offsets, indices[columns[order]])


def spread(positions: FloatArray, count: int) -> IntArray:
    """Indices of `count` of (N, 3) positions, or all, by farthest-point sampling."""
    if len(positions) <= count:
        return np.arange(len(positions))
    directions = unit(positions)
    chosen = [0]
    nearest = directions @ directions[0]
    while len(chosen) < count:
        chosen.append(int(np.argmin(nearest)))
        nearest = np.maximum(nearest, directions @ directions[chosen[-1]])
    return np.array(chosen)


def touched(
    body: Body, around: list[Body], known: FloatArray, sphere: tuple[FloatArray, float], count: int
) -> tuple[FloatArray, FloatArray]:
    """Points where viewing rays through a silhouette touch the visual hull.

    Args:
        body: foreground of the view.
        around: foregrounds that bound the hull.
        known: (N, 3) points of edges, whose silhouettes are left out.
        sphere: centre and radius of a sphere that contains the hull.
        count: number of rays.

    Returns:
        (K, 3) points, (K, 3) unit normals, outwards.
    """
    (center, radius), view = sphere, body.view
    pixels, outward = contour(body, known, count)
    rays = view.rays(pixels)
    directions, normals = unit(rays), view.rays(pixels + outward) - rays
    normals = unit(normals - np.einsum("ij,ij->i", normals, directions)[:, None] * directions)
    depths = (directions @ (center - view.center))[:, None] + np.linspace(
        -radius, radius, NUM_STEPS
    )
    points = view.center + depths[:, :, None] * directions[:, None]
    inside = within(around, points.reshape(-1, 3)).reshape(depths.shape)
    first = inside.argmax(axis=1)
    last = NUM_STEPS - 1 - inside[:, ::-1].argmax(axis=1)
    length = last - first + 1
    is_one = inside.any(axis=1) & (inside.sum(axis=1) == length)
    bounded = (first > 0) & (last < NUM_STEPS - 1)
    kept = np.flatnonzero(is_one & bounded & (length <= MAX_STRETCH * NUM_STEPS))
    middle = (depths[kept, first[kept]] + depths[kept, last[kept]]) / 2
    return view.center + middle[:, None] * directions[kept], normals[kept]


def contour(body: Body, known: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """At most `count` silhouette pixels that are not near projected edges.

    Returns:
        (K, 2) image pixels, COLMAP's origin, and (K, 2) unit directions, outwards.
    """
    mask = body.mask.astype(np.uint8)
    edge = mask - cv2.erode(mask, square(1))
    scale = np.array([body.view.width, body.view.height]) / mask.shape[::-1]
    pixels, depths = body.view.project(known)
    columns, rows = (pixels[body.view.holds(pixels, depths)] / scale).astype(np.int64).T
    near = np.zeros_like(mask)
    near[rows, columns] = 1
    edge[cv2.dilate(near, square(EDGE_PX)) > 0] = 0
    rows, columns = np.nonzero(edge)
    chosen = evenly_chosen(len(rows), count)
    rows, columns = rows[chosen], columns[chosen]
    blurred = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), DIRECTION_PX)
    slope = [cv2.Sobel(blurred, cv2.CV_32F, *order) for order in ((1, 0), (0, 1))]
    outward = unit(-np.column_stack([each[rows, columns] for each in slope]).astype(np.float64))
    return (np.column_stack([columns, rows]) + 0.5) * scale, outward


def within(bodies: Sequence[Body], points: FloatArray) -> BoolArray:
    """(N,) whether (N, 3) points project to the background of no view."""
    left = np.arange(len(points))
    for body in bodies:
        left = left[body.holds(points[left])]
    inside = np.zeros(len(points), bool)
    inside[left] = True
    return inside


def seeing(
    points: FloatArray,
    normals: FloatArray,
    centers: FloatArray,
    bodies: Sequence[Body],
    radius: float,
) -> tuple[IntArray, IntArray]:
    """Views that see points of the visual hull from the front and unoccluded.

    Args:
        points: (P, 3).
        normals: (P, 3) unit normals, outwards.
        centers: (V, 3) camera centres.
        bodies: foregrounds that bound the hull.
        radius: radius of the sphere that contains it.

    Returns:
        Pairs of (T,) indices of points and (T,) indices of views.
    """
    away = unit(centers - points[:, None])
    cosines = np.einsum("pvi,pi->pv", away, normals)
    straightest = np.argsort(-cosines, axis=1, kind="stable")[:, :NUM_SEEING]
    rows, ranks = np.nonzero(np.take_along_axis(cosines, straightest, axis=1) >= MIN_COSINE)
    columns = straightest[rows, ranks]
    steps = radius * np.linspace(0.03, 1.5, NUM_SIGHT_STEPS)
    way = points[rows][:, None] + steps[:, None] * away[rows, columns][:, None]
    free = ~within(bodies, way.reshape(-1, 3)).reshape(-1, NUM_SIGHT_STEPS).any(axis=1)
    return rows[free], columns[free]
