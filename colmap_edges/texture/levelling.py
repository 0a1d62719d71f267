"""Levelling of seams: smooth corrections of charts, equal on both sides of their borders.

Waechter, Moehrle and Goesele, Let there be color! (ECCV 2014), section 4.3.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import cg

from colmap_edges.core.arrays import (
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    blocks,
    robust_sigma,
)
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.texture.atlas import Atlas


def level(atlas: Atlas, pairs: Int32Array, sides: IntArray) -> None:
    """Correct an atlas so that colours agree along seams, and blank what no triangle shows.

    Args:
        atlas: the atlas.
        pairs: (P, 2) neighbouring triangles.
        sides: (P, 2) vertices of their common sides.
    """
    charts = atlas.charts
    ends = ends_of(atlas, pairs, sides)
    corrections = solved(atlas, ends) if len(ends) else np.zeros((len(charts.charts), 3))
    is_seen = charts.views[charts.owners] >= 0
    corners = charts.corners[is_seen]
    covered = np.zeros(atlas.packing.shape, np.uint8)
    values = corrections.astype(np.float32)[corners]
    _kernels.add_colors(atlas.pixels[corners], values, 2.0, atlas.picture, covered)
    blank(atlas, covered)


def ends_of(atlas: Atlas, pairs: Int32Array, sides: IntArray) -> IntArray:
    """(S, 2, 2) the points of seams: in both charts, those of both ends."""
    charts = atlas.charts
    owners = charts.owners[pairs]
    seams = (owners[:, 0] != owners[:, 1]) & (charts.views[owners] >= 0).all(axis=1)
    triangles, vertices = pairs[seams], sides[seams]
    found = np.zeros((len(triangles), 2, 2), np.int64)
    for side in range(2):
        corners = charts.corners[triangles[:, side]]
        for end in range(2):
            which = charts.vertices[corners] == vertices[:, end, None]
            found[:, side, end] = corners[np.arange(len(corners)), which.argmax(axis=1)]
    return found


def solved(atlas: Atlas, ends: IntArray) -> FloatArray:
    """(N, 3) corrections of the points of an atlas."""
    charts, count = atlas.charts, len(atlas.charts.charts)
    seams = np.concatenate([ends[:, :, 0], ends[:, :, 1]])
    differences = np.concatenate(seam_differences(atlas, ends))
    inner = np.unique(np.sort(charts.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    rows = np.concatenate([seams, inner])
    trusted = trust(differences)
    # Corrections equal along a chart's sides weigh as much as equal colours at a seam.
    weights = np.concatenate([trusted, np.ones(len(inner))])
    between = coo_array((weights, rows.T), (count, count)).tocsr()
    between = between + between.T
    # Each point has a small weight of no correction.
    degrees = np.asarray(between.sum(axis=1)).ravel() + 0.01
    system, scale = (diags_array(degrees) - between).tocsr(), diags_array(1 / degrees)
    found = np.zeros((count, 3))
    for channel, wanted in enumerate(differences.T):
        forces = trusted * wanted
        side = np.bincount(seams[:, 0], forces, count) - np.bincount(seams[:, 1], forces, count)
        found[:, channel] = cg(system, side, rtol=1e-3, maxiter=1000, M=scale)[0]
    return found


def trust(differences: FloatArray) -> FloatArray:
    """(S,) weights of seams: small where the views show different things and not another light."""
    sizes = np.abs(differences).max(axis=1)
    scale = max(robust_sigma(sizes), 2.0)
    return np.asarray(1 / (1 + (sizes / scale) ** 2))


def seam_differences(atlas: Atlas, ends: IntArray) -> tuple[FloatArray, FloatArray]:
    """(S, 3) by how much more the second chart has than the first, at both ends of each seam."""
    weights = np.linspace(1, 0, 9)
    sums = [np.zeros((len(ends), 3)), np.zeros((len(ends), 3))]
    for share in weights.tolist():
        first, second = (sampled(atlas, ends[:, side], share) for side in range(2))
        for end, weight in enumerate((share, 1 - share)):
            sums[end] += weight * (second - first) / weights.sum()
    return sums[0], sums[1]


def sampled(atlas: Atlas, ends: IntArray, share: float) -> FloatArray:
    """(S, 3) colours between two points of a chart, (S, 2)."""
    at = share * atlas.pixels[ends[:, 0]] + (1 - share) * atlas.pixels[ends[:, 1]]
    return np.asarray(_kernels.bilinear(atlas.picture, at - 0.5), np.float64)


def blank(atlas: Atlas, covered: ByteArray) -> None:
    """Give what lies between triangles the mean colour, which needs few bytes."""
    for chart in np.flatnonzero(atlas.charts.views < 0).tolist():
        (x, y), (width, height) = atlas.packing.places[chart], atlas.packing.sizes[chart]
        covered[y : y + height, x : x + width] = 1
    if covered.any():
        mean = np.rint(cv2.mean(atlas.picture, covered)[:3]).astype(np.uint8)
        for rows in blocks(len(covered), 64):
            plain = np.broadcast_to(mean, atlas.picture[rows].shape).copy()
            cv2.copyTo(plain, (covered[rows] == 0).view(np.uint8), atlas.picture[rows])
