"""Sites of the windows of patches, and hypotheses of their depths from what is known."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial import Delaunay, QhullError

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, Float32Array, FloatArray, owners_of, row_numbers
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.core.view import rows_by_view
from colmap_edges.images.files import square
from colmap_edges.surfaces.faces.grids import Grid

STEP_PX = 4  # between sites, pixels of the pictures
RADIUS_PX = 3  # of windows, as in the kernel
EDGE_PX = 5.0  # distance of sites from edges, so that no blurred edge is in a window
# Least variance of gray that is texture, in levels squared (of rounding and compression), and in
# variances of the noise around it.
LEAST_VARIANCE, NOISE_FACTOR = 1.0, 4.0
NOISE_SIDE_PX = 15  # of the square in which noise is measured
MIN_KNOWN = 4  # points that a view must observe for hypotheses from them


def places_in(
    model: Model, grids: Sequence[Grid], seen: SeenPoints
) -> list[tuple[FloatArray, FloatArray]]:
    """Of each view the (N, 2) pixels and (N,) inverse depths of points that it observes."""
    owners = owners_of(seen.track_offsets)
    places = []
    for view, grid, rows in zip(
        model.views, grids, rows_by_view(seen.track_views, len(model.views)), strict=True
    ):
        points = seen.points[owners[rows]]
        depths = view.cam_from_world(points)[:, 2]
        points, depths = points[depths > 0], depths[depths > 0]
        places.append((grid.pixels_of(view, points) - 0.5, 1 / depths))
    return places


def shape_of(grid: Grid) -> tuple[int, int]:
    """Rows and columns of sites, as in the kernel."""
    height, width = ((side - 2 * RADIUS_PX - 1) // STEP_PX + 1 for side in grid.gray.shape)
    return height, width


def textured_sites(grid: Grid, edge_pixels: FloatArray) -> BoolArray:
    """(rows, columns) of sites whose windows have texture, and neither edges nor background."""
    gray = grid.gray.astype(np.float32)
    textured = texture_of(gray) > np.maximum(LEAST_VARIANCE, NOISE_FACTOR * noise_of(gray))
    away = np.ones(gray.shape, np.uint8)
    columns, rows = np.rint(edge_pixels).astype(np.int64).T
    inside = (columns >= 0) & (rows >= 0) & (columns < gray.shape[1]) & (rows < gray.shape[0])
    away[rows[inside], columns[inside]] = 0
    textured &= cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_5) >= EDGE_PX
    left_out = np.zeros(gray.shape, np.uint8)
    if grid.usable is not None:
        left_out[~grid.usable] = 1
    if grid.background is not None:
        left_out[grid.background] = 1
    # Outlines are a pixel wide.
    textured &= cv2.dilate(left_out, square(RADIUS_PX + 1)) == 0
    height, width = shape_of(grid)
    sites = textured[RADIUS_PX::STEP_PX, RADIUS_PX::STEP_PX][:height, :width]
    return np.ascontiguousarray(sites)


def texture_of(gray: Float32Array) -> Float32Array:
    """(H, W) variance of gray in the window of each pixel, less that of a linear change.

    Shading changes linearly, and correlates at any depth.
    """
    reach = np.arange(-RADIUS_PX, RADIUS_PX + 1, dtype=np.float32)
    even = np.full_like(reach, 1 / len(reach))
    odd = reach / len(reach) / np.sqrt(np.mean(reach**2))
    means, right, down = (
        cv2.sepFilter2D(gray, cv2.CV_32F, *kernels)
        for kernels in ((even, even), (odd, even), (even, odd))
    )
    squares = cv2.sepFilter2D(gray * gray, cv2.CV_32F, even, even)
    return np.asarray(squares - means**2 - right**2 - down**2, np.float32)


def noise_of(gray: Float32Array) -> Float32Array:
    """(H, W) variance of the noise around each pixel, by second differences (Immerkaer, 1996)."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    high = cv2.filter2D(gray, -1, mask)
    return np.asarray(cv2.blur(high * high, (NOISE_SIDE_PX, NOISE_SIDE_PX)), np.float32)


def hypotheses_at(sites: BoolArray, pixels: FloatArray, inverse_depths: FloatArray) -> Float32Array:
    """(rows, columns, K, 3) inverse depths and slopes at sites; NaN for none.

    Those of the triangle of known points around a site, and the inverse depths of its
    corners.
    """
    found = np.full((*sites.shape, 4, 3), np.nan, np.float32)
    rows, columns = np.nonzero(sites)
    # One point in 12 by 12 pixels: sites hand on what they found.
    cells = np.floor(pixels / 12).astype(np.int64)
    _, first = np.unique(row_numbers(cells), return_index=True)
    pixels, inverse = pixels[first], inverse_depths[first]
    if len(pixels) < MIN_KNOWN or not len(rows):
        return found
    try:
        triangles = Delaunay(pixels)
    except QhullError:
        return found
    at = np.column_stack([columns, rows]) * STEP_PX + float(RADIUS_PX)
    simplex = triangles.find_simplex(at)
    rows, columns, at = rows[simplex >= 0], columns[simplex >= 0], at[simplex >= 0]
    corners = triangles.simplices[simplex[simplex >= 0]]
    last = corners[:, 2]
    sides, rise = pixels[corners[:, :2]] - pixels[last, None], inverse[corners[:, :2]]
    rise = rise - inverse[last, None]
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    slopes = np.column_stack(
        [
            rise[:, 0] * sides[:, 1, 1] - rise[:, 1] * sides[:, 0, 1],
            rise[:, 1] * sides[:, 0, 0] - rise[:, 0] * sides[:, 1, 0],
        ]
    )
    slopes /= np.where(area == 0, np.inf, area)[:, None]
    value = inverse[last] + np.einsum("ni,ni->n", slopes, at - pixels[last])
    found[rows, columns, 0] = np.column_stack([value, slopes])
    found[rows, columns, 1:, 0] = inverse[corners]
    found[rows, columns, 1:, 1:] = 0
    return found
