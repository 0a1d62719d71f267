"""Bundle adjustment on SfM points and edge points together (paper: future work).

An SfM observation says where a point lies in the image, in two directions; an observation of an
edge point only how far it lies across the edge, since it may slide along it. Both become rows:
scalar measurements of a projection along one direction. Points are eliminated (Schur complement),
intrinsics stay. All images of a frame move together, as COLMAP's rigs demand.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve
from scipy.sparse import csc_array, csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from colmap_edges.array_types import BoolArray, FloatArray, IntArray
from colmap_edges.chain_depths import make_edge_view
from colmap_edges.edge_graph import EdgeGraph
from colmap_edges.edges import Edges3D
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.model import Model, frames_of_views, moved_model, rows_by_view, views_with_rows
from colmap_edges.options import BundleAdjustmentOptions
from colmap_edges.refinement import curve_tangents

SFM, EDGE = 0, 1  # kinds of points
WEAK_PRIOR = 1e-6  # of the information on each pose: what nothing else determines stays
COLUMNS_AT_ONCE = 3072  # of the points' part of the system, while it is eliminated
ENOUGH_GAIN = 3e-4  # of the cost; steps that gain less move poses by less than their noise
LARGEST_RATIO = 1e12  # squared residual over scale of a point behind its view
SMALLEST_SIGMA_PX = 1e-3  # noise below this is taken for none


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
    """What does not change while poses and points do.

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


@dataclass(frozen=True, kw_only=True)
class Noise:
    """How far residuals are believed.

    Attributes:
        sigmas_px: (2,) standard deviations of the rows of SfM and edge points.
        robust_factor: residuals beyond this many standard deviations lose influence.
        prior: (6 F, 6 F) information that holds the whole where it started.
    """

    sigmas_px: FloatArray
    robust_factor: float
    prior: FloatArray


def edge_normals(model: Model, edges: Edges3D, graphs: Sequence[EdgeGraph]) -> FloatArray:
    """(T, 2) unit normals, in ideal pixels, of the chains that observe the edge points."""
    normals = np.zeros((len(edges.track_views), 2))
    for index, rows in enumerate(rows_by_view(edges.track_views, len(model.views))):
        if len(rows) == 0:
            continue
        ideal = model.views[index].ideal_from_image(edges.track_points2D[rows])
        graph = graphs[index]
        nearest = cKDTree(graph.ideal).query(ideal)[1].astype(np.float64)
        edge_view = make_edge_view(graph, model.views[index])
        tangents = _kernels.chain_points(edge_view, nearest)[1]
        normals[rows] = np.column_stack([-tangents[:, 1], tangents[:, 0]])
    return normals


def make_problem(model: Model, edges: Edges3D, normals: FloatArray) -> tuple[Problem, State]:
    """Gather the measurements of a model and its edges, and where the adjustment starts.

    Observations that cannot be undistorted or lie behind their view are left out, and points
    with fewer than two left.

    Args:
        model: posed views and SfM points.
        edges: edge points with their tracks.
        normals: (T, 2) unit normals of the edges' observations, ideal pixels.
    """
    points = np.concatenate([model.points3D_xyz, edges.points])
    lengths = np.concatenate([np.diff(model.track_offsets), np.diff(edges.track_offsets)])
    owners = np.repeat(np.arange(len(points)), lengths)
    views = np.concatenate([model.track_views, edges.track_views]).astype(np.int64)
    pixels = ideal_pixels(model, views, [model.track_points2D, edges.track_points2D])
    is_edge = np.arange(len(owners)) >= len(model.track_views)
    usable = np.isfinite(pixels).all(axis=1) & (depths_of(model, views, points[owners]) > 0)
    usable &= (np.bincount(owners[usable], minlength=len(points)) >= 2)[owners]
    copies = np.where(is_edge, 1, 2)[usable]
    first = np.flatnonzero(usable)
    observations = np.repeat(first, copies)
    directions = np.tile([1.0, 0.0], (len(observations), 1))
    directions[1:][np.diff(observations) == 0] = [0.0, 1.0]
    across = is_edge[observations]
    directions[across] = normals[observations[across] - len(model.track_views)]
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


def squared_ratios(problem: Problem, residuals: FloatArray, noise: Noise) -> FloatArray:
    """(M,) squared residuals of the rows' observations, over where they lose influence."""
    scales = noise.robust_factor * noise.sigmas_px[problem.kinds[problem.rows.points]]
    observations = problem.rows.observations
    sums = np.asarray(np.bincount(observations, (residuals / scales) ** 2), np.float64)
    return sums[observations]


