"""Refines poses on SfM points and edges; keeps them only if held-out points fit better."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.arrays import BoolArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.options import BundleAdjustmentOptions
from colmap_edges.poses.problem import EDGE, SFM, Problem, Rows, State, make_problem
from colmap_edges.poses.solver import Noise, adjust, estimate_sigmas, minimize, no_prior


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
    model: Model, edges: Edges3D, options: BundleAdjustmentOptions
) -> tuple[Model, dict[str, Any]]:
    """Refine the poses of a model on its SfM points and its edges.

    The whole stays where it was: position, orientation and scale are those that move the frames
    least. Poses change only if held-out points gain from it in both halves.

    Args:
        model: posed views and SfM points; not changed.
        edges: 3D edges traced with the model's poses.
        options: robustness and effort.

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
