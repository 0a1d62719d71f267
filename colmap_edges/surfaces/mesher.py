"""Meshing of points with their viewing rays; the Python side of the CGAL extension."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, joined_offsets
from colmap_edges.core.checks import MAX_COORDINATE, checked, path_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.seen_points import NO_POINTS, SeenPoints, joined_seen
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.background import BackgroundRays
from colmap_edges.options import DenseOptions, MeshingOptions
from colmap_edges.surfaces.dense.cloud import DenseCloud, with_cloud
from colmap_edges.surfaces.dense.given import given_cloud
from colmap_edges.surfaces.extension import load_extension
from colmap_edges.surfaces.faces.finding import NO_FACES, Faces
from colmap_edges.surfaces.faces.flattening import flattened, off_faces
from colmap_edges.surfaces.information import Tracks
from colmap_edges.surfaces.mesh import Mesh, with_model_attributes
from colmap_edges.surfaces.of_model import check_of_model
from colmap_edges.surfaces.patches.adding import what_they_add
from colmap_edges.surfaces.patches.depths import Depths
from colmap_edges.surfaces.patches.finding import NO_PATCHES, Patches
from colmap_edges.surfaces.patches.fitting import fitted
from colmap_edges.surfaces.refinement import Measured, refined
from colmap_edges.surfaces.simplify import simplify

if TYPE_CHECKING:
    from colmap_edges.colmap.model import Model

NO_BACKGROUND = BackgroundRays(np.zeros(0, np.int32), np.zeros((0, 3)))
# Minimum length of split segments, in median lengths; intersecting ones would be split forever.
FINEST = 0.01
# Least number of patches that a mesh lacks for which it is made again, relative to its points.
MIN_LACKING = 0.005


class Polylines(NamedTuple):
    """Polylines through points, in CSR arrays.

    Attributes:
        point_indices: (P,) int32 indices into the meshed points.
        offsets: (E + 1,) int64; polyline e is point_indices[offsets[e]:offsets[e + 1]].
        closed: (E,) bool; the last point of a closed polyline connects to its first.
        num_edges: number of polylines that are 3D edges, the first ones; None for all.
    """

    point_indices: Int32Array
    offsets: IntArray
    closed: BoolArray
    num_edges: int | None = None


@checked
def mesh(
    reconstruction_or_path: Any,
    edges: Edges3D | None = None,
    method: str | None = None,
    options: MeshingOptions | None = None,
    num_threads: int = 0,
    background: BackgroundRays | None = None,
    contours: Edges3D | None = None,
    faces: Faces | None = None,
    patches: Patches | None = None,
    refine: bool = True,
    points: Any = None,
    visibility: Any = None,
    dense: DenseOptions | None = None,
) -> Mesh:
    """Mesh the points of a COLMAP model, or a dense cloud, with or without 3D edges.

    Args:
        reconstruction_or_path: a model folder, a pycolmap.Reconstruction or a `Model`.
        edges: 3D edges of this model that the mesh should follow.
        method: overrides `options.method`.
        options: meshing options; the defaults suit any model.
        num_threads: number of threads, 0 for all cores; does not affect the result.
        background: background rays, as found by `reconstruct`.
        contours: view-dependent contours, as found by `reconstruct`; the mesh follows them, too.
        faces: planar faces between the edges, as found by `reconstruct`.
        patches: points where images have texture, as found by `reconstruct`.
        refine: move vertices within their noise until faces between edges are smooth.
        points: a dense cloud in the model's coordinates, which takes the place of patches, and of
            the model's points where it is not empty: a PLY file of COLMAP (fused.ply), OpenMVS or
            another program, or (N, 3) float64 points.
        visibility: which images see the points: COLMAP's file of it (fused.ply.vis), or the
            `SeenRows` of an array; indices of images count the model's, in its order. Without it,
            that of OpenMVS's PLY is used, or else the views that see a point by a depth test.
        dense: options of the dense cloud.

    Raises:
        ColmapEdgesError: if an argument is invalid or of another model, a file cannot be read,
            the points span no volume, or the mesher is not built.
    """
    model = as_model(reconstruction_or_path)
    options = options or MeshingOptions()
    if method is not None:
        options = replace(options, method=method)
    check_of_model(model, {"edges": edges, "contours": contours}, background, faces, patches)
    cloud = given_cloud(points, visibility, model, dense or DenseOptions(), num_threads)
    given = (background, faces or NO_FACES, patches or NO_PATCHES, refine, cloud)
    found = mesh_with_curves(model, (edges, contours), options, num_threads, *given)
    return finished(found, model, options, num_threads or os.cpu_count() or 1)


def mesh_with_curves(
    model: Model,
    edges_and_contours: tuple[Edges3D | None, Edges3D | None],
    options: MeshingOptions,
    num_threads: int,
    background: BackgroundRays | None = None,
    faces: Faces = NO_FACES,
    patches: Patches = NO_PATCHES,
    refine: bool = True,
    cloud: DenseCloud | None = None,
) -> Mesh:
    """Mesh points of a model, of curves and of faces.

    Of patches those are added that the mesh without them lacks: where it is right, they would add
    their noise only. A cloud takes their place, and that of the model's points but where it is
    empty.

    `point3D_ids` of the result are indices of the points of model and curves; -1, or larger, for
    others.
    """
    model = model.at_scale(1.0)  # as it is read, so that runs and Python give the same bits
    edges, contours = edges_and_contours
    contours = contours and off_faces(contours, faces)
    edges, contours = (of and flattened(of, faces, model) for of in (edges, contours))
    num_sfm = len(model.points3D_xyz)
    rows = np.arange(num_sfm)
    if cloud:
        cloud = cloud.away_from((edges, contours), faces.points.points)
        rows = cloud.where_empty(SeenPoints.of_model(model), model)
        model = model.selected(np.isin(np.arange(num_sfm), rows))
    curves = [of for of in (edges, contours) if of is not None]
    num_seen = len(model.points3D_xyz) + sum(each.num_points for each in curves)
    check_not_all_far(model, num_seen)
    others = joined_seen([faces.points, faces.round_points])
    polylines = polylines_of(curves, len(model.points3D_xyz), edges.num_edges if edges else 0)

    def meshed(added: SeenPoints) -> Mesh:
        return mesh_points(
            *joined_points(model, curves, added, others),
            model.camera_centers,
            options,
            polylines,
            num_threads,
            background,
        )

    if cloud:
        found, sigmas = meshed(cloud.points), cloud.sigmas
    else:
        given = (num_seen + len(others.points), meshed, num_threads)
        found, sigmas = mesh_with_patches(patches, model, *given)
    if refine:
        measured = Measured(model.views, Tracks.of_model(model), edges, contours, sigmas)
        found = fitted_and_refined(found, measured, model.views, patches.depths, num_threads)
    if cloud:
        found = with_cloud(found, cloud, rows, num_sfm, num_seen)
    return found


def fitted_and_refined(
    mesh: Mesh,
    measured: Measured,
    views: Sequence[View],
    depths: Depths,
    num_threads: int,
) -> Mesh:
    """A mesh moved to the depths that patches measured, then refined within its noise."""
    threads = num_threads or os.cpu_count() or 1
    if len(depths.views):
        information, _ = measured.of_vertices(mesh)
        mesh = fitted(mesh, information, views, depths, threads)
    return refined(mesh, measured, threads)


def check_not_all_far(model: Model, num_seen: int) -> None:
    """Check that there are points to mesh, if the model has only some at infinity.

    Raises:
        ColmapEdgesError: if there are none.
    """
    if not num_seen and len(model.far_point3D_ids):
        raise ColmapEdgesError(
            f"all {len(model.far_point3D_ids)} SfM points of the model are at infinity, compared "
            "with the distances between cameras; check the units of points and poses"
        )


def mesh_with_patches(
    patches: Patches,
    model: Model,
    num_points: int,
    meshed: Callable[[SeenPoints], Mesh],
    num_threads: int,
) -> tuple[Mesh, FloatArray]:
    """Mesh with the patches that the mesh of other points lacks.

    Args:
        patches: the patches.
        model: the model.
        num_points: number of other points.
        meshed: makes the mesh of given and other points.
        num_threads: threads.

    Returns:
        The mesh, and the deviations of the added patches.
    """
    found = meshed(NO_POINTS)
    lacking = what_they_add(patches, model, found.vertices, found.faces, num_threads)
    if len(lacking) <= MIN_LACKING * num_points:
        return found, patches.sigmas[:0]
    found = meshed(patches.points.chosen(lacking))
    found = replace(found, stats={**found.stats, "patches_added": len(lacking)})
    return found, patches.sigmas[lacking]


def joined_points(model: Model, curves: list[Edges3D], *more: SeenPoints) -> SeenPoints:
    """Points of a model, of curves, and more, one after the other."""
    parts = [SeenPoints.of_model(model), *map(SeenPoints.of_edges, curves), *more]
    return joined_seen(parts)


def polylines_of(curves: list[Edges3D], first: int, num_edges: int) -> Polylines | None:
    """The polylines of curves whose points follow `first` others; None without curves."""
    if not curves:
        return None
    count = first + sum(each.num_points for each in curves)
    return Polylines(
        np.arange(first, count, dtype=np.int32),
        joined_offsets([each.edge_offsets for each in curves]),
        np.concatenate([each.closed for each in curves]),
        num_edges,
    )


def as_model(source: Any) -> Model:
    """Return a `Model` unchanged, convert a pycolmap.Reconstruction, read a path."""
    from colmap_edges.colmap import model as model_module

    if isinstance(source, model_module.Model):
        return source
    if isinstance(source, str | os.PathLike):
        return model_module.load_model(path_of("the path of the model", source))
    return model_module.model_from_reconstruction(source)


def finished(
    mesh_of_indices: Mesh, model: Model, options: MeshingOptions, num_threads: int
) -> Mesh:
    """Add ids and colours of the model's points, and simplify the mesh if requested."""
    mesh = with_model_attributes(mesh_of_indices, model)
    return simplify(mesh, options.max_faces, num_threads) if options.max_faces else mesh


