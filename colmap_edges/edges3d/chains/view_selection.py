"""Selection of the views that are matched with each view, and depth ranges (paper: PEPC views)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.polylines import lengths_of
from colmap_edges.core.view import in_images
from colmap_edges.options import ViewSelectionOptions

# margin of a view's range of inverse depths, on both sides, relative to the range
RANGE_MARGIN = 0.25
# Plain walls behind all SfM points of a view are up to this many times as far as these.
BEYOND_POINTS = 3
NEAR_POINTS = 16  # mean number of SfM points that determine the depth range of a pixel
MIN_NEAR = 6  # minimum number of these; with fewer the range is that of the view
BORDER_CELLS = 2  # empty cells around the cells with points
MIN_POINTS = 20  # minimum number of SfM points of a view; with fewer its pose is used instead
MOST_SHARED = 8192  # maximum number of points of a view by which its neighbours are scored
MOST_BY_POSE = 256  # maximum number of views that a view is compared with by poses


@dataclass(frozen=True, kw_only=True)
class DepthRange:
    """Range of inverse depths (1 / world units) of a view, overall and near its SfM points.

    Attributes:
        of_points: smallest and largest inverse depth of its SfM points, with a margin; of its pose
            if these are too few.
        overall: the same, but as far as plain walls behind all points may be.
        pixels: (n, 2) float64 undistorted pixels of its SfM points; empty if these are too few.
        inverse_depths: (n,) float64 of these points.
    """

    of_points: tuple[float, float]
    overall: tuple[float, float]
    pixels: FloatArray
    inverse_depths: FloatArray

    @classmethod
    def without_points(cls, by_pose: tuple[float, float]) -> DepthRange:
        """The range of a view with too few SfM points, from that by its pose."""
        none = np.zeros(0)
        return cls(
            of_points=by_pose,
            overall=(by_pose[0] / BEYOND_POINTS, by_pose[1]),
            pixels=none.reshape(0, 2),
            inverse_depths=none,
        )

    def at(self, undistorted: FloatArray) -> FloatArray:
        """(N, 2) smallest and largest inverse depth at (N, 2) undistorted pixels.

        That of the SfM points in the pixel's square cell and the eight cells around it, with a
        margin for surfaces in front of or behind them. Where points are few, walls may be plain,
        and nothing is known of them: the range is the overall one.
        """
        low, high = self.overall
        ranges = np.tile(np.array(self.overall), (len(undistorted), 1))
        if not len(self.pixels):
            return ranges
        # Column by column: numpy reduces rows of two elements slowly.
        corner = np.array([column.min() for column in self.pixels.T])
        extent = np.maximum([np.ptp(column) for column in self.pixels.T], 1.0)
        size = float(np.sqrt(extent.prod() / len(self.pixels) * NEAR_POINTS / 9))
        # Points near the camera's plane may project anywhere: no more cells in a row than points.
        size = max(size, float(extent.max()) / len(self.pixels))
        columns, rows = (extent // size).astype(np.int64) + 1 + 2 * BORDER_CELLS

        def cells_of(pixels: FloatArray) -> IntArray:
            x, y = ((pixels - corner) // size + BORDER_CELLS).T
            cells = np.clip(y, 0, rows - 1) * columns + np.clip(x, 0, columns - 1)
            return np.asarray(cells, np.int64)

        own, cells = cells_of(self.pixels), cells_of(undistorted)
        counts = np.bincount(own, minlength=rows * columns).reshape(rows, columns)
        nearest, farthest = np.zeros(counts.shape), np.full(counts.shape, np.inf)
        np.maximum.at(nearest.reshape(-1), own, self.inverse_depths)
        np.minimum.at(farthest.reshape(-1), own, self.inverse_depths)
        margin = 0.15 * (self.of_points[1] - self.of_points[0])
        around = [
            ndimage.minimum_filter(farthest, 3).ravel()[cells] - margin,
            ndimage.maximum_filter(nearest, 3).ravel()[cells] + margin,
        ]
        known = ndimage.convolve(counts, np.ones((3, 3), counts.dtype)).ravel()[cells] >= MIN_NEAR
        ranges[known] = np.clip(np.column_stack(around)[known], low, high)
        return ranges


@dataclass(frozen=True, kw_only=True)
class Neighborhood:
    """The neighbours of every view and its range of inverse depths.

    Attributes:
        neighbors: per view its neighbours, indices into the model's views, best first.
        later_neighbors: these and further ones, for later rounds.
        observing_views: per view all views that may observe its edges, ascending.
        ranges: per view its inverse depths.
    """

    neighbors: tuple[IntArray, ...]
    later_neighbors: tuple[IntArray, ...]
    observing_views: tuple[IntArray, ...]
    ranges: tuple[DepthRange, ...]


def select_views(model: Model, options: ViewSelectionOptions) -> Neighborhood:
    """Choose the neighbours of each view by shared points and triangulation angle.

    Where a view shares points with fewer than `num_neighbors` others, poses choose further ones.
    """
    count = max(options.num_neighbors, options.num_later_neighbors)
    observed = observation_matrix(model)
    observers = observed.T.tocsr()
    ranges = inverse_depth_ranges(model, observed)
    nearest = nearest_by_pose(model, ranges)
    neighbors, observing_views = [], []
    for view in range(len(model.views)):
        near, wide = neighbor_scores(model, observed, observers, view, options)
        if np.count_nonzero(wide) < options.num_neighbors:
            by_pose = pose_scores(model, view, ranges[view], nearest(view), options)
            near, wide = (with_others(*of) for of in zip((near, wide), by_pose, strict=True))
        chosen = pick_diverse(model, view, near, count)
        lacking = count - len(chosen)
        if lacking:  # views at larger angles are better than none
            aside = wide.copy()
            aside[chosen] = 0
            chosen = np.concatenate([chosen, pick_diverse(model, view, aside, lacking)])
        neighbors.append(chosen)
        seeing = np.flatnonzero(wide > 0)
        order = np.argsort(-wide[seeing], kind="stable")[: options.num_observing_views]
        observing_views.append(np.sort(seeing[order]))
    return Neighborhood(
        neighbors=tuple(of[: options.num_neighbors] for of in neighbors),
        later_neighbors=tuple(neighbors),
        observing_views=tuple(observing_views),
        ranges=ranges,
    )


def observation_matrix(model: Model) -> csr_array:
    """(V, N) sparse bool: view v observes point n."""
    points = model.track_points
    shape = (len(model.views), len(model.point3D_ids))
    ones = np.ones(len(points), np.float64)
    matrix = csr_array((ones, (model.track_views, points)), shape=shape)
    matrix.data[:] = 1
    return matrix


def inverse_depth_ranges(model: Model, observed: csr_array) -> tuple[DepthRange, ...]:
    """Ranges of inverse depths of each view: of its SfM points with a margin, else by its pose."""
    ranges = []
    focus, distances = None, np.zeros(0)
    for index, view in enumerate(model.views):
        seen = observed.indices[observed.indptr[index] : observed.indptr[index + 1]]
        undistorted, depths = view.project_undistorted(model.points3D_xyz[seen])
        undistorted, inverse = undistorted[depths > 0], 1 / depths[depths > 0]
        if len(inverse) < MIN_POINTS:
            if focus is None:
                focus, distances = find_focus(model), nearest_distances(model.camera_centers)
            by_pose = pose_range(model, index, focus, distances[index])
            ranges.append(DepthRange.without_points(by_pose))
            continue
        low, high = np.percentile(inverse, [0.5, 99.5])
        margin = RANGE_MARGIN * (high - low) + 0.02 * low
        nearest, farthest = float(high + margin), float(max(low - margin, 0.1 * low))
        ranges.append(
            DepthRange(
                of_points=(farthest, nearest),
                overall=(min(farthest, float(low) / BEYOND_POINTS), nearest),
                pixels=undistorted,
                inverse_depths=inverse,
            )
        )
    return tuple(ranges)


def find_focus(model: Model) -> FloatArray:
    """(3,) the point nearest to all optical axes; NaN if these are nearly parallel."""
    axes = np.array([view.rotation[2] for view in model.views])
    projectors = np.eye(3)[None] - axes[:, :, None] * axes[:, None, :]
    normal = projectors.sum(axis=0)
    if np.linalg.cond(normal) >= 1e3:
        return np.full(3, np.nan)
    towards = np.einsum("vij,vj->i", projectors, model.camera_centers)
    return np.asarray(np.linalg.solve(normal, towards), np.float64)


def nearest_distances(centers: FloatArray) -> FloatArray:
    """(V,) distance of each centre to the nearest different one; infinite if there is none."""
    places, owners = np.unique(centers, axis=0, return_inverse=True)
    distances, _ = cKDTree(places).query(places, 2)
    nearest: FloatArray = distances[:, 1][owners.ravel()]
    return nearest


def pose_range(model: Model, index: int, focus: FloatArray, distance: float) -> tuple[float, float]:
    """Range of inverse depths of a view, from the poses of all views.

    If the view sees the point nearest to all optical axes, from a third to three times its depth;
    else from the `distance` to the nearest other camera to infinity.
    """
    if not np.isfinite(distance):
        return 0.0, 1.0
    depth = float(model.views[index].cam_from_world(focus[None])[0, 2])
    if depth > distance:
        return 1 / (3 * depth), 3 / depth
    return 0.0, 1 / float(distance)


def nearest_by_pose(model: Model, ranges: Sequence[DepthRange]) -> Callable[[int], IntArray]:
    """A function that gives the views nearest to one in position and viewing direction together."""
    depths = np.array([1 / np.mean(of.overall) for of in ranges])
    axes = np.array([view.rotation[2] for view in model.views])
    places = np.hstack([model.camera_centers, model.camera_centers + depths[:, None] * axes])
    tree, count = cKDTree(places), min(MOST_BY_POSE + 1, len(places))

    def nearest(view: int) -> IntArray:
        found = np.sort(np.atleast_1d(tree.query(places[view], count)[1]))
        return np.asarray(found[found != view], np.int64)

    return nearest


def neighbor_scores(
    model: Model,
    observed: csr_array,
    observers: csr_array,
    view: int,
    options: ViewSelectionOptions,
) -> FloatArray:
    """(2, V) scores of every other view as a neighbour and as an observing view.

    A score is the number of shared points, weighted by their triangulation angles; 0 for all views
    if the view has too few points.

    `observers` is `observed` transposed: it gives the views that share a point, so that views
    without shared points cost nothing.
    """
    seen = observed.indices[observed.indptr[view] : observed.indptr[view + 1]]
    if len(seen) < MIN_POINTS:
        return np.zeros((2, len(model.views)))
    seen = seen[:: -(-len(seen) // MOST_SHARED)]
    points = model.points3D_xyz[seen]
    shared = observers[seen]
    columns = np.repeat(np.arange(len(seen)), np.diff(shared.indptr))
    to_own = points - model.camera_centers[view]
    to_other = points[columns] - model.camera_centers[shared.indices]
    weights = angle_weights(to_own[columns], to_other, options)
    scores = [np.bincount(shared.indices, of, len(model.views)) for of in weights]
    result = np.array(scores, np.float64)
    result[:, view] = 0
    return result


def angle_weights(
    rays: FloatArray, other_rays: FloatArray, options: ViewSelectionOptions
) -> FloatArray:
    """(2, N) weight of the triangulation angle between two rays, 1 for wide enough angles.

    For neighbours and for observing views, which may have larger angles.
    """
    cosines = np.einsum("ij,ij->i", rays, other_rays) / (
        lengths_of(rays) * lengths_of(other_rays) + 1e-300
    )
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    narrow = np.minimum(angles / options.good_angle_deg, 1) ** 2
    most = np.array([[options.max_angle_deg], [options.max_observing_angle_deg]])
    weights: FloatArray = narrow * np.clip((most - angles) / options.good_angle_deg, 0, 1)
    return weights


def pose_scores(
    model: Model,
    view: int,
    depths: DepthRange,
    candidates: IntArray,
    options: ViewSelectionOptions,
) -> FloatArray:
    """(2, V) the same scores by poses: the share of this view's frustum that a candidate sees.

    The frustum is seen at several depths, as nothing tells at which one the surfaces are.
    """
    own = model.views[view]
    x, y = np.meshgrid(np.linspace(0.1, 0.9, 5) * own.width, np.linspace(0.1, 0.9, 5) * own.height)
    undistorted = own.undistorted_from_image(np.column_stack([x.ravel(), y.ravel()])) / own.focal_px
    local = np.column_stack([undistorted, np.ones(len(undistorted))])
    inverse_depths = np.linspace(*depths.of_points, 5)[1:-1, None, None]
    points = ((local / inverse_depths).reshape(-1, 3) - own.translation) @ own.rotation
    rays = np.tile(points - own.center, (len(candidates), 1))
    other_rays = points[None] - model.camera_centers[candidates, None]
    weights = angle_weights(rays, other_rays.reshape(-1, 3), options)
    weights = weights.reshape(2, -1, len(points))
    useful = weights.any(axis=(0, 2))
    inside = in_images([model.views[other] for other in candidates[useful].tolist()], points)
    scores = np.zeros((2, len(model.views)))
    scores[:, candidates[useful]] = (weights[:, useful] * inside).sum(axis=2)
    return scores


def with_others(scores: FloatArray, others: FloatArray) -> FloatArray:
    """(V,) scores by shared points, and below them all scores by poses of the other views."""
    least = scores[scores > 0].min(initial=np.inf)
    if not np.isfinite(least):
        return others
    return np.where(scores > 0, scores, others * least / max(others.max(), 1e-300))


def pick_diverse(model: Model, view: int, scores: FloatArray, count: int) -> IntArray:
    """Indices of up to `count` views with positive score, best first, baselines spread.

    A view whose baseline is parallel to one already chosen counts less, since edges parallel to
    one baseline need another.
    """
    candidates = np.flatnonzero(scores > 0)
    scores = scores[candidates]
    baselines = model.camera_centers[candidates] - model.camera_centers[view]
    norms = np.linalg.norm(baselines, axis=1, keepdims=True)
    directions = baselines / np.where(norms > 0, norms, 1)
    chosen: list[int] = []
    while len(chosen) < count and scores.max(initial=0) > 0:
        best = int(np.argmax(scores >= scores.max() * (1 - 1e-9)))  # first of equals up to rounding
        chosen.append(int(candidates[best]))
        scores[best] = 0
        parallel = np.abs(directions @ directions[best])
        scores *= 1 - 0.3 * parallel**8
    return np.array(chosen, np.int64)
