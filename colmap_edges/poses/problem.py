"""Measurements for pose refinement: of SfM points in 2D, of edge points across their edges.

(paper: future work)

An observation of an SfM point gives two residuals; one of an edge point gives one, across the edge,
since the point can slide along it. Intrinsics are fixed. All images of a frame move together, as in
COLMAP's rigs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.colmap.model import Model, frames_of_views
from colmap_edges.core.arrays import (
    FloatArray,
    Int32Array,
    IntArray,
    RaggedTable,
    offsets_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import curve_tangents
from colmap_edges.core.view import rows_by_view, views_with_rows
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

SFM, EDGE = 0, 1  # kinds of points


@dataclass(frozen=True, kw_only=True)
class Measurements(RaggedTable):
    """Observations in CSR arrays by point; every point has at least one.

    Attributes:
        offsets: (P + 1,) int64.
        views: (N,) int32.
        pixels: (N, 2) observed undistorted pixels.
        normals: (N, 2) unit directions in which edge points are measured; 0 for SfM points.
    """

    views: Int32Array
    pixels: FloatArray
    normals: FloatArray


@dataclass(frozen=True, kw_only=True)
class Problem:
    """The constants of the adjustment: initial poses, focal lengths, measurements.

    Attributes:
        rotations: (V, 3, 3) of the initial cam_from_world.
        translations: (V, 3) of the initial cam_from_world.
        focals_px: (V,) focal lengths.
        frames: (V,) int32 frame of each view, 0..F - 1.
        measured: the measurements.
        kinds: (P,) SFM or EDGE.
        tangents: (P, 3) unit tangents, along which edge points do not move; 0 for SfM points.
        groups: (P,) int64 group of each point: a 3D edge, or a single SfM point.
        indices: (P,) int64 index of each point among the model's points followed by edge points.
    """

    rotations: FloatArray
    translations: FloatArray
    focals_px: FloatArray
    frames: Int32Array
    measured: Measurements
    kinds: IntArray
    tangents: FloatArray
    groups: IntArray
    indices: IntArray

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return int(self.frames.max()) + 1

    @property
    def num_residuals(self) -> int:
        """Number of scalar residuals: two per observation of an SfM point, one of an edge point."""
        counts = np.diff(self.measured.offsets)
        return int(counts.sum() + counts[self.kinds == SFM].sum())


@dataclass(frozen=True, kw_only=True)
class State:
    """The unknowns; the pose of a view is its initial pose after its frame's motion.

    Attributes:
        rotations: (F, 3, 3) of the frames' motions in the world.
        translations: (F, 3) of the frames' motions.
        moved: (F, 6) sum of the steps so far: rotation about the centre in radians, translation.
        points: (P, 3) world points.
    """

    rotations: FloatArray
    translations: FloatArray
    moved: FloatArray
    points: FloatArray


def make_problem(model: Model, edges: Edges3D) -> tuple[Problem, State]:
    """Make the problem of a model and its edges, and the initial state.

    Observations that cannot be undistorted, are behind their view or on an unknown chain are
    dropped, and then points with fewer than two observations.

    Args:
        model: posed views and SfM points.
        edges: edge points with their tracks.
    """
    observed, first_edge = edges.observations, len(model.track_views)
    points = np.concatenate([model.points3D_xyz, edges.points])
    counts = np.concatenate([np.diff(model.track_offsets), observed.counts])
    owners = np.repeat(np.arange(len(points)), counts)
    views = np.concatenate([model.track_views, observed.views]).astype(np.int32)
    pixels = undistorted_pixels(model, views, [model.track_points2D, observed.pixels])
    usable = np.isfinite(pixels).all(axis=1) & (depths_of(model, views, points[owners]) > 0)
    usable[first_edge:] &= np.isfinite(observed.normals).all(axis=1)
    usable &= (np.bincount(owners[usable], minlength=len(points)) >= 2)[owners]
    counts = np.bincount(owners[usable], minlength=len(points))
    indices = np.flatnonzero(counts)
    measured = Measurements(
        offsets=offsets_of(counts[indices]),
        views=views[usable],
        pixels=pixels[usable],
        normals=np.concatenate([np.zeros((first_edge, 2)), observed.normals])[usable],
    )
    return problem_of(model, edges, measured, indices), start_state(model, points[indices])


def undistorted_pixels(model: Model, views: Int32Array, parts: list[FloatArray]) -> FloatArray:
    """(T, 2) undistorted pixels of image pixels, each in its view."""
    pixels: FloatArray = np.concatenate(parts)
    for view, rows in views_with_rows(model.views, views):
        pixels[rows] = view.undistorted_from_image(pixels[rows])
    return pixels


def depths_of(model: Model, views: Int32Array, points: FloatArray) -> FloatArray:
    """(T,) depths of points, each in its view."""
    axes = np.array([view.rotation[2] for view in model.views])
    offsets = np.array([view.translation[2] for view in model.views])
    return np.asarray(np.einsum("ij,ij->i", points, axes[views]) + offsets[views])


def problem_of(model: Model, edges: Edges3D, measured: Measurements, indices: IntArray) -> Problem:
    """The problem of `measured`; its point i has index `indices[i]` of model and edge points."""
    count = len(model.points3D_xyz)
    is_edge = indices >= count
    tangents = curve_tangents(edges.points, edges.edge_offsets)
    lengths = np.linalg.norm(tangents, axis=1, keepdims=True)
    tangents = tangents / np.where(lengths > 0, lengths, 1)
    edge_ids = edges.edge_ids
    return Problem(
        rotations=np.array([view.rotation for view in model.views]),
        translations=np.array([view.translation for view in model.views]),
        focals_px=np.array([view.focal_px for view in model.views]),
        frames=np.unique(frames_of_views(model), return_inverse=True)[1].astype(np.int32),
        measured=measured,
        kinds=np.where(is_edge, EDGE, SFM),
        tangents=np.concatenate([np.zeros((count, 3)), tangents])[indices],
        groups=np.concatenate([np.arange(count), count + edge_ids])[indices],
        indices=indices,
    )


def start_state(model: Model, points: FloatArray) -> State:
    """The initial state: frames without motion, and the given points."""
    count = len(np.unique(frames_of_views(model)))
    return State(
        rotations=np.tile(np.eye(3), (count, 1, 1)),
        translations=np.zeros((count, 3)),
        moved=np.zeros((count, 6)),
        points=points,
    )


def poses(problem: Problem, state: State) -> tuple[FloatArray, FloatArray]:
    """(V, 3, 3) rotations and (V, 3) translations of cam_from_world at `state`."""
    turns, shifts = state.rotations[problem.frames], state.translations[problem.frames]
    rotations = problem.rotations @ turns
    translations = np.einsum("vij,vj->vi", problem.rotations, shifts) + problem.translations
    return rotations, translations


def frame_centers(problem: Problem, state: State) -> FloatArray:
    """(F, 3) mean projection centre of each frame's views."""
    rotations, translations = poses(problem, state)
    centers = -np.einsum("vji,vj->vi", rotations, translations)
    sums = np.zeros((problem.num_frames, 3))
    np.add.at(sums, problem.frames, centers)
    return np.asarray(sums / np.bincount(problem.frames)[:, None])


