"""Refinement of lens distortion: a second coefficient, accepted if held-out points fit better.

SIMPLE_RADIAL, COLMAP's default camera model, has one coefficient of radial distortion. Lenses of
phones, video cameras and zooms often need two; without the second one observations are off by up to
some pixels, by other amounts in each view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from colmap_edges.colmap.lenses import (
    adjusted,
    motions_between,
    reconstruction_of,
    with_lenses_of,
)
from colmap_edges.colmap.model import Model
from colmap_edges.colmap.thinning import thinned
from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.options import BundleAdjustmentOptions
from colmap_edges.poses.problem import make_problem, start_state
from colmap_edges.poses.refine import part_of, poses_of, with_all_points
from colmap_edges.poses.solver import Noise, fit_points

MIN_POINTS = 100  # fewer do not tell lenses from noise
MAX_VIEWS = 50  # views of which points are held out


def refine_distortion(
    model: Model, options: BundleAdjustmentOptions, random_seed: int = 0
) -> tuple[Model, dict[str, Any]]:
    """Give SIMPLE_RADIAL cameras a second coefficient if held-out SfM points fit better for it.

    Then cameras, poses and SfM points are adjusted together. Position, orientation and scale of the
    model are kept.

    Args:
        model: posed views and SfM points; not changed.
        options: minimum gain, and number of observations that are adjusted to.
        random_seed: seed of the choice of points.

    Returns:
        The model, the given one if too little is gained, and counts.
    """
    few_points = thinned(model, random_seed, options.tested_observations)
    gain = held_out_gain(few_points, options)
    stats: dict[str, Any] = {"refined": gain >= options.min_gain, "held_out_gain": gain}
    if not stats["refined"]:
        return model, stats
    refined = adjusted(few_points, second=True)
    lenses = with_lenses_of(model, refined)
    if not all(map(sees_as_much, lenses.views, model.views)):
        return model, stats | {"refined": False}
    motions = motions_between(few_points, refined)
    start = start_state(lenses, lenses.points3D_xyz)
    at = replace(start, rotations=motions[:, :, :3], translations=motions[:, :, 3])
    return moved_model(lenses, poses_of(lenses, *with_all_points(lenses, at, options))), stats


def sees_as_much(view: View, given: View) -> bool:
    """Whether the distortion of a view can be undone wherever it can be with its given lens."""
    sides = (np.linspace(0, side, 17) for side in (view.width, view.height))
    pixels = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    seen, before = (np.isfinite(of.undistorted_from_image(pixels)) for of in (view, given))
    return bool((seen | ~before).all())


def held_out_gain(model: Model, options: BundleAdjustmentOptions) -> float:
    """By how much a second coefficient lowers the cost of held-out SfM points, relative to it.

    Cameras and poses are adjusted to either half of the points, with and without it.
    """
    model = best_connected(model)
    if len(model.point3D_ids) < MIN_POINTS:
        return 0.0
    model = replace(model, reconstruction=reconstruction_of(model))  # is copied in less time
    first = np.arange(len(model.point3D_ids)) % 2 == 0
    costs = np.zeros(2)
    for half in (first, ~first):
        fitted, held_out = model.selected(half), model.selected(~half)
        costs += costs_of(held_out, [adjusted(fitted, second=s) for s in (False, True)], options)
    return float(1 - costs[1] / max(costs[0], 1e-300))


def best_connected(model: Model) -> Model:
    """At most `MAX_VIEWS` of the views, which share the most points with the one that has most."""
    counts = np.bincount(model.track_views, minlength=len(model.views))
    of_best = np.zeros(len(model.point3D_ids), bool)
    of_best[model.track_points[model.track_views == np.argmax(counts)]] = True
    shared = np.bincount(model.track_views[of_best[model.track_points]], minlength=len(counts))
    chosen = model.without_views(np.argsort(-shared, kind="stable")[MAX_VIEWS:])
    return chosen.selected(np.diff(chosen.track_offsets) >= 2)


def costs_of(points: Model, fits: Sequence[Model], options: BundleAdjustmentOptions) -> FloatArray:
    """(K,) costs of points, moved to where they fit best, for cameras and poses of K fits.

    All are in the noise of the first one.
    """
    made = [replace(points, views=fit.views, reconstruction=fit.reconstruction) for fit in fits]
    problems = [make_problem(model, Edges3D.none()) for model in made]
    common = reduce(np.intersect1d, [problem.indices for problem, _ in problems])
    parts = [part_of(*each, np.isin(each[0].indices, common)) for each in problems]
    problem, start = parts[0]
    state, _ = fit_points(problem, start, Noise.of(problem, start, options), options)
    parts[0], noise = (problem, state), Noise.of(problem, state, options)
    return np.array([fit_points(*part, noise, options)[1] for part in parts])
