"""The 3D viewer: cameras, SfM points, edges and mesh as traces of plotly.js."""

from __future__ import annotations

import html
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.report.contents import Contents, Trace, evenly_spread, hex_colors, typed, xyz
from colmap_edges.surfaces.mesh import Mesh

# What is drawn at most, so that the file stays small and a browser turns it smoothly.
MAX_SFM_POINTS = 40_000
MAX_EDGE_POINTS = 120_000
MAX_FACES = 150_000
HIDDEN_AXIS = {"visible": False, "showspikes": False}


def scene_figure(contents: Contents) -> tuple[Trace, IntArray]:
    """Make the 3D figure.

    Args:
        contents: what to show.

    Returns:
        The figure with its traces and layout, and (E + 1,) where each edge starts in the
        trace of the edges.
    """
    model, edges = contents.model, contents.edges
    low, high = bounds(model, edges)
    points = sfm_trace(model, low, high)
    rows, starts = plotted_rows(edges, MAX_EDGE_POINTS)
    traces = [points, cameras_trace(model, float(np.linalg.norm(high - low)))]
    if contents.mesh is not None:
        traces.append(mesh_trace(contents.mesh, hidden=edges is not None))
    if edges is not None:
        traces += [edges_trace(edges, rows, starts), edges_legend(edges), selection_trace()]
    return {"data": traces, "layout": layout(model, edges, low, high)}, starts


def bounds(model: Model, edges: Edges3D | None) -> tuple[FloatArray, FloatArray]:
    """Corners of the box that is shown: cameras, edges, and SfM points but for the farthest."""
    parts = [model.camera_centers]
    for points in (model.points3D_xyz, edges.points if edges else np.zeros((0, 3))):
        if len(points):
            low, high = np.percentile(points, [2, 98], axis=0)
            margin = 0.15 * (high - low)
            parts.append(np.stack([low - margin, high + margin]))
    corners = np.concatenate(parts)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.02 * float((high - low).max()) + 1e-9
    return low - margin, high + margin


def sfm_trace(model: Model, low: FloatArray, high: FloatArray) -> Trace:
    """The SfM points within the box, in their colours."""
    points = model.points3D_xyz
    inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    inside = inside[evenly_spread(len(inside), MAX_SFM_POINTS)] if len(inside) else inside
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": f"SfM points ({len(model.point3D_ids):,})",
        "marker": {"size": 1.5, "color": hex_colors(model.points3D_rgb[inside])},
        "hoverinfo": "skip",
        **xyz(points[inside]),
    }


def cameras_trace(model: Model, size: float) -> Trace:
    """Every camera as a pyramid towards what it sees."""
    depth = pyramid_depth(model, size)
    lines = np.concatenate([pyramid(view, depth) for view in model.views])
    names = [html.escape(view.name) for view in model.views]
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": f"cameras ({len(model.views)})",
        "line": {"color": "#d9534f", "width": 1.5},
        "text": [name for name in names for _ in range(len(lines) // len(names))],
        "hovertemplate": "%{text}<extra></extra>",
        **xyz(lines),
    }


def pyramid_depth(model: Model, size: float) -> float:
    """How deep cameras are drawn, world units, so that neighbours are told apart.

    Args:
        model: has the cameras.
        size: diagonal of the box that is shown, world units.
    """
    centers = model.camera_centers
    gaps = cKDTree(centers).query(centers, k=2)[0][:, 1]
    return max(min(0.5 * float(np.median(gaps)), 0.04 * size), 0.005 * size)


def pyramid(view: View, depth: float) -> FloatArray:
    """(12, 3) line from the centre around the image plane at `depth`; its last point is NaN."""
    half = 0.5 * depth * np.array([view.width, view.height]) / view.focal_px
    a, b, c, d = (
        np.array([x * half[0], y * half[1], depth]) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    )
    o = np.zeros(3)
    local = np.array([o, a, b, o, c, d, o, a, d, c, b])
    world = (local - view.translation) @ view.rotation
    return np.vstack([world, np.full((1, 3), np.nan)])


def mesh_trace(mesh: Mesh, hidden: bool) -> Trace:
    """The mesh, coarser where it has more faces than a browser should turn."""
    vertices, faces, colors = coarser(mesh, MAX_FACES)
    return {
        "type": "mesh3d",
        "name": f"mesh ({len(mesh.faces):,} faces)",
        "showlegend": True,
        "visible": "legendonly" if hidden else True,
        "vertexcolor": hex_colors(colors),
        "flatshading": True,
        "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
        "hoverinfo": "skip",
        **xyz(vertices),
        **{key: typed(faces[:, i], "i4") for i, key in enumerate("ijk")},
    }


def coarser(mesh: Mesh, max_faces: int) -> tuple[FloatArray, Int32Array, ByteArray]:
    """Vertices, faces and colours of a mesh, vertices merged by cells until few faces are left."""
    vertices, faces, colors = mesh.vertices, mesh.faces, mesh.colors
    if len(faces) <= max_faces:
        return vertices, faces, colors
    sides = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1)
    cell = float(np.median(sides)) * np.sqrt(len(faces) / max_faces)
    while len(faces) > max_faces:
        cells = np.floor(mesh.vertices / cell).astype(np.int64)
        _, first, owner = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        faces = owner.reshape(-1)[mesh.faces].astype(np.int32)
        sides_differ = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        faces = np.unique(faces[sides_differ], axis=0)
        vertices, colors, cell = mesh.vertices[first], mesh.colors[first], 1.3 * cell
    return vertices, faces, colors