def cost_of(problem: Problem, state: State, residuals: FloatArray, noise: Noise) -> float:
    """Cauchy cost of the residuals in standard deviations, and the prior's."""
    ratios = squared_ratios(problem, residuals, noise)
    single = np.where(problem.kinds[problem.rows.points] == EDGE, 1.0, 0.5)  # rows an observation
    losses = single * np.log1p(np.minimum(ratios, LARGEST_RATIO))
    prior = state.moved.ravel() @ noise.prior @ state.moved.ravel()
    return float(0.5 * noise.robust_factor**2 * losses.sum() + 0.5 * prior)


@dataclass(frozen=True, kw_only=True)
class Normals:
    """Normal equations with every row weighted: blocks of points, whole system of the poses.

    Attributes:
        by_pose: (M, 6 F) weighted Jacobian by the poses.
        by_point: (M, 3) weighted Jacobian by the row's point.
        point_blocks: (P, 3, 3).
        pose_system: (6 F, 6 F).
        point_gradient: (P, 3).
        pose_gradient: (6 F,).
    """

    by_pose: csr_array
    by_point: FloatArray
    point_blocks: FloatArray
    pose_system: FloatArray
    point_gradient: FloatArray
    pose_gradient: FloatArray


def normal_equations(problem: Problem, state: State, noise: Noise) -> Normals:
    """Linearise at `state` with robust weights."""
    rows = problem.rows
    residuals, local = project_rows(problem, state)
    by_pose, by_point = jacobians(problem, state, local)
    ratios = squared_ratios(problem, residuals, noise)
    weights = 1 / np.sqrt(1 + ratios) / noise.sigmas_px[problem.kinds[rows.points]]
    usable = np.isfinite(residuals)
    weights[~usable], residuals[~usable] = 0.0, 0.0
    residuals, by_pose, by_point = (
        weights * residuals,
        np.where(usable[:, None], weights[:, None] * by_pose, 0.0),
        np.where(usable[:, None], weights[:, None] * by_point, 0.0),
    )
    starts = np.searchsorted(rows.points, np.arange(len(problem.kinds)))
    blocks = np.add.reduceat(by_point[:, :, None] * by_point[:, None, :], starts)
    size = np.einsum("pii->p", blocks)[:, None, None]
    blocks += size * problem.tangents[:, :, None] * problem.tangents[:, None, :]
    wide = block_rows(by_pose, problem.frames[rows.views], problem.num_frames)
    return Normals(
        by_pose=wide,
        by_point=by_point,
        point_blocks=blocks,
        pose_system=(wide.T @ wide).toarray() + noise.prior,
        point_gradient=np.add.reduceat(by_point * residuals[:, None], starts),
        pose_gradient=wide.T @ residuals + noise.prior @ state.moved.ravel(),
    )


def block_rows(values: FloatArray, places: IntArray, count: int) -> csr_array:
    """(M, K count) sparse matrix with row m of `values`, (M, K), at block `places[m]`."""
    width = values.shape[1]
    columns = width * places[:, None] + np.arange(width)
    starts = width * np.arange(len(values) + 1)
    return csr_array((values.ravel(), columns.ravel(), starts), (len(values), width * count))


def outer_square(matrix: csc_array) -> FloatArray:
    """`matrix @ matrix.T`, dense, from dense blocks of the rows that neighbouring columns share."""
    total = np.zeros((matrix.shape[0], matrix.shape[0]))
    for start in range(0, matrix.shape[1], COLUMNS_AT_ONCE):
        block = matrix[:, start : start + COLUMNS_AT_ONCE]
        rows = np.unique(block.indices)
        dense = block.toarray()[rows]
        total[np.ix_(rows, rows)] += dense @ dense.T
    return total


def solve_step(
    problem: Problem, normals: Normals, damping: float, move_poses: bool
) -> tuple[FloatArray, FloatArray]:
    """(F, 6) and (P, 3) steps of the damped normal equations, points eliminated."""
    blocks = normals.point_blocks.copy()
    diagonal = np.einsum("pii->pi", blocks)
    diagonal += damping * diagonal + 1e-12 * diagonal.sum(axis=1, keepdims=True) + 1e-300
    inverse = np.linalg.inv(np.linalg.cholesky(blocks))  # of the lower factor
    gradient: FloatArray = np.einsum("pij,pj->pi", inverse, normals.point_gradient)
    step = np.zeros(6 * problem.num_frames)
    carried = np.zeros_like(gradient)
    if move_poses:
        factors = np.einsum("mij,mj->mi", inverse[problem.rows.points], normals.by_point)
        coupling = normals.by_pose.T @ block_rows(factors, problem.rows.points, len(blocks))
        system = normals.pose_system - outer_square(coupling.tocsc())
        system[np.diag_indices(len(system))] += damping * np.diag(normals.pose_system)
        right = coupling @ gradient.ravel() - normals.pose_gradient
        step = solve(system, right, assume_a="pos")
        carried = (coupling.T @ step).reshape(-1, 3)
    points = -np.einsum("pji,pj->pi", inverse, gradient + carried)
    return step.reshape(-1, 6), points


