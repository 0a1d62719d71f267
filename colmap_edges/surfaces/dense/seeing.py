"""The views that see the points of a cloud: those of its files, or by a depth test."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from colmap_edges.colmap.clouds import BLOCK, SeenRows
from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    blocks,
    offsets_of,
    order_of,
    owners_of,
    row_numbers,
)
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.core.view import View, views_with_rows
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.files import square


def seen_by(
    points: FloatArray, seen: SeenRows | None, model: Model, image_names: Sequence[str]
) -> SeenPoints:
    """Points of a cloud with their views, each view once a point.

    Args:
        points: (N, 3) finite points.
        seen: the images that see each point; None to find the views by a depth test.
        model: the model; images that it lacks see nothing.
        image_names: names of the images that `seen` counts.

    Raises:
        ColmapEdgesError: if `seen` names other images, or points lie outside of them.
    """
    if seen is None:
        return by_depth_test(points, model)
    most = int(seen.images.max(initial=-1))
    if most >= len(image_names) or seen.images.min(initial=0) < 0:
        raise ColmapEdgesError(
            f"the visibility of the cloud names image {most}, but its model has "
            f"{len(image_names)} images with poses; give the model that the cloud was made from"
        )
    numbers = {view.name: index for index, view in enumerate(model.views)}
    views_of_images = np.array([numbers.get(name, -1) for name in image_names], np.int64)
    counts, tracks, inside = [np.zeros(0, np.int64)], [np.zeros(0, np.int32)], 0
    for rows in blocks(len(points), BLOCK):
        offsets = seen.offsets[rows.start : rows.stop + 1]
        views = views_of_images[seen.images[offsets[0] : offsets[-1]]]
        pairs = (owners_of(offsets) * len(model.views) + views)[views >= 0]
        pairs.sort(kind="stable")  # nearly sorted already
        owners, views = np.divmod(pairs[np.diff(pairs, prepend=-1) > 0], len(model.views))
        counts.append(np.bincount(owners, minlength=len(offsets) - 1))
        tracks.append(views.astype(np.int32))
        inside += num_inside(model, points[rows], owners, tracks[-1])
    total = sum(len(track) for track in tracks)
    # With the images in another order, fewer observations lie in their images.
    if inside < 0.9 * total:
        raise ColmapEdgesError(
            f"only {inside / total:.0%} of the cloud's observations lie in the images that "
            "its visibility names; give the model that the cloud was made from"
        )
    return SeenPoints(points, offsets_of(np.concatenate(counts)), np.concatenate(tracks))


def num_inside(model: Model, points: FloatArray, owners: IntArray, views: Int32Array) -> int:
    """Number of observations of points, given their points and views, that lie in their images."""
    return sum(
        int(np.count_nonzero(view.holds(*view.project(points[owners[rows]]))))
        for view, rows in views_with_rows(model.views, views)
    )


def by_depth_test(points: FloatArray, model: Model) -> SeenPoints:
    """Points with the views in whose images they are, with no other point before them."""
    found = [visible_in(view, points) for view in model.views]
    owners = np.concatenate([np.zeros(0, np.int64), *found])
    views = np.repeat(np.arange(len(found), dtype=np.int32), [len(rows) for rows in found])
    order = order_of(owners, len(points))
    return SeenPoints(points, offsets_of(np.bincount(owners, minlength=len(points))), views[order])


def visible_in(view: View, points: FloatArray) -> IntArray:
    """Ascending indices of the points that a view sees, by a coarse map of nearest depths."""
    pixels, depths = view.project(points)
    rows = np.flatnonzero(view.holds(pixels, depths))
    pixels, depths = pixels[rows], depths[rows].astype(np.float32)
    side = cell_side(pixels, view.width * view.height)
    columns, lines = (pixels / side).astype(np.int64).T
    nearest = np.full((lines.max(initial=0) + 1, columns.max(initial=0) + 1), np.inf, np.float32)
    np.minimum.at(nearest, (lines, columns), depths)
    # A nearer point hides this one in its cell and those next to it, unless both are of one
    # surface: depth against width has a slope of 5.7 where it is seen at 80 degrees.
    around = cv2.erode(nearest, square(1))
    margin = 5.7 * (1.5 * side) / (view.focal_px / view.scale)
    return np.asarray(rows[depths * (1 - margin) <= around[lines, columns]])


def cell_side(pixels: FloatArray, area: float) -> float:
    """Side of cells with four of (N, 2) projections on average, at least a pixel."""
    for _ in range(2):  # the second time with the area where points are
        side = max(float(np.sqrt(4 * area / max(len(pixels), 1))), 1.0)
        area = len(np.unique(row_numbers((pixels / side).astype(np.int64)))) * side**2
    return side
