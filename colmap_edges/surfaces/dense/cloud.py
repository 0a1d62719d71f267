"""A dense cloud made ready for the mesher: thinned, moved onto its planes, away from edges."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.colmap.clouds import BLOCK, CloudFile, SeenRows
from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    IntArray,
    blocks,
    entries_of,
    offsets_of,
    owners_of,
    ranks_of,
    row_numbers,
)
from colmap_edges.core.checks import check_arrays
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.core.view import nearest_pixel_sizes
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options.meshing import DenseOptions
from colmap_edges.surfaces.dense.displacement import measured_shift, movements
from colmap_edges.surfaces.dense.planes import NUM_NEIGHBORS, planes_at
from colmap_edges.surfaces.dense.seeing import seen_by
from colmap_edges.surfaces.information import MIN_NOISE_PX
from colmap_edges.surfaces.mesh import Mesh


@dataclass(frozen=True, kw_only=True)
class DenseCloud:
    """A thinned cloud with the views that see its points.

    Attributes:
        points: the points with their views.
        colors: (P, 3) uint8.
        sigmas: (P,) standard deviations of the cloud's points along its normals, world units.
        pixels: (P,) size of a pixel at each point in the nearest view that sees it, world units.
        num_read: number of points in the file.
        shift_px: (2,) shift of the cloud's images against the model's; 0 without.
        edge_dist: distance from curves within which points yield to them, in pixels.
        is_scan: whether its files name no views, so that it is none of stereo.
    """

    points: SeenPoints
    colors: Annotated[ByteArray, "P", 3]
    sigmas: Annotated[FloatArray, "P"]
    pixels: Annotated[FloatArray, "P"]
    num_read: int
    shift_px: Annotated[FloatArray, 2]
    edge_dist: float
    is_scan: bool = False

    @property
    def noise_px(self) -> float:
        """Median standard deviation of the points, in pixels."""
        return float(np.median(self.sigmas / self.pixels))

    def check(self, name: str = "points", num_views: int | None = None) -> None:
        """Check shapes, dtypes and values, as all functions of the Python interface do.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        self.points.check(f"{name}.points", num_views)
        check_arrays(name, self, P=len(self.points.points))

    def away_from(self, curves: Sequence[Edges3D | None], faces: FloatArray) -> DenseCloud:
        """The cloud without points near curves and planar faces, which are more precise.

        Near edges, the windows of dense stereo show two surfaces, and points of one are smeared
        over the other; scans are not smeared, and yield within 2 pixels. Faces have points in
        plain scenes only, where dense stereo guesses: the distance is twice as much.

        Args:
            curves: edges and contours.
            faces: (F, 3) points of faces.
        """
        reach_px = min(self.edge_dist, 2.0) if self.is_scan else self.edge_dist
        reach = reach_px * self.pixels
        # Half the distance within which points yield to edges.
        step = 0.5 * float(np.median(reach)) if len(reach) else 0.0
        if not step:
            return self
        samples = [np.zeros((0, 3)), *(sampled(of, step) for of in curves if of)]
        on_curve = are_near(self.points.points, np.concatenate(samples), reach)
        on_face = are_near(self.points.points, faces, 2.0 * reach)
        kept = np.flatnonzero(~(on_curve | on_face))
        return replace(
            self,
            points=self.points.chosen(kept),
            colors=self.colors[kept],
            sigmas=self.sigmas[kept],
            pixels=self.pixels[kept],
        )

    def where_empty(self, seen: SeenPoints, model: Model) -> IntArray:
        """Indices of the points of `seen` that have no point of the cloud near them."""
        # The cloud is empty beyond 8 pixels from its nearest point.
        reach = 8.0 * pixel_sizes(seen, model)
        return np.flatnonzero(~are_near(seen.points, self.points.points, reach))


def dense_cloud(
    file: CloudFile,
    model: Model,
    image_names: Sequence[str],
    options: DenseOptions,
    num_threads: int = 0,
) -> DenseCloud:
    """Make a cloud ready: find its views, thin it, and average its noise.

    Args:
        file: what was read.
        model: the model in whose frame it is.
        image_names: names of the images that the visibility counts.
        options: options of dense clouds.
        num_threads: threads, 0 for all cores; the result does not depend on it.

    Raises:
        ColmapEdgesError: if no image sees a point, or the visibility is of another model.
    """
    num_read = len(file.points)
    file = finite(file)
    cloud = seen_by(file.points, file.seen, model, image_names)
    if len(cloud.points) <= NUM_NEIGHBORS or not len(cloud.track_views):
        raise ColmapEdgesError(
            f"no image sees the cloud of {num_read:,} points; give the model in whose "
            "coordinates it is"
        )
    pixels = pixel_sizes(cloud, model)
    kept = thinned(cloud, pixels, options.max_proj_dist)
    tree = cKDTree(cloud.points)
    shift = measured_shift(cloud, tree, model)
    moved, sigmas = averaged(cloud, kept, tree, model, shift, num_threads or os.cpu_count() or 1)
    return DenseCloud(
        points=cloud.chosen(kept)._replace(points=moved),
        colors=file.colors[kept],
        sigmas=np.maximum(sigmas, MIN_NOISE_PX * pixels[kept]),
        pixels=pixels[kept],
        num_read=num_read,
        shift_px=shift,
        edge_dist=options.edge_dist,
        is_scan=file.seen is None,
    )