def apply_step(problem: Problem, state: State, step: FloatArray, points: FloatArray) -> State:
    """The state after frames move by `step`, (F, 6), and points by `points`, (P, 3)."""
    centers = frame_centers(problem, state)
    turns = Rotation.from_rotvec(step[:, :3]).as_matrix()
    shifts = centers + step[:, 3:] - np.einsum("fij,fj->fi", turns, centers)
    return State(
        rotations=state.rotations @ turns,
        translations=np.einsum("fij,fj->fi", state.rotations, shifts) + state.translations,
        moved=state.moved + step,
        points=state.points + points,
    )


def minimize(
    problem: Problem, state: State, noise: Noise, max_steps: int, move_poses: bool = True
) -> tuple[State, float]:
    """Levenberg-Marquardt until a step gains less than `ENOUGH_GAIN` of the cost.

    Returns:
        The state of lowest cost, and its cost.
    """
    damping = 1e-6
    cost = cost_of(problem, state, project_rows(problem, state)[0], noise)
    for _ in range(max_steps):
        normals = normal_equations(problem, state, noise)
        while damping < 1e6:
            tried, found = state, np.inf
            with suppress(LinAlgError):  # more damping makes any system solvable
                step = solve_step(problem, normals, damping, move_poses)
                tried = apply_step(problem, state, *step)
                found = cost_of(problem, tried, project_rows(problem, tried)[0], noise)
            if found <= cost:
                break
            damping *= 10
        else:
            break
        state, gain, cost, damping = tried, cost - found, found, max(damping / 10, 1e-12)
        if gain <= ENOUGH_GAIN * cost:
            break
    return state, cost


def estimate_sigmas(problem: Problem, state: State) -> FloatArray:
    """(2,) standard deviations in pixels of the rows of SfM and edge points, from medians.

    Residuals are smaller than the noise, since points follow their observations.
    """
    residuals = np.abs(project_rows(problem, state)[0])
    kinds = problem.kinds[problem.rows.points]
    sigmas = np.ones(2)
    for kind, freedom in ((SFM, 3), (EDGE, 2)):
        found = residuals[kinds == kind]
        spare = len(found) - freedom * np.count_nonzero(problem.kinds == kind)
        if spare > 0:
            sigmas[kind] = 1.4826 * np.median(found) * np.sqrt(len(found) / spare)
    return np.maximum(np.where(np.isfinite(sigmas), sigmas, 1.0), SMALLEST_SIGMA_PX)


def adjust(problem: Problem, state: State, options: BundleAdjustmentOptions) -> State:
    """Adjust poses and points; the noise is measured anew until residuals no longer shrink."""
    prior = no_prior(problem)
    sigmas = np.full(2, np.inf)
    for _ in range(options.max_rounds):
        before, sigmas = sigmas, estimate_sigmas(problem, state)
        if np.all(sigmas > 0.98 * before):
            break
        noise = Noise(sigmas_px=sigmas, robust_factor=options.robust_factor, prior=prior)
        if not prior.any():
            prior = gauge_prior(problem, state, noise)
            noise = replace(noise, prior=prior)
        state, _ = minimize(problem, state, noise, options.max_steps)
    return state


def no_prior(problem: Problem) -> FloatArray:
    """(6 F, 6 F) zeros."""
    return np.zeros((6 * problem.num_frames, 6 * problem.num_frames))


def gauge_prior(problem: Problem, state: State, noise: Noise) -> FloatArray:
    """(6 F, 6 F) information that holds position, orientation and scale of the whole.

    It is as strong along these directions as what the measurements would say of the frames, were
    the points known, and nothing across. Left to the measurements the whole would drift: edge
    points cannot follow it along their edges. A rig of several cameras fixes the scale itself.
    """
    count = problem.num_frames
    size = 6 * count
    within = np.kron(np.eye(count), np.ones((6, 6)))
    information = within * normal_equations(problem, state, noise).pose_system
    centers = frame_centers(problem, state)
    centers -= centers.mean(axis=0)
    moves = np.zeros((count, 6, 7 if len(problem.frames) == count else 6))
    for axis, unit in enumerate(np.eye(3)):
        moves[:, axis, axis] = 1
        moves[:, 3:, axis] = np.cross(unit, centers)
        moves[:, 3 + axis, 3 + axis] = 1
    moves[:, 3:, 6:] = centers[:, :, None]
    flat = moves.reshape(size, -1)
    held = information @ flat
    prior = held @ np.linalg.pinv(flat.T @ held, hermitian=True) @ held.T
    unseen = np.diag((np.diag(information) == 0).astype(float))
    weak: FloatArray = prior + WEAK_PRIOR * information + unseen
    return weak


