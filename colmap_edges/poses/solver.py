"""Levenberg-Marquardt on poses and points, with eliminated points and robust weights."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from colmap_edges.core.arrays import FloatArray, robust_sigma
from colmap_edges.options import BundleAdjustmentOptions
from colmap_edges.poses.problem import (
    EDGE,
    SFM,
    Problem,
    State,
    frame_centers,
    linearized,
    mean_squared_slopes,
)
from colmap_edges.poses.systems import Prior, shared_frames, solve_poses

ANY_WAY = 0.01  # share of the initial poses' information that holds them in every direction


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The noise model of the residuals.

    Attributes:
        sigmas_px: (2,) standard deviations of the residuals of SfM and edge points.
        robust_factor: scale of the Cauchy loss, in standard deviations.
        prior: information that keeps the model in place.
    """

    sigmas_px: FloatArray
    robust_factor: float
    prior: Prior

    @classmethod
    def of(cls, problem: Problem, state: State, options: BundleAdjustmentOptions) -> Noise:
        """The noise of the residuals at `state`, without a prior."""
        return cls(
            sigmas_px=estimate_sigmas(problem, state),
            robust_factor=options.robust_factor,
            prior=Prior.none(problem.num_frames),
        )

    @property
    def weighting(self) -> tuple[tuple[float, float], float]:
        """The parameters as passed to the kernel."""
        return (float(self.sigmas_px[SFM]), float(self.sigmas_px[EDGE])), self.robust_factor


def cost_of(problem: Problem, state: State, noise: Noise) -> float:
    """Cauchy cost of the residuals in standard deviations, plus the prior's cost."""
    residuals = linearized(problem, state).residuals()
    scales = np.repeat(
        noise.robust_factor * noise.sigmas_px[problem.kinds], np.diff(problem.measured.offsets)
    )
    ratios = np.einsum("ni,ni->n", residuals, residuals) / scales**2
    # Points behind their view have infinite residuals.
    losses = np.log1p(np.minimum(ratios, 1e12, out=ratios), out=ratios)
    moved = state.moved.ravel()
    prior = moved @ noise.prior.product(moved)
    return float(0.5 * noise.robust_factor**2 * losses.sum() + 0.5 * prior)


def solve_step(
    problem: Problem,
    state: State,
    noise: Noise,
    damping: float,
    pattern: csr_array | None,
) -> tuple[FloatArray, FloatArray]:
    """(F, 6) and (P, 3) steps of the damped normal equations, with points eliminated.

    `pattern` has the blocks of frames that share points; poses without one are unchanged.
    """
    equations = linearized(problem, state)
    step = np.zeros((problem.num_frames, 6))
    try:
        if pattern is not None:
            information, shared, right = equations.reduce(
                *noise.weighting, damping, pattern.indptr.astype(np.int64), pattern.indices
            )
            right -= noise.prior.product(state.moved.ravel()).reshape(-1, 6)
            diagonal = np.einsum("fii->fi", information) + noise.prior.diagonal
            information += noise.prior.blocks
            np.einsum("fii->fi", information)[...] += damping * diagonal
            step = solve_poses(pattern, information, shared, noise.prior, right)
        return step, equations.point_steps(*noise.weighting, damping, step)
    except ValueError as error:  # raised by the kernel for undetermined points
        raise LinAlgError(str(error)) from error


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
    """Levenberg-Marquardt until the cost decreases by less than a 3,000th.

    Returns:
        The state of lowest cost, and its cost.
    """
    damping = 1e-6
    cost = cost_of(problem, state, noise)
    pattern = shared_frames(problem) if move_poses else None
    for _ in range(max_steps):
        while damping < 1e6:
            tried, found = state, np.inf
            with suppress(LinAlgError):  # more damping makes any system solvable
                step = solve_step(problem, state, noise, damping, pattern)
                tried = apply_step(problem, state, *step)
                found = cost_of(problem, tried, noise)
            if found <= cost:
                break
            damping *= 10
        else:
            break
        state, gain, cost, damping = tried, cost - found, found, max(damping / 10, 1e-12)
        if gain <= 3e-4 * cost:
            break
    return state, cost


