"""A still picture of the scene from the first viewpoint of the page's 3D view."""

from __future__ import annotations

import cv2
import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray, IntArray, Picture
from colmap_edges.images.files import encoded
from colmap_edges.report.contents import Contents
from colmap_edges.report.overlay import SHIFT
from colmap_edges.report.scene3d import MAX_SFM_POINTS, coarser
from colmap_edges.report.viewpoint import FOV, Viewpoint, viewpoint

SIZE_PX = (1280, 800)  # width and height
FINER = 2  # supersampling factor
EDGE_BGR = (40, 60, 225)
WEBP = [cv2.IMWRITE_WEBP_QUALITY, 85]


def still_picture(contents: Contents) -> bytes:
    """The picture of a scene on white, WebP: its mesh or SfM points, and its 3D edges."""
    width, height = (FINER * side for side in SIZE_PX)
    canvas: Picture = np.full((height, width, 3), 255, np.uint8)
    view = viewpoint(contents, width / height)
    if contents.mesh is None:
        draw_points(canvas, contents, view)
    draw_faces_and_edges(canvas, contents, view)
    reduced = cv2.resize(canvas, SIZE_PX, interpolation=cv2.INTER_AREA)
    return encoded(".webp", reduced, WEBP)


def projected(
    points: FloatArray, view: Viewpoint, shape: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) and depths (N,) of points; NaN behind the eye or far outside the picture."""
    right, down, depth = ((points - view.eye) @ view.axes.T).T
    near = 1e-3 * float(np.linalg.norm(view.focus - view.eye))
    depth = np.where(depth > near, depth, np.nan)
    focal = shape[0] / 2 / np.tan(FOV / 2)
    pixels = focal * np.stack([right, down], axis=1) / depth[:, None]
    pixels += np.array([shape[1], shape[0]]) / 2
    pixels[(np.abs(pixels) > 20 * shape[1]).any(axis=1)] = np.nan  # beyond OpenCV's coordinates
    return pixels, depth


def draw_points(canvas: Picture, contents: Contents, view: Viewpoint) -> None:
    """Draw SfM points as dots of their colours."""
    model = contents.model
    step = max(len(model.points3D_xyz) // MAX_SFM_POINTS, 1)
    pixels, depths = projected(model.points3D_xyz[::step], view, canvas.shape)
    colors = model.points3D_rgb[::step, ::-1]
    for row in np.argsort(-depths)[: np.isfinite(pixels[:, 0]).sum()]:
        center = tuple(int(x) for x in np.nan_to_num(pixels[row]))
        cv2.circle(canvas, center, FINER, tuple(map(int, colors[row])), -1)


def draw_faces_and_edges(canvas: Picture, contents: Contents, view: Viewpoint) -> None:
    """Draw triangles and edge segments from far to near (painter's algorithm)."""
    shapes, colors, depths = shaded_faces(contents, view, canvas.shape)
    lines, line_depths = edge_segments(contents, view, canvas.shape)
    # Edges are drawn in front of their surfaces.
    order = np.argsort(-np.concatenate([depths, 0.995 * line_depths]), kind="stable")
    corners, fills, ends = list(fixed_point(shapes)), colors.tolist(), fixed_point(lines).tolist()
    for index in order.tolist():
        if index < len(corners):
            cv2.fillConvexPoly(canvas, corners[index], fills[index], cv2.LINE_8, SHIFT)
        else:
            first, last = ends[index - len(corners)]
            cv2.line(canvas, first, last, EDGE_BGR, 2 * FINER, cv2.LINE_8, SHIFT)


def fixed_point(pixels: FloatArray) -> IntArray:
    """Pixels in OpenCV's fixed-point drawing coordinates."""
    return np.rint(pixels * (1 << SHIFT)).astype(np.int32)


def shaded_faces(
    contents: Contents, view: Viewpoint, shape: tuple[int, ...]
) -> tuple[FloatArray, ByteArray, FloatArray]:
    """Visible triangles: pixels (F, 3, 2), shaded colours (F, 3) BGR, and depths."""
    if contents.mesh is None or len(contents.mesh.faces) == 0:
        return np.zeros((0, 3, 2)), np.zeros((0, 3), np.uint8), np.zeros(0)
    vertices, faces, colors = coarser(contents.mesh, 60_000)
    pixels, depths = projected(vertices, view, shape)
    faces = faces[in_sight(pixels[faces], shape)]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    towards = view.eye - a
    cosines = np.abs(np.einsum("ij,ij->i", normals, towards)) / (
        np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1) + 1e-300
    )
    lit = colors[faces].mean(axis=1) * (0.45 + 0.55 * cosines[:, None])
    return pixels[faces], lit[:, ::-1].astype(np.uint8), depths[faces].mean(axis=1)


def edge_segments(
    contents: Contents, view: Viewpoint, shape: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Visible segments of 3D edges: pixels (S, 2, 2) and depths (S,)."""
    if contents.edges is None or contents.edges.num_points == 0:
        return np.zeros((0, 2, 2)), np.zeros(0)
    pixels, depths = projected(contents.edges.points, view, shape)
    segments = contents.edges.segments
    segments = segments[in_sight(pixels[segments], shape)]
    return pixels[segments], depths[segments].mean(axis=1)


def in_sight(pixels: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    """(N,) whether triangles or segments (N, K, 2) overlap a picture of `shape`."""
    low, high = pixels.min(axis=1), pixels.max(axis=1)
    return np.asarray(((high >= 0) & (low <= np.array([shape[1], shape[0]]))).all(axis=1))
