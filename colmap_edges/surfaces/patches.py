"""Small planes where images have texture, found by correlation of windows, as points with noise.

Patches after Furukawa and Ponce (2010), searched as in PatchMatch stereo (Bleyer et al., 2011) on a
grid of sites in each view. Windows hold no traced edge: they do not straddle edges, and where edges
are the surface is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.spatial import Delaunay, QhullError

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    offsets_of,
    order_of,
    owners_of,
    row_numbers,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import rows_by_view, views_with_rows
from colmap_edges.edges3d.chains.view_selection import Neighborhood, select_views
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import ViewSelectionOptions
from colmap_edges.surfaces.faces.grids import Grid, blank_grid
from colmap_edges.surfaces.silhouettes import NO_POINTS, SeenPoints

STEP_PX = 6  # between sites, pixels of the pictures
RADIUS_PX = 3  # of windows, as in the kernel
EDGE_PX = 5.0  # distance of sites from edges, so that no blurred edge is in a window
NUM_NEIGHBORS = 4  # views that windows are compared with
# Variance of gray that is no texture: at least of rounding and compression, in levels squared, and
# in variances of the noise.
LEAST_VARIANCE, NOISE_FACTOR = 4.0, 4.0
MIN_COSINE = 0.17  # of the angle between normal and ray: 80 degrees
NUM_SWEEPS = 3
BELIEVED = 0.75  # correlation of windows of a place
MAX_OFF_PX, NUM_SIGMAS = 1.0, 4.0  # distance of agreeing patches
MIN_NORMAL_COSINE = 0.75
MIN_AGREEING = 2
MAX_THROUGH = 0.5  # views that see through a patch, per agreeing view
MAX_ANGLE_DEG = 40.0  # between the views of a patch
MIN_KNOWN = 4
NUM_COLUMNS = 256  # cells along the longer side of a picture, of 4 pixels each
NUM_LEVELS = 5  # of smoothing: planes of up to 32 by 32 sites
MAX_ROUGHNESS, MAX_RESIDUAL = 1.5, 4.0  # of a plane, in standard deviations
MIN_OFF, MIN_OFF_SHARE = 2, 0.25  # views in which a mesh is elsewhere
MIN_ON_PLANE = 6  # patches on a plane


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Points on textured surfaces.

    Attributes:
        points: the points, with the views that agree on them.
        normals: (P, 3) unit normals, towards the views.
        sigmas: (P,) standard deviations along the viewing ray, world units.
        num_sites: number of windows with texture, in all views.
        num_found: number of those that a neighbour shows, too.
        num_agreed: number of those that views agree on.
    """

    points: SeenPoints
    normals: FloatArray
    sigmas: FloatArray
    raw_sigmas: FloatArray
    num_sites: int
    num_found: int
    num_agreed: int


NO_PATCHES = Patches(
    points=NO_POINTS,
    normals=np.zeros((0, 3)),
    sigmas=np.zeros(0),
    raw_sigmas=np.zeros(0),
    num_sites=0,
    num_found=0,
    num_agreed=0,
)