def finite(file: CloudFile) -> CloudFile:
    """The points whose coordinates are finite."""
    rows = np.flatnonzero(np.isfinite(file.points).all(axis=1))
    seen = file.seen
    if len(rows) == len(file.points):
        return file
    if seen is not None:
        images = seen.images[entries_of(seen.offsets, rows)]
        seen = SeenRows(offsets_of(np.diff(seen.offsets)[rows]), images)
    return CloudFile(file.points[rows], file.colors[rows], seen)


def pixel_sizes(seen: SeenPoints, model: Model) -> FloatArray:
    """(N,) size of a pixel at points, in the nearest view that sees them; infinite without any."""
    sizes = np.empty(len(seen.points))
    for rows in blocks(len(sizes), BLOCK):
        offsets = seen.track_offsets[rows.start : rows.stop + 1]
        views = seen.track_views[offsets[0] : offsets[-1]]
        sizes[rows] = nearest_pixel_sizes(model.views, seen.points[rows], owners_of(offsets), views)
    return sizes


def thinned(cloud: SeenPoints, pixels: FloatArray, max_proj_dist: float) -> IntArray:
    """Ascending indices of points, one of each cube whose side is a distance in the images.

    The one with the most views is kept, the first of equal ones. Sides are powers of two, so that
    cubes of points at similar distances are the same.
    """
    seen = np.flatnonzero(np.isfinite(pixels))
    if not max_proj_dist:
        return seen
    level = np.floor(np.log2(np.maximum(pixels[seen] * max_proj_dist, 1e-300))).astype(np.int64)
    low = cloud.points.min(axis=0)
    cubes = np.floor(np.ldexp(cloud.points[seen] - low, -level[:, None])).astype(np.int64)
    order = np.argsort(-np.diff(cloud.track_offsets)[seen], kind="stable")
    numbers = row_numbers(np.column_stack([level, cubes])[order])
    return np.asarray(np.sort(seen[order[np.unique(numbers, return_index=True)[1]]]))


def averaged(
    cloud: SeenPoints,
    kept: IntArray,
    tree: cKDTree,
    model: Model,
    shift: FloatArray,
    num_threads: int,
) -> tuple[FloatArray, FloatArray]:
    """Positions of kept points on the planes of their neighbours, and deviations from these.

    Args:
        cloud: all points with their views.
        kept: (K,) indices of points.
        tree: of all points.
        model: the model.
        shift: (2,) of the images, pixels; points are moved by the median of what it moves their
            neighbours.
        num_threads: threads.
    """
    moved, sigmas = np.empty((len(kept), 3)), np.empty(len(kept))
    for rows in blocks(len(kept), 50_000):
        own = cloud.points[kept[rows]]
        near = tree.query(own, NUM_NEIGHBORS, workers=num_threads)[1]
        planes = planes_at(cloud.points[near])
        off = np.einsum("ni,ni->n", own - planes.centers, planes.normals)
        moved[rows] = own - off[:, None] * planes.normals
        if shift.any():
            used, places = np.unique(near, return_inverse=True)
            moves = movements(cloud.chosen(used), model) @ shift
            moved[rows] += np.median(moves[places.reshape(near.shape)], axis=1)
        sigmas[rows] = planes.sigmas
    return moved, sigmas


def are_near(points: FloatArray, others: FloatArray, reach: FloatArray) -> BoolArray:
    """(N,) whether any of (M, 3) other points is within (N,) distances of (N, 3) points."""
    if not len(points) or not len(others):
        return np.zeros(len(points), bool)
    return np.asarray(cKDTree(others).query(points)[0] <= reach)


def sampled(curves: Edges3D, step: float) -> FloatArray:
    """(S, 3) points along polylines, at most a step apart."""
    starts, ends = (curves.points[column] for column in curves.segments.T)
    counts = np.ceil(np.linalg.norm(ends - starts, axis=1) / step).astype(np.int64).clip(1)
    owners = np.repeat(np.arange(len(counts)), counts)
    share = (ranks_of(counts) / counts[owners])[:, None]
    along = starts[owners] + share * (ends - starts)[owners]
    return np.concatenate([curves.points, along])


def with_cloud(
    mesh: Mesh, cloud: DenseCloud, rows: IntArray, num_sfm: int, num_others: int
) -> Mesh:
    """A mesh of chosen SfM points, curves and then a cloud, with sources as without the cloud.

    Args:
        mesh: the mesh, whose `point3D_ids` are indices of the meshed points.
        cloud: the cloud, whose vertices get its colours and no source.
        rows: (K,) the SfM points that were meshed.
        num_sfm: number of all SfM points.
        num_others: number of meshed points before the cloud.
    """
    sources, colors = mesh.point3D_ids, mesh.colors.copy()
    numbers = np.append(rows, np.arange(num_sfm, num_sfm + num_others - len(rows)))
    dense = (sources >= num_others) & (sources < num_others + len(cloud.colors))
    colors[dense] = cloud.colors[sources[dense] - num_others]
    known = (sources >= 0) & (sources < num_others)
    ids = np.full(len(sources), -1, np.int64)
    ids[known] = numbers[sources[known]]
    return replace(mesh, point3D_ids=ids, colors=colors)
