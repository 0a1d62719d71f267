"""Depth errors of a mesh in the cameras (Strecha's protocol, the paper's mesh columns)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, Float32Array, FloatArray
from colmap_edges.core.view import View, views_with_rows
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.normals import angles_deg, normal_shares, normals_of_depth
from colmap_edges.evaluation.metrics.raycasting import RayCaster
from colmap_edges.evaluation.metrics.statistics import Record, mean, summarize
from colmap_edges.evaluation.readers.arrays import read_arrays

RIGHT_WITHIN = {"right_0_5_percent": 0.005, "right_1_percent": 0.01, "right_2_percent": 0.02}


@dataclass(frozen=True, kw_only=True)
class ReferenceDepth:
    """The reference depth of one view.

    Attributes:
        view: The posed image.
        depth: (H, W) along the optical axis in world units, 0 where unknown.
        scale: Size of the map over the size of the image: the centre of its pixel (row, column)
            lies at ((column + 0.5) / scale, (row + 0.5) / scale) in the image.
        pixels: (H, W, 2) image positions of the depths; None for pixel centres.
        surface_normals: (H, W, 3) unit normals of a reference mesh, see `normals`.
    """

    view: View
    depth: Float32Array
    scale: float
    pixels: FloatArray | None = None
    surface_normals: FloatArray | None = None

    @property
    def known(self) -> BoolArray:
        """Which pixels (H, W) have a depth."""
        return (self.depth > 0) & np.isfinite(self.depth)

    @cached_property
    def normals(self) -> FloatArray | None:
        """Unit normals (H, W, 3) in the world, towards the camera, NaN where unknown.

        Those of a reference mesh, or differences of neighbouring depths. None for clouds and noisy
        depth maps, which have none.
        """
        if self.surface_normals is not None or self.pixels is not None:
            return self.surface_normals
        depth = np.where(self.known, self.depth, np.nan).astype(np.float64)
        rays = self.view.rays(measured_pixels(self)).reshape(*depth.shape, 3)
        return normals_of_depth(self.view.center + rays * depth[..., None], self.view.center)


@dataclass(frozen=True, kw_only=True)
class DepthErrors:
    """Signed depth errors mesh - reference of one view.

    Attributes:
        name: Name of the view.
        errors: (H, W) in world units, NaN where either is unknown.
        reference: (H, W) depths, 0 where unknown.
        angles_deg: (N,) angles between the normals of mesh and reference at the N pixels at which
            the reference has a normal, NaN where the mesh is not hit; None if it has none.
    """

    name: str
    errors: FloatArray
    reference: Float32Array
    angles_deg: FloatArray | None = None

    @property
    def known(self) -> BoolArray:
        """Which pixels (H, W) have a reference depth."""
        return (self.reference > 0) & np.isfinite(self.reference)

    def record(self) -> Record:
        """Statistics of the known errors and shares of the reference's pixels; see `pool`."""
        return pool([self])


def pixel_centers(shape: tuple[int, ...]) -> FloatArray:
    """(H * W, 2) centres of the pixels of a map (H, W), row by row."""
    return np.asarray(np.indices(shape).reshape(2, -1)[::-1].T + 0.5, np.float64)


def measured_pixels(reference: ReferenceDepth) -> FloatArray:
    """Image coordinates (H * W, 2) of the values of a depth map, row by row."""
    if reference.pixels is not None:
        return reference.pixels.reshape(-1, 2)
    return pixel_centers(reference.depth.shape) / reference.scale


def load_reference_depths(folder: Path, model: Model) -> list[ReferenceDepth]:
    """Read every NAME.npz (`depth`, `scale`, `image_name`) of `folder` whose view is in `model`.

    Names are compared without their suffix.

    Raises:
        ColmapEdgesError: No file, a file without `depth`, or no view of that name.
    """
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise ColmapEdgesError(f"{folder} holds no depth map (*.npz)")
    views = {str(Path(view.name).with_suffix("")): view for view in model.views}
    references = []
    for path in paths:
        depth, scale, name = read_depth(path)
        view = views.get(str(Path(name).with_suffix(""))) or views.get(path.stem)
        if view is None:
            raise ColmapEdgesError(f"{path} is of image {name}, which is not in the model")
        scale = scale or depth.shape[1] / view.width
        references.append(ReferenceDepth(view=view, depth=depth, scale=scale))
    return references


def read_depth(path: Path) -> tuple[Float32Array, float, str]:
    """Depths (H, W), scale (0: not stated) and image name of a depth map."""
    data = read_arrays(path)
    if "depth" not in data:
        raise ColmapEdgesError(f"{path} holds no array 'depth'")
    name = str(data["image_name"]) if "image_name" in data else path.stem
    try:
        depth = np.asarray(data["depth"], dtype=np.float32)
        scale = float(data.get("scale", np.float64(0)))
    except (ValueError, TypeError) as error:
        raise ColmapEdgesError(f"{path} holds a depth or scale that is not numeric") from error
    if depth.ndim != 2 or not depth.size or not (np.isfinite(scale) and scale >= 0):
        raise ColmapEdgesError(
            f"{path} holds depths {depth.shape} of scale {scale}; give a 2D array and a scale > 0"
        )
    return depth, scale, name


def render_reference(caster: RayCaster, view: View, scale: float = 1.0) -> ReferenceDepth:
    """Depths (0 where it is not hit) and normals of the mesh of `caster` in `view`.

    The longer side of the maps is at most 1600 pixels.
    """
    scale = min(scale, 1600 / max(view.width, view.height))
    shape = (max(1, round(view.height * scale)), max(1, round(view.width * scale)))
    depth, normals = caster.hits(view.center, view.rays(pixel_centers(shape) / scale))
    return ReferenceDepth(
        view=view,
        depth=np.nan_to_num(depth, nan=0.0).astype(np.float32).reshape(shape),
        scale=scale,
        surface_normals=normals.reshape(*shape, 3),
    )