def find_patches(
    model: Model, edges: Edges3D, pictures: Mapping[int, Grid], seed: int, num_threads: int
) -> Patches:
    """Find patches where views have texture and no edges.

    Args:
        model: gives the V views and the SfM points.
        edges: its 3D edges.
        pictures: pictures of the views by their index; views without one show nothing.
        seed: of random depths.
        num_threads: threads; the result does not depend on them.
    """
    options = ViewSelectionOptions(max_angle_deg=MAX_ANGLE_DEG)
    neighborhood = select_views(model, options)
    grids = [picture_of(pictures, model, v) for v in range(len(model.views))]
    sfm, on_edges = (places_in(model, grids, of) for of in known_points(model, edges))
    flat = noise_variance(grids)
    active = [
        textured_sites(*of, flat) for of in zip(grids, (at for at, _ in on_edges), strict=True)
    ]
    hypotheses = [
        hypotheses_at(sites, *(np.concatenate(of) for of in zip(points, edge, strict=True)))
        for sites, points, edge in zip(active, sfm, on_edges, strict=True)
    ]
    scene = make_scene(model, grids, neighborhood, NUM_NEIGHBORS)
    ranges = np.array([of.overall for of in neighborhood.ranges])
    steps = (flat, MIN_COSINE, NUM_SWEEPS, BELIEVED, seed, num_threads)
    num_found = scene.search([of.view(np.uint8) for of in active], hypotheses, ranges, *steps)
    rows, values, offsets, views = scene.agreed(
        *around(neighborhood.observing_views),
        MAX_OFF_PX,
        NUM_SIGMAS,
        MIN_NORMAL_COSINE,
        num_threads,
    )
    agreeing = np.diff(offsets)
    accepted = (agreeing >= MIN_AGREEING) & (rows[:, 4] <= MAX_THROUGH * agreeing)
    best = np.flatnonzero(accepted & (rows[:, 3] > 0))
    kept = best
    planes, sigmas = smoothed(rows[kept], values[kept])
    raw = values[kept, 5] * noise_factor(rows[kept], values[kept])
    points, normals, deviations = in_world(model, grids, rows[kept], values[kept], planes, sigmas)
    counts = agreeing[kept] + 1
    tracks = np.insert(
        views[entries_of(offsets, kept)], offsets_of(agreeing[kept])[:-1], rows[kept, 0]
    )
    return Patches(
        points=SeenPoints(points, offsets_of(counts), tracks),
        normals=normals,
        sigmas=deviations,
        raw_sigmas=deviations / sigmas * raw,
        num_sites=sum(int(of.sum()) for of in active),
        num_found=num_found,
        num_agreed=int(accepted.sum()),
    )


