"""Points and the cameras that see them -> triangle mesh: Python face of the CGAL extension."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from colmap_edges.array_types import BoolArray, ByteArray, FloatArray, Int32Array, IntArray
from colmap_edges.backdrop import BackgroundRays
from colmap_edges.csr import joined_offsets
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import MeshingOptions
from colmap_edges.output import write_whole
from colmap_edges.silhouettes import Background, SeenPoints

if TYPE_CHECKING:
    from colmap_edges.edges import Edges3D
    from colmap_edges.model import Model

NO_BACKGROUND = BackgroundRays(np.zeros(0, np.int32), np.zeros((0, 3)))
# Below this part of a segment's usual length it is split where others cross it ever again, in vain.
FINEST = 0.01
MESH_FORMATS = (".ply", ".obj", ".glb")


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """A triangle mesh whose vertices know the 3D points they came from.

    Attributes:
        vertices: (V, 3) float64, world units.
        faces: (F, 3) int32 indices into `vertices`, counter-clockwise seen from free space.
        point3D_ids: (V,) int64; -1 for edge points and for vertices the mesher added.
        colors: (V, 3) uint8.
        stats: counts of what came in, was kept and was dropped, and seconds per step.
    """

    vertices: FloatArray
    faces: Int32Array
    point3D_ids: IntArray
    colors: ByteArray
    stats: Mapping[str, float] = field(default_factory=dict)


class Polylines(NamedTuple):
    """Polylines through points, in CSR arrays.

    Attributes:
        point_indices: (P,) int32 indices into the points that are meshed.
        offsets: (E + 1,) int64; polyline e is point_indices[offsets[e]:offsets[e + 1]].
        closed: (E,) bool; the last point of a closed polyline connects to its first.
    """

    point_indices: Int32Array
    offsets: IntArray
    closed: BoolArray


def mesh(
    reconstruction_or_path: Any,
    edges: Edges3D | None = None,
    method: str | None = None,
    options: MeshingOptions | None = None,
    num_threads: int = 0,
    background: Background | None = None,
) -> Mesh:
    """Mesh the points of a COLMAP model, with or without 3D edges.

    Args:
        reconstruction_or_path: a model folder, a pycolmap.Reconstruction or a `Model`.
        edges: 3D edges of this model that the mesh should follow.
        method: overrides `options.method`.
        options: how to mesh; the defaults suit any model.
        num_threads: threads to use, 0 for all cores; the result does not depend on it.
        background: what its posed images' sight of the background says, as `reconstruct` finds.

    Raises:
        ColmapEdgesError: when the model cannot be read, holds too little to mesh, or the mesher
            is not built.
    """
    model = as_model(reconstruction_or_path)
    options = options or MeshingOptions()
    if method is not None:
        options = replace(options, method=method)
    curves = [] if edges is None else with_outlines(edges)
    found = mesh_with_curves(model, curves, options, num_threads, background)
    return finished(found, model, options)


def with_outlines(edges: Edges3D) -> list[Edges3D]:
    """The curves that a mesh follows: edges, then outlines where there are any."""
    return [edges] if edges.outlines is None else [edges, edges.outlines]


def mesh_with_curves(
    model: Model,
    curves: list[Edges3D],
    options: MeshingOptions,
    num_threads: int,
    background: Background | None = None,
) -> Mesh:
    """Mesh points of a model, of curves and of silhouettes; vertices hold indices in that order."""
    seen = [SeenPoints(model.points3D_xyz, model.track_offsets, model.track_views)]
    seen += [SeenPoints(each.points, each.track_offsets, each.track_views) for each in curves]
    first, count = len(model.points3D_xyz), sum(len(part.points) for part in seen)
    polylines = Polylines(
        np.arange(first, count, dtype=np.int32),
        joined_offsets([each.edge_offsets for each in curves]),
        np.concatenate([np.zeros(0, bool), *(each.closed for each in curves)]),
    )
    if background and options.background_weight:
        seen.append(background.silhouettes)
    return mesh_points(
        np.concatenate([part.points for part in seen]),
        joined_offsets([part.track_offsets for part in seen]),
        np.concatenate([part.track_views for part in seen]),
        model.camera_centers,
        options,
        polylines if curves else None,
        num_threads,
        background.rays if background else None,
    )


def as_model(source: Any) -> Model:
    """Take a `Model` as it is, a pycolmap.Reconstruction apart, and read anything else."""
    from colmap_edges import model as model_module

    if isinstance(source, model_module.Model):
        return source
    if isinstance(source, str | os.PathLike):
        return model_module.load_model(Path(source))
    return model_module.model_from_reconstruction(source)


def finished(mesh_of_indices: Mesh, model: Model, options: MeshingOptions) -> Mesh:
    """Add what the model knows of the points, then simplify if asked to."""
    mesh = with_model_attributes(mesh_of_indices, model)
    return simplify(mesh, options.max_faces) if options.max_faces else mesh


def with_model_attributes(mesh_of_indices: Mesh, model: Model) -> Mesh:
    """Replace the point indices in `point3D_ids` by the model's ids, and add its colours."""
    sources = mesh_of_indices.point3D_ids
    is_sfm = (sources >= 0) & (sources < len(model.point3D_ids))
    ids = np.full(len(sources), -1, np.int64)
    ids[is_sfm] = model.point3D_ids[sources[is_sfm]]
    colors = np.zeros((len(sources), 3), np.uint8)
    colors[is_sfm] = model.points3D_rgb[sources[is_sfm]]
    colors = spread_colors(colors, is_sfm, mesh_of_indices.faces)
    return replace(mesh_of_indices, point3D_ids=ids, colors=colors)


