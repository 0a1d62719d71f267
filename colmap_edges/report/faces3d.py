"""Planar faces as triangles and outlines, for the 3D viewers."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array
from colmap_edges.core.polylines import plane_basis
from colmap_edges.surfaces.faces.outlines import Face

MAX_SHOWN = 500  # maximum number of faces shown, largest first


def largest(faces: Sequence[Face]) -> list[Face]:
    """The `MAX_SHOWN` largest faces."""
    return sorted(faces, key=lambda face: -face.area)[:MAX_SHOWN]


def triangulated(faces: Sequence[Face]) -> tuple[FloatArray, Int32Array, ByteArray]:
    """Triangles that cover faces without their holes.

    Returns:
        (V, 3) corners in world units, (T, 3) int32 indices, and (V, 3) uint8 RGB, one colour
        per plane.
    """
    if not faces:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8)
    every = np.concatenate([face.outline for face in faces])
    step = float(np.linalg.norm(np.ptp(every, axis=0))) / 1000
    corners = [trapezoids(face, step) for face in faces]
    counts = [len(each) for each in corners]
    shades = np.repeat([color_of(face.plane) for face in faces], counts, axis=0)
    first = np.arange(sum(counts), dtype=np.int32).reshape(-1, 4)
    triangles = first[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return np.concatenate(corners), triangles, shades.astype(np.uint8)


def trapezoids(face: Face, step: float) -> FloatArray:
    """(4 K, 3) corners of trapezoids that cover a face, cut by parallel lines through its corners.

    Args:
        face: face with outline and holes (even-odd rule).
        step: grid to which corners are rounded in one direction, world units.
    """
    basis = plane_basis(face.normal)
    rings = [ring @ basis.T for ring in (face.outline, *face.holes)]
    starts = np.concatenate(rings)
    ends = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    for side in (starts, ends):
        side[:, 1] = np.rint(side[:, 1] / step) * step
    upwards = starts[:, 1] < ends[:, 1]
    low, high = np.where(upwards[:, None], [starts, ends], [ends, starts])
    levels = np.unique(starts[:, 1])
    found = [np.zeros((0, 4, 2))]
    for bottom, top in pairwise(levels):
        through = (low[:, 1] <= bottom) & (high[:, 1] >= top)
        a, b = low[through], high[through]
        slope = (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
        at = a[:, :1] + slope[:, None] * (np.array([bottom, top]) - a[:, 1:])
        at = at[np.argsort(at.sum(axis=1), kind="stable")]
        left, right = at[0::2], at[1::2]
        x = np.stack([left[:, 0], right[:, 0], right[:, 1], left[:, 1]], axis=1)
        y = np.broadcast_to([bottom, bottom, top, top], x.shape)
        found.append(np.stack([x, y], axis=2))
    flat = np.concatenate(found).reshape(-1, 2)
    return np.asarray(flat @ basis + face.offset * face.normal)


def color_of(plane: int) -> ByteArray:
    """(3,) RGB of a plane's faces; planes with successive numbers differ."""
    # Successive multiples of the golden ratio are far apart on the hue circle.
    color = colorsys.hsv_to_rgb(plane * 0.618034 % 1, 0.55, 1)
    return np.rint(np.multiply(255, color)).astype(np.uint8)


def closed_rings(faces: Sequence[Face]) -> list[FloatArray]:
    """Outlines and holes, each with its first point repeated at the end."""
    rings = [ring for face in faces for ring in (face.outline, *face.holes)]
    return [np.concatenate([ring, ring[:1]]) for ring in rings]