def mesh_points(
    points: FloatArray,
    visibility_offsets: IntArray,
    visibility_cameras: Int32Array,
    camera_centers: FloatArray,
    options: MeshingOptions,
    edges: Polylines | None = None,
    num_threads: int = 0,
    background: BackgroundRays | None = None,
) -> Mesh:
    """Mesh points with their viewing rays.

    Non-finite points are left out; coinciding ones, and nearly so of edges, are merged.

    Args:
        points: (N, 3) float64.
        visibility_offsets: (N + 1,) int64; the cameras that observe point i are
            visibility_cameras[visibility_offsets[i]:visibility_offsets[i + 1]].
        visibility_cameras: (R,) int32 indices into `camera_centers`.
        camera_centers: (C, 3) float64.
        options: meshing options.
        edges: polylines through the points that the mesh should follow.
        num_threads: threads to use, 0 for all cores; the result does not depend on it.
        background: background rays, which pass through free space only.

    Returns:
        The mesh; `point3D_ids` are indices into `points`, -1 for vertices added by the mesher.

    Raises:
        ColmapEdgesError: if the points span no volume or the mesher is not built.
        ValueError: if the arrays are inconsistent.
    """
    extension = load_extension()
    check_extent(points, camera_centers)
    polyline_offsets, polyline_points = closed_rows(edges)
    vertices, faces, sources, on_edges, stats = extension.mesh_points(
        np.ascontiguousarray(points, np.float64).reshape(-1, 3),
        np.ascontiguousarray(visibility_offsets, np.int64),
        np.ascontiguousarray(visibility_cameras, np.int32),
        np.ascontiguousarray(camera_centers, np.float64).reshape(-1, 3),
        polyline_offsets,
        polyline_points,
        *(background if background and options.background_weight else NO_BACKGROUND),
        num_threads=num_threads or os.cpu_count() or 1,
        **values_of(options),
    )
    check_volume(stats, len(points))
    if edges is not None and edges.num_edges is not None:
        on_edges = on_edges[on_edges[:, 2] < edges.num_edges]
    return Mesh(
        vertices=vertices,
        faces=faces,
        point3D_ids=sources[:, 0].astype(np.int64),
        colors=np.zeros(vertices.shape, np.uint8),
        creases=np.ascontiguousarray(on_edges[:, :2]),
        stats=stats,
    )


