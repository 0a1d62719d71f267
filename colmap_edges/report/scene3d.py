"""The 3D viewer's data: cameras, SfM points, edges, faces and mesh as layers for page.js."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array, IntArray, row_numbers
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.errors import counted
from colmap_edges.images.files import encoded
from colmap_edges.report.contents import Contents, Packed, evenly_spread, xyz
from colmap_edges.report.faces3d import closed_rings, largest, triangulated
from colmap_edges.report.packing import coordinates, data_uri
from colmap_edges.report.viewpoint import bounds, viewpoint
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.mesh import Mesh, Texture

# Maximum numbers of drawn items, for small files and smooth display.
MAX_SFM_POINTS = 40_000


def scene_data(contents: Contents) -> tuple[Packed, IntArray]:
    """Make the layers of the 3D view and its first viewpoint.

    Args:
        contents: what to show.

    Returns:
        The data, whose coordinates the page takes relative to `origin`, and the (E + 1,) offsets
        of the edges in their layer.
    """
    model, edges = contents.model, contents.edges
    low, high = bounds(model, edges)
    rows, starts = plotted_rows(edges, 120_000)
    size = float(np.linalg.norm(high - low))
    layers = {"points": sfm_layer(model, low, high), "cameras": cameras_layer(model, size)}
    # Points would clutter the mesh, and one camera is at the first viewpoint.
    layers["points"]["shown"] = contents.mesh is None
    layers["cameras"]["shown"] = contents.mesh is None and not edges
    if contents.mesh is not None:
        layers["mesh"] = mesh_layer(contents.mesh, low, high)
    if contents.faces:
        layers["faces"] = faces_layer(contents.faces, low, high)
    if edges:
        layers["edges"] = edges_layer(edges, rows, low, high)
    aspect = 1.6  # width by height of the window for which the first viewpoint is chosen
    view = viewpoint(contents, aspect)
    first = {"eye": view.eye.tolist(), "focus": view.focus.tolist(), "up": contents.up.tolist()}
    first |= {"aspect": 0.0 if view.is_inside else aspect}
    origin = ((low + high) / 2).tolist()
    return {"origin": origin, "size": size, "view": first, "layers": layers}, starts


def near(points: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Points clipped to a box three times as large as the shown one.

    Points beyond it are not visible, and would reduce the precision of packed coordinates.
    """
    size = high - low
    return np.clip(points, low - size, high + size)


def sfm_layer(model: Model, low: FloatArray, high: FloatArray) -> Packed:
    """The SfM points within the box, in their colours."""
    points = model.points3D_xyz
    inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    inside = inside[evenly_spread(len(inside), MAX_SFM_POINTS)] if len(inside) else inside
    label = f"{len(model.point3D_ids):,} SfM points"
    return {"label": label, "rgb": rgb(model.points3D_rgb[inside]), **xyz(points[inside])}


def cameras_layer(model: Model, size: float) -> Packed:
    """Every camera as a pyramid in its viewing direction, and what the page needs to look along.

    Poses are the camera's axes (right, down, forward) row by row; slopes are half of the image's
    height over the focal length.
    """
    depth = pyramid_depth(model, size)
    lines = np.concatenate([pyramid(view, depth) for view in model.views])
    poses = np.stack([view.rotation for view in model.views])
    slopes = np.array([view.height / 2 / view.focal_px for view in model.views])
    return {
        "label": counted(len(model.views), "camera"),
        "names": [view.name for view in model.views],
        "poses": poses.astype(np.float32).ravel(),
        "slopes": slopes.astype(np.float32),
        **xyz(lines),
    }


def pyramid_depth(model: Model, size: float) -> float:
    """Depth of the camera pyramids, world units, such that neighbours do not overlap.

    Args:
        model: the model with the cameras.
        size: diagonal of the shown box, world units.
    """
    centers = model.camera_centers
    gaps = cKDTree(centers).query(centers, k=2)[0][:, 1]
    return max(min(0.5 * float(np.median(gaps)), 0.04 * size), 0.005 * size)


def pyramid(view: View, depth: float) -> FloatArray:
    """(12, 3) wireframe of a camera with its image plane at `depth`; the last point is NaN."""
    half = 0.5 * depth * np.array([view.width, view.height]) / view.focal_px
    a, b, c, d = (
        np.array([x * half[0], y * half[1], depth]) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    )
    o = np.zeros(3)
    local = np.array([o, a, b, o, c, d, o, a, d, c, b])
    world = (local - view.translation) @ view.rotation
    return np.vstack([world, np.full((1, 3), np.nan)])


