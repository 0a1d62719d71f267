"""Levenberg-Marquardt on poses and points, points eliminated, with robust weights."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, solve
from scipy.sparse import csc_array, csr_array
from scipy.spatial.transform import Rotation

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.options import BundleAdjustmentOptions
from colmap_edges.poses.problem import (
    EDGE,
    SFM,
    Problem,
    State,
    frame_centers,
    jacobians,
    project_rows,
)

WEAK_PRIOR = 1e-6  # of the information on each pose: what nothing else determines stays
COLUMNS_AT_ONCE = 3072  # of the points' part of the system, while it is eliminated
ENOUGH_GAIN = 3e-4  # of the cost; steps that gain less move poses by less than their noise
LARGEST_RATIO = 1e12  # squared residual over scale of a point behind its view
SMALLEST_SIGMA_PX = 1e-3  # noise below this is taken for none


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
