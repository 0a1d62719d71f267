"""Refinement of poses on SfM points and edges, accepted only if held-out points fit better."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.arrays import BoolArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.options import BundleAdjustmentOptions
from colmap_edges.poses.problem import EDGE, SFM, Problem, State, make_problem
from colmap_edges.poses.solver import Noise, adjust, estimate_sigmas, minimize
from colmap_edges.poses.systems import Prior


def part_of(problem: Problem, state: State, chosen: BoolArray) -> tuple[Problem, State]:
    """The problem restricted to the chosen (P,) points."""
    smaller = replace(
        problem,
        measured=problem.measured.selected(chosen),
        kinds=problem.kinds[chosen],
        tangents=problem.tangents[chosen],
        groups=problem.groups[chosen],
        indices=problem.indices[chosen],
    )
    return smaller, replace(state, points=state.points[chosen])


def held_out_costs(
    problem: Problem, start: State, options: BundleAdjustmentOptions, num_threads: int
) -> list[tuple[float, float]]:
    """Costs of each half of the points, with the initial poses and with those of the other half.

    All points of a 3D edge are in one half. Refined poses lower the cost of held-out points only if
    the initial poses were wrong; fitting noise raises it.
    """
    half = np.unique(problem.groups, return_inverse=True)[1] % 2 == 1

    def costs_by(used: BoolArray) -> tuple[float, float]:
        moved = adjust(*part_of(problem, start, used), options)
        held_out, before = part_of(problem, start, ~used)
        noise = Noise(
            sigmas_px=estimate_sigmas(held_out, before),
            robust_factor=options.robust_factor,
            prior=Prior.none(problem.num_frames),
        )
        after = replace(moved, points=before.points)
        cost, refined_cost = (
            minimize(held_out, state, noise, options.max_steps, move_poses=False)[1]
            for state in (before, after)
        )
        return cost, refined_cost

    with ThreadPoolExecutor(min(num_threads, 2)) as pool:
        return list(pool.map(costs_by, (half, ~half)))


def refine_poses(
    model: Model, edges: Edges3D, options: BundleAdjustmentOptions, num_threads: int = 1
) -> tuple[Model, dict[str, Any]]:
    """Refine the poses of a model on its SfM points and its edges.

    Position, orientation and scale of the model are kept, so that frames move as little as
    possible. Poses change only if this lowers the cost of the held-out points in both halves.

    Args:
        model: posed views and SfM points; not changed.
        edges: 3D edges traced with the model's poses.
        options: robustness and effort.
        num_threads: number of threads (at most two are used); does not affect the result.

    Returns:
        The model with refined poses and SfM points, or `model` itself, and counts.
    """
    problem, start = make_problem(model, edges)
    stats: dict[str, Any] = {
        "frames": problem.num_frames,
        "sfm_points": np.count_nonzero(problem.kinds == SFM),
        "edge_points": np.count_nonzero(problem.kinds == EDGE),
        "refined": False,
    }
    if problem.num_residuals < 6 * problem.num_frames + 3 * len(problem.kinds):
        return model, stats  # too few measurements
    costs = held_out_costs(problem, start, options, num_threads)
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
    """The model with the adjusted frames and SfM points."""
    points = model.points3D_xyz.copy()
    sfm = problem.kinds == SFM
    points[problem.indices[sfm]] = state.points[sfm]
    motions = np.concatenate([state.rotations, state.translations[:, :, None]], axis=2)
    return moved_model(model, motions, points)
