"""The measurements that poses are refined on: of SfM points, and across edges of edge points.

(paper: future work)

An SfM observation says where a point lies in the image, in two directions; an observation of an
edge point only how far it lies across the edge, since it may slide along it. Both become rows:
scalar measurements of a projection along one direction. Intrinsics stay. All images of a frame move
together, as COLMAP's rigs demand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.colmap.model import Model, frames_of_views
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import curve_tangents
from colmap_edges.core.view import views_with_rows

SFM, EDGE = 0, 1  # kinds of points


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Scalar measurements: a point's projection along a direction; rows of a point contiguous.

    Attributes:
        points: (M,) int64 ascending; every point has rows.
        views: (M,) int64.
        pixels: (M, 2) observed ideal pixels.
        directions: (M, 2) unit directions in which they are known.
        observations: (M,) int64; the two rows of an SfM observation share one.
    """

    points: IntArray
    views: IntArray
    pixels: FloatArray
    directions: FloatArray
    observations: IntArray


@dataclass(frozen=True, kw_only=True)
class Problem:
    """The constants of the adjustment: initial poses, focal lengths and measurements.

    Attributes:
        rotations: (V, 3, 3) of cam_from_world at the start.
        translations: (V, 3) of cam_from_world at the start.
        focals_px: (V,) focal lengths.
        frames: (V,) int64 frame of each view, 0..F - 1.
        rows: the measurements.
        kinds: (P,) SFM or EDGE.
        tangents: (P, 3) unit directions along which edge points stay; 0 for SfM points.
        groups: (P,) int64 points that belong together: a 3D edge, or one SfM point.
        indices: (P,) int64 place of the point among the model's points followed by the edges'.
    """

    rotations: FloatArray
    translations: FloatArray
    focals_px: FloatArray
    frames: IntArray
    rows: Rows
    kinds: IntArray
    tangents: FloatArray
    groups: IntArray
    indices: IntArray

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return int(self.frames.max()) + 1


@dataclass(frozen=True, kw_only=True)
class State:
    """The unknowns; cam_from_world of a view is that of the start after its frame's motion.

    Attributes:
        rotations: (F, 3, 3) of the frames' motions in the world.
        translations: (F, 3) of the frames' motions.
        moved: (F, 6) sum of the steps so far: turn about the centre in radians, shift.
        points: (P, 3) world points.
    """

    rotations: FloatArray
    translations: FloatArray
    moved: FloatArray
    points: FloatArray


def make_problem(model: Model, edges: Edges3D) -> tuple[Problem, State]:
    """Gather the measurements of a model and its edges, and where the adjustment starts.

    Observations that cannot be undistorted, lie behind their view or are on no known chain are
    left out, and points with fewer than two left.

    Args:
        model: posed views and SfM points.
        edges: edge points with their tracks.
    """
    observed, first_edge = edges.observations, len(model.track_views)
    points = np.concatenate([model.points3D_xyz, edges.points])
    lengths = np.concatenate([np.diff(model.track_offsets), observed.counts])
    owners = np.repeat(np.arange(len(points)), lengths)
    views = np.concatenate([model.track_views, observed.views]).astype(np.int64)
    pixels = ideal_pixels(model, views, [model.track_points2D, observed.pixels])
    is_edge = np.arange(len(owners)) >= first_edge
    usable = np.isfinite(pixels).all(axis=1) & (depths_of(model, views, points[owners]) > 0)
    usable[first_edge:] &= np.isfinite(observed.normals).all(axis=1)
    usable &= (np.bincount(owners[usable], minlength=len(points)) >= 2)[owners]
    copies = np.where(is_edge, 1, 2)[usable]
    first = np.flatnonzero(usable)
    observations = np.repeat(first, copies)
    directions = np.tile([1.0, 0.0], (len(observations), 1))
    directions[1:][np.diff(observations) == 0] = [0.0, 1.0]
    across = is_edge[observations]
    directions[across] = observed.normals[observations[across] - first_edge]
    indices, compact = np.unique(owners[observations], return_inverse=True)
    rows = Rows(
        points=compact,
        views=views[observations],
        pixels=pixels[observations],
        directions=directions,
        observations=np.unique(observations, return_inverse=True)[1],
    )
    return problem_of_rows(model, edges, rows, indices), start_state(model, points[indices])


def ideal_pixels(model: Model, views: IntArray, parts: list[FloatArray]) -> FloatArray:
    """(T, 2) ideal pixels of image pixels, each in its view."""
    pixels: FloatArray = np.concatenate(parts)
    for view, rows in views_with_rows(model.views, views):
        pixels[rows] = view.ideal_from_image(pixels[rows])
    return pixels


def depths_of(model: Model, views: IntArray, points: FloatArray) -> FloatArray:
    """(T,) depths of points, each in its view."""
    axes = np.array([view.rotation[2] for view in model.views])
    offsets = np.array([view.translation[2] for view in model.views])
    depths: FloatArray = np.einsum("ij,ij->i", points, axes[views]) + offsets[views]
    return depths


def problem_of_rows(model: Model, edges: Edges3D, rows: Rows, indices: IntArray) -> Problem:
    """The problem of `rows`, whose point i is `indices[i]` of the model's and the edges'."""
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
        frames=np.unique(frames_of_views(model), return_inverse=True)[1],
        rows=rows,
        kinds=np.where(is_edge, EDGE, SFM),
        tangents=np.concatenate([np.zeros((count, 3)), tangents])[indices],
        groups=np.concatenate([np.arange(count), count + edge_ids])[indices],
        indices=indices,
    )


def start_state(model: Model, points: FloatArray) -> State:
    """Frames that have not moved, and the points where they are."""
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
    means: FloatArray = sums / np.bincount(problem.frames)[:, None]
    return means


def project_rows(problem: Problem, state: State) -> tuple[FloatArray, FloatArray]:
    """(M,) residuals in pixels, infinite behind the view, and (M, 3) points in the cameras."""
    rows = problem.rows
    rotations, translations = poses(problem, state)
    points = state.points[rows.points]
    local = np.einsum("mij,mj->mi", rotations[rows.views], points) + translations[rows.views]
    depths = np.where(local[:, 2] > 0, local[:, 2], np.nan)
    projected = problem.focals_px[rows.views, None] * local[:, :2] / depths[:, None]
    residuals = np.einsum("mi,mi->m", projected - rows.pixels, rows.directions)
    return np.nan_to_num(residuals, nan=np.inf), local


def jacobians(problem: Problem, state: State, local: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(M, 6) derivatives of the residuals by their frame's motion and (M, 3) by their point.

    A frame moves by a turn about its centre, then a shift, both in the world; an edge point only
    across its tangent.
    """
    rows = problem.rows
    rotations, _ = poses(problem, state)
    inward = -np.einsum("mi,mi->m", rows.directions, local[:, :2]) / local[:, 2]
    slopes = np.column_stack([rows.directions, inward])
    slopes *= (problem.focals_px[rows.views] / local[:, 2])[:, None]
    by_shift = np.einsum("mi,mij->mj", slopes, rotations[rows.views])
    arms = state.points[rows.points] - frame_centers(problem, state)[problem.frames[rows.views]]
    by_pose = np.column_stack([np.cross(arms, by_shift), by_shift])
    tangents = problem.tangents[rows.points]
    along = np.einsum("mi,mi->m", by_shift, tangents)
    return by_pose, by_shift - along[:, None] * tangents