def plotted_rows(edges: Edges3D | None, most: int) -> tuple[IntArray, IntArray]:
    """Edge points in the order in which lines run through them; -1 lifts the pen.

    Every edge keeps its ends; inner points are thinned evenly where there are too many.

    Returns:
        (R,) rows and (E + 1,) where each edge starts among them.
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


def edges_trace(edges: Edges3D, rows: IntArray, starts: IntArray) -> Trace:
    """The 3D edges as one trace of lines; the page colours them."""
    points = edges.points[rows] if len(rows) else np.zeros((0, 3))
    points[rows < 0] = np.nan
    return {
        "type": "scatter3d",
        "mode": "lines",
        "legendgroup": "edges",
        "showlegend": False,
        "line": {"width": 3, "colorscale": "Viridis", "color": typed(np.zeros(len(rows)))},
        "customdata": typed(np.repeat(np.arange(edges.num_edges), np.diff(starts)), "i4"),
        "hovertemplate": "edge %{customdata}<extra></extra>",
        "meta": "edges",
        **xyz(points),
    }


def edges_legend(edges: Edges3D) -> Trace:
    """What stands for the edges in the legend, where lines of many colours would be black."""
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": f"edges ({edges.num_edges:,})",
        "legendgroup": "edges",
        "line": {"width": 3, "color": "#35b779"},
        "hoverinfo": "skip",
        **xyz(np.full((1, 3), np.nan)),
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
        "showlegend": False,
        "meta": "chosen",
        **xyz(np.full((1, 3), np.nan)),
    }


def layout(model: Model, edges: Edges3D | None, low: FloatArray, high: FloatArray) -> Trace:
    """Box, first viewpoint and legend of the 3D figure."""
    scale = float((high - low).max())
    subject = edges.points if edges is not None and edges.num_points else model.points3D_xyz
    subject = subject if len(subject) else model.camera_centers
    focus = np.median(subject, axis=0)
    reach = np.percentile(np.linalg.norm(subject - focus, axis=1), 90)
    outward = model.camera_centers.mean(axis=0) - focus
    outward /= max(float(np.linalg.norm(outward)), 1e-12)
    up = up_direction(model)
    center = (focus - (low + high) / 2) / scale
    eye = center + outward * max(2.6 * float(reach) / scale, 0.05)
    axes = {f"{a}axis": {**HIDDEN_AXIS, "range": [low[i], high[i]]} for i, a in enumerate("xyz")}
    return {
        "scene": {
            **axes,
            "aspectmode": "manual",
            "aspectratio": vector((high - low) / scale),
            "camera": {"center": vector(center), "eye": vector(eye), "up": vector(up)},
            "dragmode": "orbit",
        },
        "legend": {"orientation": "h", "y": 1.0, "itemsizing": "constant"},
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": "#101418",
        "font": {"color": "#e8e8e8"},
        "uirevision": "kept",
    }


def up_direction(model: Model) -> FloatArray:
    """(3,) direction in the world that is upwards in the images on average."""
    up: FloatArray = -np.array([view.rotation[1] for view in model.views]).mean(axis=0)
    return up


def vector(values: Any) -> dict[str, float]:
    """Three numbers by the names of the axes."""
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}