def spread_colors(colors: ByteArray, is_known: BoolArray, faces: Int32Array) -> ByteArray:
    """Colour unknown vertices by the mean of their known neighbours, ring by ring.

    Args:
        colors: (V, 3) uint8.
        is_known: (V,) which of them are right.
        faces: (F, 3) triangles.

    Returns:
        (V, 3) uint8; vertices that no known vertex is connected to stay as they are.
    """
    values, known = colors.astype(np.float64), is_known.copy()
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    sides = np.unique(np.concatenate([sides, sides[:, ::-1]]), axis=0)
    while True:
        useful = sides[~known[sides[:, 0]] & known[sides[:, 1]]]
        if not len(useful):
            return np.rint(values).astype(np.uint8)
        counts = np.bincount(useful[:, 0], minlength=len(values))
        for channel in range(3):
            weights = values[useful[:, 1], channel]
            sums = np.bincount(useful[:, 0], weights, minlength=len(values))
            values[counts > 0, channel] = sums[counts > 0] / counts[counts > 0]
        known |= counts > 0


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
    """Mesh points that cameras see.

    Points with coordinates that are not finite are left out; coinciding points, and nearly
    coinciding ones of edges, become one that all their cameras see. The result does not depend on
    the order of points and rays, nor on the number of threads.

    Args:
        points: (N, 3) float64.
        visibility_offsets: (N + 1,) int64; the cameras that see point i are
            visibility_cameras[visibility_offsets[i]:visibility_offsets[i + 1]].
        visibility_cameras: (R,) int32 indices into `camera_centers`.
        camera_centers: (C, 3) float64.
        options: how to mesh.
        edges: polylines through the points that the mesh should follow.
        num_threads: threads to use, 0 for all cores; the result does not depend on it.
        background: lines of sight of the cameras that meet nothing.

    Returns:
        The mesh; `point3D_ids` holds indices into `points`, -1 for vertices the mesher added.

    Raises:
        ColmapEdgesError: when the points span no volume or the mesher is not built.
        ValueError: when the arrays do not fit together.
    """
    extension = load_extension()
    polyline_offsets, polyline_points = closed_rows(edges)
    vertices, faces, sources, stats = extension.mesh_points(
        np.ascontiguousarray(points, np.float64).reshape(-1, 3),
        np.ascontiguousarray(visibility_offsets, np.int64),
        np.ascontiguousarray(visibility_cameras, np.int32),
        np.ascontiguousarray(camera_centers, np.float64).reshape(-1, 3),
        polyline_offsets,
        polyline_points,
        *(background if background and options.background_weight else NO_BACKGROUND),
        method=options.method,
        sigma_factor=options.sigma_factor,
        quality_weight=options.quality_weight,
        edge_solid_weight=options.edge_solid_weight,
        background_weight=options.background_weight,
        vote_weights=(options.vote_crossed, options.vote_near, options.vote_far),
        vote_threshold=options.vote_threshold,
        merge_factor=options.merge_factor,
        min_segment_factor=options.min_segment_factor and max(options.min_segment_factor, FINEST),
        long_facet_factor=options.long_facet_factor,
        min_component_faces=options.min_component_faces,
        num_threads=num_threads or os.cpu_count() or 1,
    )
    check_volume(stats, len(points))
    ids, black = sources[:, 0].astype(np.int64), np.zeros((len(vertices), 3), np.uint8)
    return Mesh(vertices=vertices, faces=faces, point3D_ids=ids, colors=black, stats=stats)