def cloud_depth(points: FloatArray, view: View) -> ReferenceDepth:
    """Depth of the points (N, 3) of a dense cloud that are visible in `view`.

    The map is so coarse that neighbouring points project at most half a pixel apart. The nearest
    point of each pixel is used, with the ray through its own projection. It is occluded if a point
    within two pixels is nearer by more than twelve pixels' length at its depth (the depth change
    over two pixels of a surface seen at 80 degrees).
    """
    pixels, depths = view.project(points)
    inside = view.holds(pixels, depths)
    pixels, depths = pixels[inside], depths[inside]
    scale = _cloud_scale(points[inside], depths, view)
    shape = (int(np.ceil(view.height * scale)), int(np.ceil(view.width * scale)))
    cells = np.ravel_multi_index(tuple(np.floor(pixels * scale).astype(int).T[::-1]), shape)
    order = np.lexsort((depths, cells))
    cells, first = np.unique(cells[order], return_index=True)
    nearest = order[first]
    buffer = np.full(shape, np.inf)
    buffer.flat[cells] = depths[nearest]
    front = minimum_filter(buffer, size=5, mode="nearest").flat[cells]
    seen = depths[nearest] <= front * (1 + 12 / (view.focal_px * scale))
    depth, where = np.zeros(shape, dtype=np.float32), np.zeros((*shape, 2))
    depth.flat[cells[seen]] = depths[nearest[seen]]
    where.reshape(-1, 2)[cells[seen]] = pixels[nearest[seen]]
    return ReferenceDepth(view=view, depth=depth, scale=scale, pixels=where)


def _cloud_scale(points: FloatArray, depths: FloatArray, view: View) -> float:
    if len(points) < 2:
        return 1.0
    chosen = np.random.default_rng(0).permutation(len(points))[:5000]
    spacing, _ = cKDTree(points).query(points[chosen], k=2)
    spacing_px = float(np.median(spacing[:, 1] * view.focal_px / depths[chosen]))
    return float(np.clip(0.5 / max(spacing_px, 1e-9), 8 / max(view.width, view.height), 1.0))


def central_view(model: Model) -> View:
    """The middle view of the sequence in order of names (the paper's "central camera")."""
    if not model.views:
        raise ColmapEdgesError("the model holds no image with a pose")
    return model.views[len(model.views) // 2]


def depth_errors(caster: RayCaster, reference: ReferenceDepth) -> DepthErrors:
    """Errors of the mesh's depths and normals, along the rays of the reference's pixels."""
    known, truth = reference.known, reference.normals
    errors, angles = np.full(reference.depth.shape, np.nan), None
    rays = reference.view.rays(measured_pixels(reference)[known.ravel()])
    depth, normals = caster.hits(reference.view.center, rays)
    errors[known] = depth - reference.depth[known]
    if truth is not None:
        has_normal = np.isfinite(truth[known][:, 0])
        angles = angles_deg(normals[has_normal], truth[known][has_normal])
    name = reference.view.name
    return DepthErrors(name=name, errors=errors, reference=reference.depth, angles_deg=angles)


def pool(results: Sequence[DepthErrors]) -> Record:
    """Statistics of the errors and shares of right pixels, over all pixels of all views together.

    See `pixel_shares` and, where a reference has normals, `normal_shares`.
    """
    errors = np.concatenate([*(result.errors[result.known] for result in results), []])
    depths = np.concatenate([*(result.reference[result.known] for result in results), []])
    angles = [result.angles_deg for result in results if result.angles_deg is not None]
    record = summarize(errors[np.isfinite(errors)]) | pixel_shares(errors, depths)
    return record | (normal_shares(np.concatenate(angles)) if angles else {})


def pixel_shares(errors: FloatArray, depths: FloatArray) -> Record:
    """Shares of all pixels at which the mesh is hit, and at which it is right.

    Pixels without mesh count as wrong, so that errors cannot be reduced at the cost of coverage.

    Args:
        errors: (N,) mesh - reference along the optical axis, NaN where the mesh is not hit.
        depths: (N,) depths of the reference, in the unit of `errors`.

    Returns:
        `coverage`, and by the names of `RIGHT_WITHIN` the shares of pixels at which the mesh lies
        within that share of the pixel's own depth; all NaN without a pixel.
    """
    relative = np.where(np.isfinite(errors), np.abs(errors), np.inf) / depths
    right = {name: mean(relative <= limit) for name, limit in RIGHT_WITHIN.items()}
    return {"coverage": mean(np.isfinite(errors))} | right


def observation_depth_statistics(caster: RayCaster, model: Model) -> dict[str, Record]:
    """Errors of a mesh's depth at the observations of points it was not made from (held-out ones).

    Returns:
        Statistics of the errors mesh - point along the optical axis where the mesh is hit,
        `absolute` (world units) and `relative` to the points' depths, each with `pixel_shares`.
    """
    points = model.points3D_xyz[model.track_points]
    errors, depths = np.full((2, len(points)), np.nan)
    for view, seen in views_with_rows(model.views, model.track_views):
        if not len(seen):
            continue
        depths[seen] = view.cam_from_world(points[seen])[:, 2]
        errors[seen] = caster.depth_at(view, model.track_points2D[seen]) - depths[seen]
    known = np.isfinite(errors)
    shares = pixel_shares(errors, depths)
    return {
        "absolute": summarize(errors[known]) | shares,
        "relative": summarize(errors[known] / depths[known]) | shares,
    }