def in_world(
    model: Model,
    grids: Sequence[Grid],
    rows: Int32Array,
    values: FloatArray,
    planes: FloatArray,
    sigmas: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(P, 3) points, (P, 3) unit normals and (P,) standard deviations of patches."""
    points, normals, deviations = np.zeros((len(rows), 3)), np.zeros((len(rows), 3)), sigmas.copy()
    for v, own in enumerate(rows_by_view(rows[:, 0], len(grids))):
        view, grid = model.views[v], grids[v]
        rays = np.ones((len(own), 3))
        rays[:, :2] = (values[own, :2] + 0.5 - grid.principal) / grid.focal_px
        inverse, slopes = planes[own, 0], grid.focal_px * planes[own, 1:]
        points[own] = (rays / inverse[:, None] - view.translation) @ view.rotation
        last = inverse - np.einsum("ij,ij->i", slopes, rays[:, :2])
        normals[own] = -np.column_stack([slopes, last]) @ view.rotation
        deviations[own] *= np.linalg.norm(rays, axis=1) / inverse**2
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True), deviations


def picture_of(pictures: Mapping[int, Grid], model: Model, v: int) -> Grid:
    """The picture of view v; a small blank one if its image could not be read."""
    return pictures.get(v) or blank_grid(model.views[v])


def known_points(model: Model, edges: Edges3D) -> tuple[SeenPoints, SeenPoints]:
    """The SfM points and the edge points, with the views that observe them."""
    sfm = SeenPoints(model.points3D_xyz, model.track_offsets, model.track_views)
    seen = edges.observations
    return sfm, SeenPoints(edges.points, seen.offsets, seen.views)


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


def textured_sites(grid: Grid, edge_pixels: FloatArray, flat: float) -> BoolArray:
    """(rows, columns) of sites whose windows have texture and no edge."""
    gray = grid.gray.astype(np.float32)
    side = (2 * RADIUS_PX + 1,) * 2
    means = cv2.boxFilter(gray, -1, side)
    textured = cv2.boxFilter(gray * gray, -1, side) - means * means > flat
    away = np.ones(gray.shape, np.uint8)
    columns, rows = np.rint(edge_pixels).astype(np.int64).T
    inside = (columns >= 0) & (rows >= 0) & (columns < gray.shape[1]) & (rows < gray.shape[0])
    away[rows[inside], columns[inside]] = 0
    textured &= cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_5) >= EDGE_PX
    height, width = shape_of(grid)
    sites = textured[RADIUS_PX::STEP_PX, RADIUS_PX::STEP_PX][:height, :width]
    return np.ascontiguousarray(sites)


def noise_variance(grids: Sequence[Grid]) -> float:
    """Variance of gray, in levels squared, in windows without texture.

    The noise is the lower decile of the local deviation of second differences (Immerkaer, 1996).
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    found = []
    for grid in grids[:: -(-len(grids) // 10)]:
        high = cv2.filter2D(grid.gray.astype(np.float32), -1, mask)
        found.append(np.quantile(cv2.blur(high * high, (15, 15)), 0.1))
    return max(LEAST_VARIANCE, NOISE_FACTOR * float(np.median(found)))


def hypotheses_at(sites: BoolArray, pixels: FloatArray, inverse_depths: FloatArray) -> Float32Array:
    """(rows, columns, K, 3) inverse depths and slopes at sites; NaN for none.

    Those of the triangle of known points around a site, and the inverse depths of its
    corners.
    """
    found = np.full((*sites.shape, 4, 3), np.nan, np.float32)
    rows, columns = np.nonzero(sites)
    cells = np.floor((pixels - RADIUS_PX) / STEP_PX + 0.5).astype(np.int64)
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


def make_scene(model: Model, grids: Sequence[Grid], neighborhood: Neighborhood, count: int) -> Any:
    """The kernel's scene."""
    near = [of[:count] for of in neighborhood.neighbors]
    return _kernels.PatchScene(
        np.array([view.rotation for view in model.views]),
        np.array([view.translation for view in model.views]),
        np.array([grid.focal_px for grid in grids]),
        np.array([grid.principal for grid in grids]),
        [grid.gray for grid in grids],
        offsets_of(np.array([len(of) for of in near])),
        np.concatenate([np.zeros(0, np.int32), *near]).astype(np.int32),
        STEP_PX,
    )


def around(near: Sequence[IntArray]) -> tuple[IntArray, Int32Array]:
    """Offsets and views of each view's neighbours and of those whose neighbour it is."""
    sets = [set(of.tolist()) for of in near]
    for v, of in enumerate(near):
        for other in of.tolist():
            sets[other].add(v)
    rows = [np.array(sorted(of), np.int32) for of in sets]
    return offsets_of(np.array([len(of) for of in rows])), np.concatenate(rows)


def smoothed(rows: Int32Array, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Patches moved onto the planes that they share with their neighbours, where there are such.

    Args:
        rows: (P, 5) of the kernel's agreed patches.
        values: (P, 7) of the same.

    Returns:
        (P, 3) inverse depths and slopes, and (P,) standard deviations of the inverse depths.
    """
    values = values.copy()
    values[:, 5] *= noise_factor(rows, values)
    planes, sigmas = values[:, 2:5].copy(), values[:, 5].copy()
    left = np.arange(len(rows))
    for level in range(NUM_LEVELS, 0, -1):
        fits = fitted_planes(values[left], cells_of(rows[left], level))
        moved = fits.is_plane
        planes[left[moved]], sigmas[left[moved]] = fits.planes[moved], fits.sigmas[moved]
        left = left[~moved]
    return planes, sigmas


def cells_of(rows: Int32Array, level: int) -> IntArray:
    """(P,) numbers, from 0, of the squares of 2 ** level sites that hold patches."""
    squares = np.column_stack([rows[:, 0], rows[:, 1] >> level, rows[:, 2] >> level])
    numbers: IntArray = np.unique(row_numbers(squares), return_inverse=True)[1]
    return numbers


def noise_factor(rows: Int32Array, values: FloatArray) -> float:
    """True standard deviations of patches over those of their correlation, at least 1.

    By the residuals of planes: most small parts of surfaces are planar.
    """
    fits = fitted_planes(values, cells_of(rows, 2))
    known = fits.residuals[np.isfinite(fits.residuals)]
    return max(1.0, 1.4826 * float(np.median(np.abs(known)))) if len(known) else 1.0


class PlaneFits(NamedTuple):
    """Planes of groups of patches, at each patch.

    Attributes:
        planes: (P, 3) inverse depths and slopes.
        sigmas: (P,) standard deviations of these inverse depths.
        residuals: (P,) distances from them, in standard deviations as if of no fit; NaN without.
        is_plane: (P,) whether all patches of the group are on its plane.
    """

    planes: FloatArray
    sigmas: FloatArray
    residuals: FloatArray
    is_plane: BoolArray


def fitted_planes(values: FloatArray, own: IntArray) -> PlaneFits:
    """Planes of groups, by weighted least squares.

    Args:
        values: (P, 7) of the kernel's agreed patches.
        own: (P,) groups, from 0.
    """
    count = int(own.max(initial=-1)) + 1
    size = np.bincount(own, minlength=count).astype(np.float64)
    mean = np.column_stack([np.bincount(own, axis, count) for axis in values[:, :2].T])
    mean /= np.maximum(size, 1)[:, None]
    design = np.column_stack([np.ones(len(own)), values[:, :2] - mean[own]])
    weights = values[:, 5] ** -2
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for i in range(3):
        right[:, i] = np.bincount(own, weights * design[:, i] * values[:, 2], count)
        for j in range(3):
            matrix[:, i, j] = np.bincount(own, weights * design[:, i] * design[:, j], count)
    scale = 1 / np.sqrt(np.maximum(matrix[:, [0, 1, 2], [0, 1, 2]], 1e-300))
    matrix *= scale[:, :, None] * scale[:, None]
    fits = (size >= MIN_ON_PLANE) & (np.linalg.det(matrix) > 1e-3)
    matrix[~fits] = np.eye(3)
    inverse = np.linalg.inv(matrix) * scale[:, :, None] * scale[:, None]
    plane = np.einsum("gij,gj->gi", inverse, right)
    planes = plane[own]
    planes[:, 0] = np.einsum("pi,pi->p", design, planes)
    sigmas = np.sqrt(np.einsum("pi,pij,pj->p", design, inverse[own], design))
    freedom = np.sqrt(size / np.maximum(size - 3, 1))[own]
    residuals = freedom * (values[:, 2] - planes[:, 0]) / values[:, 5]
    residuals[~fits[own]] = np.nan
    rough = np.sqrt(np.bincount(own, residuals**2, count) / np.maximum(size, 1))
    most = np.zeros(count)
    np.maximum.at(most, own, np.nan_to_num(np.abs(residuals)))
    is_plane = fits & (rough <= MAX_ROUGHNESS) & (most <= MAX_RESIDUAL)
    return PlaneFits(planes, sigmas, residuals, is_plane[own])


def what_they_add(
    patches: Patches, model: Model, vertices: FloatArray, faces: Int32Array, num_threads: int
) -> IntArray:
    """Indices of the patches that a mesh lacks: it is elsewhere in several of their views.

    Args:
        patches: the patches.
        model: the model of the views.
        vertices: (N, 3) of the mesh without patches.
        faces: (F, 3) of the same.
        num_threads: threads.
    """
    seen = patches.points
    owners, views = owners_of(seen.track_offsets), seen.track_views
    order = order_of(views, len(model.views))
    rays, depths = np.zeros((len(views), 2)), np.zeros(len(views))
    for view, rows in views_with_rows(model.views, views):
        local = view.cam_from_world(seen.points[owners[rows]])
        rays[rows], depths[rows] = local[:, :2] / local[:, 2:], local[:, 2]
    inverse = np.zeros(len(views))
    inverse[order] = _kernels.mesh_depths(
        np.array([view.rotation for view in model.views]),
        np.array([view.translation for view in model.views]),
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int32),
        offsets_of(np.bincount(views, minlength=len(model.views))),
        rays[order],
        num_threads,
    )
    with np.errstate(divide="ignore"):
        off = (
            np.abs(1 / inverse - depths)
            > NUM_SIGMAS * np.hypot(patches.sigmas, patches.raw_sigmas)[owners]
        )
    away = np.bincount(owners, off, len(seen.points))
    return np.flatnonzero(away >= np.maximum(MIN_OFF, MIN_OFF_SHARE * np.diff(seen.track_offsets)))