def fit_points(
    problem: Problem, state: State, noise: Noise, options: BundleAdjustmentOptions
) -> tuple[State, float]:
    """The state with points moved to where they fit best to the poses, and its cost."""
    return minimize(problem, state, noise, options.max_steps, move_poses=False)


def estimate_sigmas(problem: Problem, state: State) -> FloatArray:
    """(2,) standard deviations in pixels of the residuals of SfM and edge points, from medians.

    Accounts for residuals being smaller than the noise, since points fit their observations.
    """
    residuals = linearized(problem, state).residuals()
    kinds = np.repeat(problem.kinds, np.diff(problem.measured.offsets))
    sigmas = np.ones(2)
    for kind, directions, freedom in ((SFM, 2, 3), (EDGE, 1, 2)):
        found = residuals[kinds == kind, :directions]
        spare = found.size - freedom * np.count_nonzero(problem.kinds == kind)
        if spare > 0:
            sigmas[kind] = robust_sigma(found) * np.sqrt(found.size / spare)
    return np.maximum(np.where(np.isfinite(sigmas), sigmas, 1.0), 1e-3)


def adjust(problem: Problem, state: State, options: BundleAdjustmentOptions) -> State:
    """Adjust poses and points; re-estimates the noise until residuals no longer decrease."""
    prior = None
    sigmas = np.full(2, np.inf)
    for _ in range(options.max_rounds):
        before, noise = sigmas, Noise.of(problem, state, options)
        sigmas = noise.sigmas_px
        if np.all(sigmas > 0.98 * before):
            break
        prior = prior or model_prior(problem, state, noise, options.prior_observations)
        state, _ = minimize(problem, state, replace(noise, prior=prior), options.max_steps)
    return state


def model_prior(problem: Problem, state: State, noise: Noise, num_observations: float) -> Prior:
    """Information that keeps poses near `state`, and the model's position, orientation and scale.

    Each pose is kept as by `num_observations` points that it shows where it does now, with the
    standard deviation of edges: initial poses are off by what their edges are off.

    Position, orientation and scale are kept as by the measurements of the frames if the points
    were known. Without it the model would drift, since edge points do not move along their edges. A
    rig of several cameras determines the scale itself.
    """
    count = problem.num_frames
    pattern = shared_frames(problem)
    information, _, _ = linearized(problem, state).reduce(
        *noise.weighting, 0.0, pattern.indptr.astype(np.int64), pattern.indices
    )
    centers = frame_centers(problem, state)
    centers -= centers.mean(axis=0)
    moves = np.zeros((count, 6, 7 if len(problem.frames) == count else 6))
    for axis, unit in enumerate(np.eye(3)):
        moves[:, axis, axis] = 1
        moves[:, 3:, axis] = np.cross(unit, centers)
        moves[:, 3 + axis, 3 + axis] = 1
    moves[:, 3:, 6:] = centers[:, :, None]
    held = (information @ moves).reshape(6 * count, -1)
    core = np.linalg.pinv(moves.reshape(6 * count, -1).T @ held, hermitian=True)
    blocks = mean_squared_slopes(problem, state)
    # Motions that displace none of a frame's points are held, too.
    for part in (slice(0, 3), slice(3, 6)):
        all_ways = np.einsum("fii->fi", blocks)[:, part].mean(axis=1, keepdims=True)
        np.einsum("fii->fi", blocks)[:, part] += ANY_WAY * all_ways
    off_px = noise.sigmas_px[EDGE if np.any(problem.kinds == EDGE) else SFM]
    blocks *= num_observations / off_px**2
    unseen = np.einsum("fii->fi", blocks) == 0
    np.einsum("fii->fi", blocks)[unseen] += 1.0
    return Prior(blocks=blocks, held=held, core=core)
