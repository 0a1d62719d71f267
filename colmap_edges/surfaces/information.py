"""How well the points of a mesh were measured: the inverse covariance of each (information)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import Float32Array, FloatArray, Int32Array, IntArray, owners_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View, track_residuals, views_with_rows

# The elements of a symmetric matrix, in the order in which they are kept.
ROWS, COLUMNS = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])
DIAGONAL = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
# Least standard deviation of an observation: pixels are rounded, and models made by hand have no
# residuals.
MIN_NOISE_PX = 0.05
MIN_COSINE = 0.17  # between a ray and a normal, 80 degrees; beyond, the surface is hardly measured


class Tracks(NamedTuple):
    """N points with their observations.

    Attributes:
        points: (N, 3) float64, world units.
        offsets: (N + 1,) int64; observations of point i are rows offsets[i]:offsets[i + 1].
        views: (T,) int32 indices into the views.
        pixels: (T, 2) float64 observed image pixels.
        normals: (T, 2) float32 directions across which a view observes an edge, NaN if unknown;
            None for points that are observed in both directions.
    """

    points: FloatArray
    offsets: IntArray
    views: Int32Array
    pixels: FloatArray
    normals: Float32Array | None = None

    @classmethod
    def of_model(cls, model: Model) -> Tracks:
        """The tracks of SfM points."""
        return cls(model.points3D_xyz, model.track_offsets, model.track_views, model.track_points2D)

    @classmethod
    def of_edges(cls, edges: Edges3D) -> Tracks:
        """The tracks of edge points."""
        seen = edges.observations
        return cls(edges.points, seen.offsets, seen.views, seen.pixels, seen.normals)


def information_of(views: Sequence[View], tracks: Tracks) -> FloatArray:
    """(N, 6) information of points, by the noise of all of them and the views of each.

    It is the sum of J^T J / sigma^2 over the track, with the derivatives J of the projection. A
    point of an edge is measured across the edge only. Elements are xx, xy, xz, yy, yz, zz.
    """
    found = np.zeros((len(tracks.points), 6))
    owners = owners_of(tracks.offsets)
    for view, rows in views_with_rows(views, tracks.views):
        if len(rows):
            normals = None if tracks.normals is None else tracks.normals[rows]
            # Two observations of a point in one view count once: they are of the same pixels.
            found[owners[rows]] += measured_by(view, tracks.points[owners[rows]], normals)
    found /= noise_px(views, tracks) ** 2
    if tracks.normals is not None:
        # Views do not measure the direction along an edge.
        found += 0.1 * mean_of(found)[:, None] * DIAGONAL
    return found


def measured_by(view: View, points: FloatArray, normals: Float32Array | None) -> FloatArray:
    """(N, 6) products J^T J of a view, or of its derivatives across edges; 0 behind the camera."""
    local = view.cam_from_world(points)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
        scale = view.focal_px / view.scale / local[:, 2]
    forward = view.rotation[2]
    across = scale[:, None] * (view.rotation[0] - x[:, None] * forward)
    down = scale[:, None] * (view.rotation[1] - y[:, None] * forward)
    if normals is None:
        products = outer(across) + outer(down)
    else:
        known = np.isfinite(normals[:, :1] + normals[:, 1:])
        normals = np.nan_to_num(normals).astype(np.float64)
        along_normal = normals[:, :1] * across + normals[:, 1:] * down
        products = np.where(known, outer(along_normal), (outer(across) + outer(down)) / 2)
    return np.asarray(np.where(local[:, 2:] > 0, products, 0.0))


def outer(vectors: FloatArray) -> FloatArray:
    """(N, 6) elements of the products of (N, 3) vectors with themselves."""
    return np.asarray(vectors[:, ROWS] * vectors[:, COLUMNS])


def mean_of(information: FloatArray) -> FloatArray:
    """(N,) information in a direction, the mean of all directions."""
    return np.asarray(information @ DIAGONAL / 3)


def isotropic(means: FloatArray) -> FloatArray:
    """(N, 6) information that is the same in all directions."""
    return np.asarray(means[:, None] * DIAGONAL)


def noise_px(views: Sequence[View], tracks: Tracks) -> float:
    """The standard deviation of an observation in pixels, from the residuals of all points.

    A point takes up three degrees of freedom, on an edge two. Long tracks tell more than short
    ones, whose residuals are too small. It is a median, so that wrong observations do not count.
    It is 1 where no track is long enough to tell it.
    """
    owners = owners_of(tracks.offsets)
    squares = track_residuals(views, tracks.points[owners], tracks.views, tracks.pixels) ** 2
    sums = np.bincount(owners, squares, len(tracks.points))
    lengths = np.diff(tracks.offsets)
    freedom = lengths - 2 if tracks.normals is not None else 2 * lengths - 3
    tells = (lengths > 2) & np.isfinite(sums)
    if not tells.any():
        return 1.0
    return max(float(np.sqrt(np.median(sums[tells] / freedom[tells]))), MIN_NOISE_PX)