def part_of(problem: Problem, state: State, chosen: BoolArray) -> tuple[Problem, State]:
    """The problem of the chosen points, (P,), alone."""
    rows = problem.rows
    keep = chosen[rows.points]
    part = Rows(
        points=(np.cumsum(chosen) - 1)[rows.points[keep]],
        views=rows.views[keep],
        pixels=rows.pixels[keep],
        directions=rows.directions[keep],
        observations=np.unique(rows.observations[keep], return_inverse=True)[1],
    )
    smaller = replace(
        problem,
        rows=part,
        kinds=problem.kinds[chosen],
        tangents=problem.tangents[chosen],
        groups=problem.groups[chosen],
        indices=problem.indices[chosen],
    )
    return smaller, replace(state, points=state.points[chosen])


def held_out_costs(
    problem: Problem, start: State, options: BundleAdjustmentOptions
) -> list[tuple[float, float]]:
    """Costs of each half of the points, with poses as they were and as the other half moves them.

    A 3D edge goes whole to one half. Only where poses are truly off do points that took no part
    gain from the move; noise moves poses too, and they lose.
    """
    half = np.unique(problem.groups, return_inverse=True)[1] % 2 == 1
    costs = []
    for mine in (half, ~half):
        moved = adjust(*part_of(problem, start, mine), options)
        judges, before = part_of(problem, start, ~mine)
        noise = Noise(
            sigmas_px=estimate_sigmas(judges, before),
            robust_factor=options.robust_factor,
            prior=no_prior(problem),
        )
        after = replace(moved, points=before.points)
        pair = [
            minimize(judges, state, noise, options.max_steps, False)[1] for state in (before, after)
        ]
        costs.append((pair[0], pair[1]))
    return costs


def refine_poses(
    model: Model, edges: Edges3D, normals: FloatArray, options: BundleAdjustmentOptions
) -> tuple[Model, dict[str, Any]]:
    """Refine the poses of a model on its SfM points and its edges.

    The whole stays where it was: position, orientation and scale are those that move the frames
    least. Poses change only if held-out points gain from it in both halves.

    Args:
        model: posed views and SfM points; not changed.
        edges: 3D edges traced with the model's poses.
        normals: (T, 2) unit normals of the edges' observations, see `edge_normals`.
        options: robustness and effort.

    Returns:
        The model with refined poses and SfM points, or `model` itself, and counts.
    """
    problem, start = make_problem(model, edges, normals)
    stats: dict[str, Any] = {
        "frames": problem.num_frames,
        "sfm_points": np.count_nonzero(problem.kinds == SFM),
        "edge_points": np.count_nonzero(problem.kinds == EDGE),
        "refined": False,
    }
    if len(problem.rows.points) < 6 * problem.num_frames + 3 * len(problem.kinds):
        return model, stats  # too little to know anything by
    costs = held_out_costs(problem, start, options)
    gains = [1 - after / max(before, 1e-300) for before, after in costs]
    stats["held_out_gains"] = gains
    if min(gains) <= options.min_gain:
        return model, stats
    state = adjust(problem, start, options)
    sigmas = estimate_sigmas(problem, state)
    stats |= {
        "refined": True,
        "sfm_sigma_px": sigmas[SFM],
        "edge_sigma_px": sigmas[EDGE],
        "median_turn_deg": np.degrees(np.median(np.linalg.norm(state.moved[:, :3], axis=1))),
        "median_shift": np.median(np.linalg.norm(state.moved[:, 3:], axis=1)),
    }
    return adjusted_model(model, problem, state), stats


def adjusted_model(model: Model, problem: Problem, state: State) -> Model:
    """The model with its frames moved and its SfM points where the adjustment put them."""
    points = model.points3D_xyz.copy()
    sfm = problem.kinds == SFM
    points[problem.indices[sfm]] = state.points[sfm]
    motions = np.concatenate([state.rotations, state.translations[:, :, None]], axis=2)
    return moved_model(model, motions, points)
