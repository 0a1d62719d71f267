"""Exposures of views: a gain for each view and channel, from triangles that several views see."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from colmap_edges.core.arrays import FloatArray, Int32Array, robust_sigma
from colmap_edges.texture.seen_faces import SeenFaces

USABLE_LEVELS = (8.0, 247.0)  # range of mean colours that are neither dark nor saturated


def find_gains(seen: SeenFaces, num_views: int) -> FloatArray:
    """(V, 3) logarithms of each view's colours relative to the mean view's, BGR.

    Differences of the logarithms of mean colours of one triangle in two views are fitted by
    least squares; those far from the others (highlights, wrong geometry) count little.
    """
    low, high = USABLE_LEVELS
    usable = ((seen.colors > low) & (seen.colors < high)).all(axis=1)
    faces = seen.faces[usable]
    views, logs = seen.views[usable], np.log(seen.colors[usable])
    rows = np.flatnonzero(faces[1:] == faces[:-1])  # each view of a triangle with its next one
    # That many pairs of views suffice.
    rows = rows[:: len(rows) // 200_000 + 1]
    gains = np.zeros((num_views, 3))
    if not len(rows):
        return gains
    first, second = views[rows], views[rows + 1]
    differences = logs[rows] - logs[rows + 1]
    for _ in range(10):
        residuals = np.abs(differences - gains[first] + gains[second]).max(axis=1)
        scale = max(robust_sigma(residuals), 1e-3)
        weights = 1 / (1 + (residuals / scale) ** 2)
        gains = fitted(first, second, differences, weights, num_views)
    return np.asarray(gains - gains[np.unique(views)].mean(axis=0))


def fitted(
    first: Int32Array, second: Int32Array, differences: FloatArray, weights: FloatArray, count: int
) -> FloatArray:
    """(count, 3) values whose differences are nearest to the given ones."""
    pairs = coo_array((weights, (first, second)), (count, count)).tocsr()
    between = pairs + pairs.T
    degrees = np.asarray(between.sum(axis=1)).ravel()
    # A gain of 1 has a thousandth of the weight of what compares a view with others.
    anchor = 1e-3 * degrees + 1e-3 * max(float(degrees.mean()), 1e-12)
    system = (diags_array(degrees + anchor) - between).tocsc()
    sides = [
        np.bincount(first, weights * column, count) - np.bincount(second, weights * column, count)
        for column in differences.T
    ]
    return np.asarray(spsolve(system, np.column_stack(sides))).reshape(count, 3)


def gained(colors: FloatArray, gains: FloatArray) -> FloatArray:
    """Colours (N, 3) of views with the given (N, 3) gains, as the mean view has them."""
    return np.asarray(colors * np.exp(-gains))