def mesh_layer(mesh: Mesh, low: FloatArray, high: FloatArray) -> Packed:
    """The mesh with its texture, or in one colour a vertex, simplified for a browser."""
    # Merging of vertices would tear textures.
    if mesh.texture is not None and len(mesh.faces) <= 300_000:
        return textured_layer(mesh, mesh.texture, low, high)
    vertices, faces, colors = coarser(mesh, 150_000)
    return {
        "label": f"mesh of {counted(len(mesh.faces), 'triangle')}",
        "shown": True,
        "rgb": rgb(colors),
        "corners": faces.astype(np.int32).T.ravel(),
        **xyz(near(vertices, low, high)),
    }


def textured_layer(mesh: Mesh, texture: Texture, low: FloatArray, high: FloatArray) -> Packed:
    """The mesh with its texture, reduced to 2048 pixels."""
    vertices, points, corners = texture.joined(mesh.faces)
    height, width = texture.picture.shape[:2]
    factor = min(2048 / max(height, width), 1.0)
    size = (max(round(factor * width), 1), max(round(factor * height), 1))
    reduced = cv2.resize(texture.picture[:, :, ::-1], size, interpolation=cv2.INTER_AREA)
    places = texture.points[points]
    return {
        "label": f"mesh of {counted(len(mesh.faces), 'triangle')}",
        "shown": True,
        "texture": data_uri("jpeg", encoded(".jpg", reduced)),
        "texture_points": {"x": coordinates(places[:, 0]), "y": coordinates(places[:, 1])},
        "corners": corners.T.ravel(),
        **xyz(near(mesh.vertices[vertices], low, high)),
    }


def faces_layer(faces: Sequence[Face], low: FloatArray, high: FloatArray) -> Packed:
    """Planar faces as polygons in one colour a plane, and their outlines."""
    shown = largest(faces)
    corners, triangles, colors = triangulated(shown)
    lifted = [part for ring in closed_rings(shown) for part in (ring, np.full((1, 3), np.nan))]
    number = f"{len(shown):,} largest of " if len(shown) < len(faces) else ""
    return {
        "label": f"{number}{counted(len(faces), 'planar face')}",
        "shown": False,  # the mesh shows them, too
        "rgb": rgb(colors),
        "corners": triangles.T.ravel(),
        "outlines": xyz(near(np.concatenate(lifted), low, high)),
        **xyz(near(corners, low, high)),
    }


def rgb(colors: ByteArray) -> ByteArray:
    """Colours (N, 3) as planes: all reds, all greens, all blues."""
    return np.asarray(colors, np.uint8).T.ravel()


def coarser(mesh: Mesh, max_faces: int) -> tuple[FloatArray, Int32Array, ByteArray]:
    """Vertices, faces and colours of a mesh simplified by merging vertices within grid cells."""
    vertices, faces, colors = mesh.vertices, mesh.faces, mesh.colors
    if len(faces) <= max_faces:
        return vertices, faces, colors
    sides = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1)
    cell = float(np.median(sides)) * np.sqrt(len(faces) / max_faces)
    while len(faces) > max_faces:
        cells = row_numbers(np.floor(mesh.vertices / cell).astype(np.int64))
        _, first, owner = np.unique(cells, return_index=True, return_inverse=True)
        faces = owner[mesh.faces].astype(np.int32)
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        faces = faces[np.unique(row_numbers(faces), return_index=True)[1]]
        vertices, colors, cell = mesh.vertices[first], mesh.colors[first], 1.3 * cell
    return vertices, faces, colors


def plotted_rows(edges: Edges3D | None, most: int) -> tuple[IntArray, IntArray]:
    """Indices of edge points in drawing order; -1 separates edges.

    Every edge keeps its ends; inner points are thinned evenly if there are too many.

    Returns:
        (R,) indices and the (E + 1,) offsets of the edges.
    """
    if edges is None or edges.num_edges == 0:
        return np.zeros(0, np.int64), np.zeros(1, np.int64)
    step = max(int(np.ceil(edges.num_points / most)), 1)
    parts, starts = [], [0]
    for first, last, closed in zip(
        edges.edge_offsets[:-1], edges.edge_offsets[1:], edges.closed, strict=True
    ):
        inner = np.arange(first, last - 1, step)
        parts.append(np.concatenate([inner, [last - 1], [first] if closed else [], [-1]]))
        starts.append(starts[-1] + len(parts[-1]))
    return np.concatenate(parts).astype(np.int64), np.array(starts, np.int64)


def edges_layer(edges: Edges3D, rows: IntArray, low: FloatArray, high: FloatArray) -> Packed:
    """The 3D edges as lines; the page colours them."""
    points = near(edges.points[rows], low, high)
    points[rows < 0] = np.nan
    return {"label": f"{edges.num_edges:,} 3D edges", "shown": True, **xyz(points)}
