"""The 3D viewer: cameras, SfM points, edges and mesh as traces of plotly.js."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array, IntArray, row_numbers
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.errors import counted
from colmap_edges.report.contents import Contents, Trace, evenly_spread, xyz
from colmap_edges.report.faces3d import closed_rings, largest, triangulated
from colmap_edges.report.viewpoint import bounds, viewpoint
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.mesh import Mesh

# Maximum numbers of drawn items, for small files and smooth display.
MAX_SFM_POINTS = 40_000
ASPECT = 1.6  # aspect ratio (width by height) for which the first viewpoint is chosen


def scene_figure(contents: Contents) -> tuple[Trace, IntArray]:
    """Make the 3D figure.

    Args:
        contents: what to show.

    Returns:
        The figure with its traces and layout, and the (E + 1,) offsets of the edges in their
        trace.
    """
    model, edges = contents.model, contents.edges
    low, high = bounds(model, edges)
    rows, starts = plotted_rows(edges, 120_000)
    size = float(np.linalg.norm(high - low))
    traces = [sfm_trace(model, low, high), cameras_trace(model, size)]
    has_edges = edges is not None and edges.num_edges > 0
    # Points would clutter the mesh, and one camera is at the first viewpoint.
    traces[0]["visible"] = contents.mesh is None
    traces[1]["visible"] = contents.mesh is None and not has_edges
    if contents.mesh is not None:
        traces.append(mesh_trace(contents.mesh, low, high))
    if contents.faces:
        traces += face_traces(contents.faces, low, high)
    if edges is not None and has_edges:
        traces += [edges_trace(edges, rows, low, high), selection_trace()]
    return {"data": traces, "layout": layout(contents, low, high)}, starts


def near(points: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Points clipped to a box three times as large as the shown one.

    Points beyond it are not visible, and would reduce the precision of packed coordinates.
    """
    size = high - low
    return np.clip(points, low - size, high + size)


def sfm_trace(model: Model, low: FloatArray, high: FloatArray) -> Trace:
    """The SfM points within the box, in their colours."""
    points = model.points3D_xyz
    inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    inside = inside[evenly_spread(len(inside), MAX_SFM_POINTS)] if len(inside) else inside
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": f"{len(model.point3D_ids):,} SfM points",
        "meta": "points",
        "marker": {"size": 1.5, "color": {"rgb": rgb(model.points3D_rgb[inside])}},
        "hoverinfo": "skip",
        **xyz(points[inside]),
    }


def cameras_trace(model: Model, size: float) -> Trace:
    """Every camera as a pyramid in its viewing direction."""
    depth = pyramid_depth(model, size)
    lines = np.concatenate([pyramid(view, depth) for view in model.views])
    names = [html.escape(view.name) for view in model.views]
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": counted(len(model.views), "camera"),
        "meta": "cameras",
        "line": {"color": "#d9534f", "width": 1.5},
        "text": [name for name in names for _ in range(len(lines) // len(names))],
        "hovertemplate": "%{text}<extra></extra>",
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


def mesh_trace(mesh: Mesh, low: FloatArray, high: FloatArray) -> Trace:
    """The mesh, simplified if it has too many faces for a browser."""
    vertices, faces, colors = coarser(mesh, 150_000)
    return {
        "type": "mesh3d",
        "name": f"mesh of {counted(len(mesh.faces), 'triangle')}",
        "meta": "mesh",
        "vertexcolor": {"rgb": rgb(colors)},
        "flatshading": True,
        "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
        "hoverinfo": "skip",
        **xyz(near(vertices, low, high)),
        **{key: faces[:, i].astype(np.int32) for i, key in enumerate("ijk")},
    }


def face_traces(faces: Sequence[Face], low: FloatArray, high: FloatArray) -> list[Trace]:
    """Planar faces as translucent polygons in one colour a plane, and their outlines."""
    shown = largest(faces)
    corners, triangles, colors = triangulated(shown)
    lifted = [part for ring in closed_rings(shown) for part in (ring, np.full((1, 3), np.nan))]
    number = f"{len(shown):,} largest of " if len(shown) < len(faces) else ""
    polygons: Trace = {
        "type": "mesh3d",
        "name": f"{number}{counted(len(faces), 'planar face')}",
        "meta": "faces",
        "visible": False,  # the mesh shows them, too
        "opacity": 0.5,
        "vertexcolor": {"rgb": rgb(colors)},
        "flatshading": True,
        "lighting": {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0},
        "hoverinfo": "skip",
        **xyz(near(corners, low, high)),
        **{key: triangles[:, i] for i, key in enumerate("ijk")},
    }
    outlines: Trace = {
        "type": "scatter3d",
        "mode": "lines",
        "name": "outlines of faces",
        "meta": "outlines",
        "visible": False,
        "line": {"color": "#ffffff", "width": 2},
        "hoverinfo": "skip",
        **xyz(near(np.concatenate(lifted), low, high)),
    }
    return [polygons, outlines]


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


def edges_trace(edges: Edges3D, rows: IntArray, low: FloatArray, high: FloatArray) -> Trace:
    """The 3D edges as one trace of lines; the page colours them."""
    points = near(edges.points[rows], low, high)
    points[rows < 0] = np.nan
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": f"{edges.num_edges:,} 3D edges",
        "meta": "edges",
        "line": {"width": 4, "colorscale": "Viridis"},
        "hovertemplate": "edge %{customdata}<extra></extra>",
        **xyz(points),
    }


def selection_trace() -> Trace:
    """The edge that was clicked; the page fills it."""
    return {
        "type": "scatter3d",
        "mode": "lines+markers",
        "name": "chosen edge",
        "line": {"width": 8, "color": "#ff00a8"},
        "marker": {"size": 2.5, "color": "#ff00a8"},
        "hoverinfo": "skip",
        "meta": "chosen",
        **xyz(np.full((1, 3), np.nan)),
    }


def layout(contents: Contents, low: FloatArray, high: FloatArray) -> Trace:
    """Box and first viewpoint of the 3D figure; the page has controls for layers and colours."""
    scale, middle = float((high - low).max()), (low + high) / 2
    view = viewpoint(contents, ASPECT)
    camera = {
        "center": vector((view.focus - middle) / scale),
        "eye": vector((view.eye - middle) / scale),
        "up": vector(view.up),
    }
    axes = {
        f"{axis}axis": {"visible": False, "showspikes": False, "range": [low[i], high[i]]}
        for i, axis in enumerate("xyz")
    }
    aspect = {"aspectmode": "manual", "aspectratio": vector((high - low) / scale)}
    return {
        "scene": {**axes, **aspect, "camera": camera, "dragmode": "orbit"},
        "showlegend": False,
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": "#101418",
        "font": {"color": "#e8e8e8"},
        "uirevision": "kept",
        "meta": {"aspect": 0.0 if view.is_inside else ASPECT},
    }


def vector(values: Any) -> dict[str, float]:
    """Three numbers as a mapping with the axes' names."""
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}
