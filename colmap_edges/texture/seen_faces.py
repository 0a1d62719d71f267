"""The views that see each triangle of a mesh: area, hidden share, sharpness and mean colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    Picture,
    offsets_of,
    owners_of,
)
from colmap_edges.core.view import View
from colmap_edges.errors import ImageError
from colmap_edges.images.files import square
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.executors import in_threads
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.texture.pictures import Images

# Share of its depth by which a triangle may lie behind another one that does not hide it, as meshes
# are rough.
DEPTH_TOLERANCE = 0.005
# Pixels of the reduced image around bodies in which what is behind them counts as hidden, since
# outlines of a mesh are not exactly those in the image.
RIM_PX = 3
MIN_SHARE = 0.5  # minimum visible share of a triangle, for a view that may give its texture
MIN_COSINE = 0.02  # minimum cosine of the angle between normal and line of sight
# Depth at which triangles that reach behind a camera are cut, relative to the median depth.
NEAREST = 0.01


class SeenFaces(NamedTuple):
    """Pairs of a triangle and a view that sees it, sorted by triangle, then by view.

    Attributes:
        offsets: (F + 1,) pairs of each triangle.
        views: (C,) views.
        areas: (C,) areas in the image, square pixels.
        shares: (C,) visible shares of the triangles.
        clear: (C,) shares that are `RIM_PX` away from what would hide them.
        slopes: (C,) mean lengths of the image's gradient, gray levels per pixel.
        colors: (C, 3) mean colours, BGR.
    """

    offsets: IntArray
    views: Int32Array
    areas: FloatArray
    shares: FloatArray
    clear: FloatArray
    slopes: FloatArray
    colors: FloatArray

    @property
    def faces(self) -> IntArray:
        """(C,) triangles of the pairs."""
        return owners_of(self.offsets)


def find_seen_faces(
    mesh: Mesh, views: Sequence[View], images: Images, num_threads: int
) -> SeenFaces:
    """Find which views see each triangle; views whose image cannot be read see none."""
    directions = directions_of(mesh)
    parts = in_threads(lambda view: seen_by(mesh, directions, view, images), views, num_threads)
    faces = np.concatenate([rows for rows, _ in parts])
    owners = np.repeat(np.arange(len(parts), dtype=np.int32), [len(rows) for rows, _ in parts])
    order = np.argsort(faces, kind="stable")
    values = np.concatenate([found for _, found in parts])[order]
    offsets = offsets_of(np.bincount(faces, minlength=len(mesh.faces)))
    areas, shares, clear, slopes = values[:, :4].T
    return SeenFaces(offsets, owners[order], areas, shares, clear, slopes, values[:, 4:])


def seen_by(
    mesh: Mesh, directions: tuple[FloatArray, FloatArray], view: View, images: Images
) -> tuple[IntArray, FloatArray]:
    """(N,) triangles that a view sees, and (N, 7) area, shares, slope and mean colour of each."""
    try:
        image, usable = images.reduced(view)
    except ImageError:
        return np.zeros(0, np.int64), np.zeros((0, 7))
    rows, columns = usable.shape
    local = view.cam_from_world(mesh.vertices)
    factor = columns / view.width
    pixels, inverses = projected(view, local, factor)
    points, triangles = cut_in_front(local, mesh.faces)
    nearest = _kernels.draw_depths(*projected(view, points, factor), triangles, rows, columns)
    around = cv2.dilate(nearest, square(RIM_PX))
    areas, shares, means = _kernels.tally_faces(
        *(pixels, inverses, mesh.faces, nearest, around, with_slope(image)),
        *(usable.view(np.uint8), DEPTH_TOLERANCE, RIM_PX),
    )
    seen = np.flatnonzero((shares[:, 0] >= MIN_SHARE) & (cosines(*directions, view) >= MIN_COSINE))
    values = np.column_stack([areas / factor**2, shares, means[:, 3], means[:, :3]])
    return seen, values[seen].astype(float)


def projected(view: View, local: FloatArray, factor: float) -> tuple[FloatArray, FloatArray]:
    """(N, 2) pixels of a reduced image and (N,) inverse depths of (N, 3) camera coordinates.

    Pixels behind the camera or beyond the lens's fold are NaN.
    """
    depths = local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverses = 1 / np.where(depths > 0, depths, np.nan)
        pixels = view.distorted(local * inverses[:, None])
    return np.ascontiguousarray(pixels * factor), inverses


def cut_in_front(local: FloatArray, faces: Int32Array) -> tuple[FloatArray, Int32Array]:
    """Points and triangles in front of a camera; triangles that reach behind it are cut."""
    ahead = local[:, 2][local[:, 2] > 0]
    near = NEAREST * float(np.median(ahead)) if len(ahead) else 1.0
    front = local[:, 2] > near
    count = front[faces].sum(axis=1)
    points, triangles = [local], [faces[count == 3]]
    for number in (1, 2):
        crossing = faces[count == number]
        if not len(crossing):
            continue
        # Turned so that the corner that differs from the other two comes first.
        alone = np.argmax(front[crossing] == (number == 1), axis=1)
        turned = np.take_along_axis(crossing, (alone[:, None] + np.arange(3)) % 3, axis=1)
        a, b, c = local[turned.T]
        cuts = [
            p + (q - p) * ((near - p[:, 2]) / (q[:, 2] - p[:, 2]))[:, None]
            for p, q in ((a, b), (a, c))
        ]
        first = sum(map(len, points)) + np.arange(len(turned))
        second = first + len(turned)
        points += cuts
        if number == 1:
            triangles.append(np.column_stack([turned[:, 0], first, second]))
        else:
            triangles.append(np.column_stack([turned[:, 1], turned[:, 2], first]))
            triangles.append(np.column_stack([turned[:, 2], second, first]))
    return np.concatenate(points), np.concatenate(triangles).astype(np.int32)


def with_slope(image: Picture) -> FloatArray:
    """(h, w, 4) float32: the colours of an image, and the length of its gradient."""
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    across, down = (cv2.Sobel(gray, cv2.CV_32F, *axis, scale=0.125) for axis in ((1, 0), (0, 1)))
    return np.dstack([image.astype(np.float32), cv2.magnitude(across, down)])


def directions_of(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """(F, 3) unit normals of the triangles, and (F, 3) their centres."""
    a, b, c = mesh.vertices[mesh.faces.T]
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    return normals, (a + b + c) / 3


def cosines(normals: FloatArray, centers: FloatArray, view: View) -> FloatArray:
    """(F,) cosines of the angles between the triangles' normals and lines of sight."""
    sights = view.center - centers
    lengths = np.sqrt(np.einsum("nk,nk->n", sights, sights))
    return np.asarray(np.einsum("nk,nk->n", normals, sights) / np.maximum(lengths, 1e-300))