def check_volume(stats: Mapping[str, float], num_points: int) -> None:
    """Raise when the points have no tetrahedron between them."""
    if not stats["cells"]:
        raise ColmapEdgesError(
            f"nothing to mesh: the {num_points} points span no volume; "
            "give a model with more 3D points"
        )


def closed_rows(edges: Polylines | None) -> tuple[IntArray, Int32Array]:
    """Offsets and point indices of polylines, the first point repeated at the end of closed ones.

    Raises:
        ValueError: when the arrays do not fit together.
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


def simplify(mesh: Mesh, max_faces: int) -> Mesh:
    """Collapse edges by quadric errors until `max_faces` triangles are left.

    Borders and topology are kept; a manifold stays one. Vertices move, so those of the result
    know no 3D points; each takes the colour of the nearest vertex of `mesh`.

    Raises:
        ColmapEdgesError: when MeshLab fails.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    import pymeshlab
    from scipy.spatial import cKDTree

    # Around the origin and of size 1, where MeshLab's single precision does no harm.
    center = mesh.vertices.mean(axis=0)
    size = float(np.abs(mesh.vertices - center).max())
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh((mesh.vertices - center) / size, mesh.faces))
    try:
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=max_faces, preserveboundary=True, preservetopology=True, autoclean=False
        )
        meshes.meshing_remove_unreferenced_vertices()
    except pymeshlab.PyMeshLabException as error:
        raise ColmapEdgesError(f"MeshLab cannot simplify to {max_faces} faces: {error}") from error
    current = meshes.current_mesh()
    vertices = current.vertex_matrix() * size + center
    nearest = cKDTree(mesh.vertices).query(vertices)[1]
    return replace(
        mesh,
        vertices=vertices,
        faces=np.ascontiguousarray(current.face_matrix(), np.int32),
        point3D_ids=np.full(len(vertices), -1, np.int64),
        colors=mesh.colors[nearest],
        stats={**mesh.stats, "faces_before_simplification": len(mesh.faces)},
    )


def load_extension() -> Any:
    """Import the compiled mesher.

    Raises:
        ColmapEdgesError: when it was not built.
    """
    try:
        from colmap_edges import _mesher  # type: ignore[attr-defined, unused-ignore]
    except ImportError as error:
        raise ColmapEdgesError(
            f"the mesher is not built ({error}); "
            "run: apt-get install libcgal-dev, then reinstall colmap-edges"
        ) from error
    return _mesher


def write_mesh(mesh: Mesh, path: Path | str) -> None:
    """Write a mesh with colours as PLY, OBJ or GLB: the whole file or none.

    Raises:
        ColmapEdgesError: when the suffix is another one or the file cannot be written.
    """
    import trimesh

    path = Path(path)
    if path.suffix.lower() not in MESH_FORMATS:
        raise ColmapEdgesError(
            f"cannot write a mesh as {path.name!r}; choose one of: {', '.join(MESH_FORMATS)}"
        )
    exported = trimesh.Trimesh(
        mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False, validate=False
    ).export(file_type=path.suffix.lower()[1:])
    data = exported.encode() if isinstance(exported, str) else exported
    write_whole(path, data, "mesh")