def values_of(options: MeshingOptions) -> dict[str, Any]:
    """The options of the extension, by name."""
    names = (
        "method",
        "sigma_factor",
        "quality_weight",
        "edge_solid_weight",
        "background_weight",
        "vote_behind",
        "vote_threshold",
        "merge_factor",
        "long_facet_factor",
        "min_component_faces",
    )
    shortest = options.min_segment_factor and max(options.min_segment_factor, FINEST)
    return {name: getattr(options, name) for name in names} | {
        "vote_weights": (options.vote_crossed, options.vote_near, options.vote_far),
        "min_segment_factor": shortest,
    }


def check_extent(points: FloatArray, camera_centers: FloatArray) -> None:
    """Check that cameras are not at infinity, compared with the extent of the points.

    The mesher scales the points to unit size, and products of coordinates must stay finite.

    Raises:
        ColmapEdgesError: if they are.
    """
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite) or not len(camera_centers):
        return
    extent = float(np.ptp(finite, axis=0).max())
    distance = float(np.abs(camera_centers - finite[0]).max())
    if extent and distance > extent * MAX_COORDINATE**2:
        raise ColmapEdgesError(
            f"all {len(finite)} points lie within {extent:.3g} world units, but cameras are up to "
            f"{distance:.3g} away from them; check the units of points and poses"
        )


def check_volume(stats: Mapping[str, float], num_points: int) -> None:
    """Raise `ColmapEdgesError` if the points form no tetrahedron."""
    if not stats["cells"]:
        raise ColmapEdgesError(
            f"nothing to mesh: the {num_points} points span no volume; "
            "give a model with more 3D points"
        )


def closed_rows(edges: Polylines | None) -> tuple[IntArray, Int32Array]:
    """Offsets and point indices of polylines; closed ones end with their first point.

    Raises:
        ValueError: if the arrays are inconsistent.
    """
    if edges is None:
        return np.zeros(1, np.int64), np.zeros(0, np.int32)
    offsets = np.ascontiguousarray(edges.offsets, np.int64)
    indices = np.ascontiguousarray(edges.point_indices, np.int32)
    closed = np.asarray(edges.closed, bool)
    if len(offsets) != len(closed) + 1 or offsets[0] != 0 or offsets[-1] != len(indices):
        raise ValueError(
            f"polylines: {len(offsets)} offsets, up to {offsets[-1:]}, do not fit "
            f"{len(closed)} flags and {len(indices)} points"
        )
    loops = closed & (np.diff(offsets) > 2)
    indices = np.insert(indices, offsets[1:][loops], indices[offsets[:-1][loops]])
    return offsets + np.concatenate([[0], np.cumsum(loops)]), indices
