"""Fit of an axis to the outlines of a body: both sides of all views must show one profile."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.polylines import plane_basis, unit
from colmap_edges.surfaces.revolution.meridians import (
    Axis,
    Meridian,
    meridian_of,
    touched_by,
    voted,
)
from colmap_edges.surfaces.revolution.samples import Samples

NUM_ROUNDS = 6
NUM_NEIGHBOURS = 16  # samples that determine the profile at a sample
NEAR_PX = 10.0  # maximum distance of these
SAME_NORMAL = 0.9  # minimum cosine between their normals
FIRST_PX, LAST_PX = 8.0, 2.0  # maximum distances from the profile, in the first and last rounds
SCALE_PX = 1.0  # of robust weights


def fitted(samples: Samples, axis: Axis) -> Axis | None:
    """The axis fitted to the samples, some rounds of least squares; None if they do not agree."""
    rows = np.arange(len(samples.views))
    for i in range(NUM_ROUNDS):
        meridian = meridian_of(samples, rows, axis)
        meridian = meridian.select(voted(samples, meridian)[1])
        limit = max(FIRST_PX * 0.6**i, LAST_PX)
        offsets, normals = offsets_from_profile(meridian, limit)
        used = np.flatnonzero(np.isfinite(offsets))
        if not len(used):
            return None
        offsets = offsets[used] / meridian.sizes[used]
        axis = moved(samples, meridian.select(used), axis, offsets, normals[used])
    return axis


def offsets_from_profile(meridian: Meridian, limit: float) -> tuple[FloatArray, FloatArray]:
    """(m,) distances from the profile around, nan beyond the limit or if one side lacks; normals.

    The profile is the mean of what the samples of both sides show, each with the same weight.
    """
    count = min(NUM_NEIGHBOURS, len(meridian.rows))
    if count < 2:
        return np.full(len(meridian.rows), np.nan), meridian.normals
    tree = cKDTree(meridian.points)
    near = tree.query(meridian.points, count, distance_upper_bound=NEAR_PX)[1]
    there = near < len(meridian.rows)
    near = np.where(there, near, 0)
    there &= np.einsum("mkj,mj->mk", meridian.normals[near], meridian.normals) > SAME_NORMAL
    normals = unit((meridian.normals[near] * there[..., None]).sum(axis=1))
    away = np.einsum("mkj,mj->mk", meridian.points[:, None] - meridian.points[near], normals)
    there &= np.abs(away) < limit
    means = []
    for side in range(2):
        own = there & (meridian.sides[near] == side)
        with np.errstate(invalid="ignore", divide="ignore"):
            means.append((own * away).sum(axis=1) / own.sum(axis=1))
    offsets: FloatArray = (means[0] + means[1]) / 2
    return np.where(np.abs(offsets) < limit, offsets, np.nan), normals


def moved(
    samples: Samples, meridian: Meridian, axis: Axis, offsets: FloatArray, normals: FloatArray
) -> Axis:
    """The axis after a step of least squares.

    Args:
        samples: all samples.
        meridian: where those near the profile touch the body.
        axis: the axis.
        offsets: (m,) their distances from the profile, pixels of the views.
        normals: (m, 2) its normals.
    """
    basis = plane_basis(axis.direction)
    middle = np.median(meridian.points[:, 0])
    arm = max(np.ptp(meridian.points[:, 0]) / 2, 1.0)
    pivot = axis.point + middle * axis.pixel * axis.direction

    def turned(move: FloatArray) -> Axis:
        direction = unit((axis.direction + (move[2:] / arm) @ basis)[None])[0]
        point = pivot + axis.pixel * (move[:2] @ basis - middle * direction)
        return axis._replace(point=point, direction=direction)

    columns = []
    for step in np.eye(4):
        points = all_points(samples, meridian, turned(step))
        change = np.einsum("mj,mj->m", points - meridian.points, normals)
        columns.append(change / meridian.sizes)
    jacobian = np.column_stack(columns)
    weights = 1 / (1 + (offsets / SCALE_PX) ** 2)
    # Weakly held: about a sphere's centre every axis is one.
    left = (jacobian * weights[:, None]).T @ jacobian + 1e-5 * len(offsets) * np.eye(4)
    move = -np.linalg.solve(left, jacobian.T @ (weights * offsets))
    return turned(move)


def all_points(samples: Samples, meridian: Meridian, axis: Axis) -> FloatArray:
    """(m, 2) where the samples touch the body about another axis, or as before if nowhere."""
    there, inside = touched_by(samples, meridian.rows, axis)
    points = np.column_stack([there.places, there.radii]) / axis.pixel
    return np.where(inside[:, None], points, meridian.points)