def linearized(problem: Problem, state: State) -> _kernels.Adjustment:
    """The residuals and their derivatives at `state`, computed by the kernel on demand.

    A frame rotates about its centre, then translates, in world coordinates. An edge point moves
    only perpendicular to its tangent.
    """
    measured = problem.measured
    rotations, translations = poses(problem, state)
    return _kernels.Adjustment(
        measured.offsets,
        measured.views,
        measured.pixels,
        measured.normals,
        problem.tangents,
        problem.frames,
        problem.focals_px,
        rotations,
        translations,
        frame_centers(problem, state),
        state.points,
    )


def mean_squared_slopes(problem: Problem, state: State) -> FloatArray:
    """(F, 6, 6) mean of J^T J over the points that each frame observes; 0 without any.

    J is (2, 6), the derivative of a point's pixel with respect to the motion of its frame.
    """
    measured, centers = problem.measured, frame_centers(problem, state)
    owners, sums = measured.owners, np.zeros((problem.num_frames, 6, 6))
    rows_of = rows_by_view(measured.views, len(problem.frames))
    for rows, frame, focal_px, rotation, translation in zip(
        rows_of, problem.frames, problem.focals_px, *poses(problem, state), strict=True
    ):
        points = state.points[owners[rows]]
        local = points @ rotation.T + translation
        axes = rotation[:2] - (local[:, :2] / local[:, 2:])[:, :, None] * rotation[2]
        shifts = axes * (focal_px / local[:, 2])[:, None, None]
        # A turn w of the frame moves a point at x from its centre by w x x.
        turns = np.cross((points - centers[frame])[:, None], shifts)
        slopes = np.concatenate([turns, shifts], axis=2).reshape(-1, 6)
        sums[frame] += slopes.T @ slopes
    counts = np.bincount(problem.frames[measured.views], minlength=problem.num_frames)
    return np.asarray(sums / np.maximum(counts, 1)[:, None, None])
