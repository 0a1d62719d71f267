"""Faces for the output: plane, outlines, area and observing views."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, entries_of
from colmap_edges.images.files import square
from colmap_edges.surfaces.faces.decision import Samples
from colmap_edges.surfaces.faces.hypotheses import Planes

MIN_CELLS = 8  # minimum number of raster cells of a face
MAX_SIDE = 2000  # maximum side of that raster, in cells


@dataclass(frozen=True, kw_only=True)
class Face:
    """A connected piece of a plane seen by views.

    Attributes:
        normal: (3,) unit normal, towards the views.
        offset: normal . x = offset, world units.
        area: area without holes, square world units.
        outline: (P, 3) closed polygon around it.
        holes: closed polygons (P, 3) of its holes.
        views: (V,) indices of the views that see it.
        plane: index of its plane; coplanar faces share it.
    """

    normal: FloatArray
    offset: float
    area: float
    outline: FloatArray
    holes: tuple[FloatArray, ...]
    views: IntArray
    plane: int


def outline_faces(
    samples: Samples, believed: IntArray, planes: Planes, centers: FloatArray
) -> tuple[list[Face], IntArray]:
    """The faces that the believed (B,) samples lie on, plane by plane.

    Returns:
        The faces, and (S,) which of them each sample lies on: -1 for samples that are not believed,
        and for those of pieces that are too small.
    """
    faces: list[Face] = []
    face_ids = np.full(len(samples.points), -1)
    for plane in range(len(planes.offsets)):
        own = believed[samples.planes[believed] == plane]
        if len(own) >= MIN_CELLS:
            found, face_ids[own] = faces_of_plane(samples, own, planes, plane, centers, len(faces))
            faces += found
    return faces, face_ids


def faces_of_plane(
    samples: Samples, own: IntArray, planes: Planes, plane: int, centers: FloatArray, first: int
) -> tuple[list[Face], IntArray]:
    """The connected pieces of one plane, on a raster as fine as its samples' cells.

    Args:
        samples: all samples.
        own: (K,) those that lie on the plane.
        planes: all planes.
        plane: index of the plane.
        centers: (V, 3) of the views.
        first: index of the first face.

    Returns:
        The faces, and the index of the face on which each of the K samples lies, or -1.
    """
    normal, offset = planes.normals[plane], float(planes.offsets[plane])
    basis = np.linalg.svd(normal[None])[2][1:]
    at = samples.points[own] @ basis.T
    low = at.min(axis=0)
    cell = max(float(np.median(samples.sizes[own])), float(np.ptp(at, axis=0).max()) / MAX_SIDE)
    columns, rows = np.floor((at - low) / cell).astype(np.int64).T + 2
    mask = np.zeros((rows.max() + 3, columns.max() + 3), np.uint8)
    mask[rows, columns] = 1
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, square(1)), np.uint8)
    num_pieces, pieces = cv2.connectedComponents(mask, connectivity=4)
    faces: list[Face] = []
    face_ids = np.full(len(own), -1)
    for piece in range(1, num_pieces):
        inside = (pieces == piece).astype(np.uint8)
        if inside.sum() < MIN_CELLS:
            continue
        outline, holes = rings(inside)
        world = [(ring - 1.5) * cell + low for ring in (outline, *holes)]
        polygons = [ring @ basis + offset * normal for ring in world]
        on_piece = pieces[rows, columns] == piece
        face_ids[on_piece] = first + len(faces)
        members = own[on_piece]
        views = np.unique(samples.views[entries_of(samples.offsets, members)]).astype(np.int64)
        away = float(np.mean(centers[views] @ normal - offset))
        sign = 1.0 if away >= 0 else -1.0
        faces.append(
            Face(
                normal=sign * normal,
                offset=sign * offset,
                area=float(inside.sum()) * cell**2,
                outline=polygons[0],
                holes=tuple(polygons[1:]),
                views=views,
                plane=plane,
            )
        )
    return faces, face_ids


def rings(inside: Int32Array) -> tuple[FloatArray, list[FloatArray]]:
    """Outline and holes (P, 2) of a connected piece of a raster, in (column, row) of its cells."""
    contours, tree = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    outer, holes = np.zeros((0, 2)), []
    for contour, (_, _, _, parent) in zip(contours, tree[0], strict=True):
        ring = contour[:, 0].astype(np.float64)
        if parent < 0 and len(ring) >= len(outer):
            outer = ring
        elif parent >= 0:
            holes.append(ring)
    return outer, holes
