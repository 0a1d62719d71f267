"""Displacement of a cloud whose images were shifted against those of the model.

Programs differ in where a pixel has its centre, and in how images are cropped and reduced. A cloud
made from images that are shifted by a pixel against the model's is displaced by about a pixel, in
a direction that depends on the views. The shift is measured at points of the model.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, owners_of, robust_sigma
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.core.view import views_with_rows
from colmap_edges.surfaces.dense.planes import NUM_NEIGHBORS, planes_at

MIN_POINTS = 100  # of the model on planes of the cloud


def measured_shift(cloud: SeenPoints, tree: cKDTree, model: Model) -> FloatArray:
    """(2,) shift in pixels of the images from which a cloud was made, robustly; 0 if none is sure.

    Args:
        cloud: the points with their views.
        tree: of the points.
        model: the model; its points must not come from the cloud.
    """
    points = model.points3D_xyz
    if len(cloud.points) < NUM_NEIGHBORS or len(points) < MIN_POINTS:
        return np.zeros(2)
    near = tree.query(points, NUM_NEIGHBORS)[1]
    planes = planes_at(cloud.points[near])
    away = np.linalg.norm(points - planes.centers, axis=1)
    on_plane = planes.are_flat & (away < planes.radii)
    if np.count_nonzero(on_plane) < MIN_POINTS:
        return np.zeros(2)
    near, normals = near[on_plane], planes.normals[on_plane]
    residuals = np.einsum("ni,ni->n", normals, points[on_plane] - planes.centers[on_plane])
    used, places = np.unique(near, return_inverse=True)
    moves = movements(cloud.chosen(used), model)[places.reshape(near.shape)].mean(axis=1)
    design = np.einsum("ni,nij->nj", normals, moves)
    weights = np.ones(len(design))
    for _ in range(10):
        information = (design * weights[:, None]).T @ design
        shift = np.linalg.lstsq(information, design.T @ (weights * residuals), rcond=None)[0]
        left = residuals - design @ shift
        sigma = robust_sigma(left) or 1.0
        # With a scale of two robust standard deviations.
        weights = 1 / (1 + (left / (2.0 * sigma)) ** 2) ** 2
    # A shift below five standard deviations may be chance.
    if shift @ information @ shift < (5.0 * sigma) ** 2:
        return np.zeros(2)
    return np.asarray(shift)


def movements(cloud: SeenPoints, model: Model) -> FloatArray:
    """(N, 3, 2) movements of triangulated points per pixel of shift of all their images."""
    owners = owners_of(cloud.track_offsets)
    matrix, right = np.zeros((len(cloud.points), 3, 3)), np.zeros((len(cloud.points), 3, 2))
    for view, rows in views_with_rows(model.views, cloud.track_views):
        own = owners[rows]
        local = view.cam_from_world(cloud.points[own])
        per_depth = view.focal_px / view.scale / np.where(local[:, 2] > 0, local[:, 2], np.inf)
        slopes = np.zeros((len(own), 2, 3))  # of pixels by camera coordinates
        slopes[:, [0, 1], [0, 1]] = per_depth[:, None]
        slopes[:, :, 2] = -per_depth[:, None] * local[:, :2] / local[:, 2:]
        slopes = slopes @ view.rotation
        matrix[own] += slopes.transpose(0, 2, 1) @ slopes
        right[own] += slopes.transpose(0, 2, 1)
    trace = np.trace(matrix, axis1=1, axis2=2)
    # What the views of a point do not determine, such as its depth in a single view, is not moved.
    matrix += (1e-6 * np.where(trace > 0, trace, 1))[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(matrix, right))
