"""The step of the pose adjustment, against dense linear algebra and on many views."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from colmap_edges.poses import problem as ba
from colmap_edges.poses import systems
from colmap_edges.poses.solver import Noise, apply_step, cost_of, minimize, model_prior, solve_step
from colmap_edges.poses.systems import Prior, shared_frames


def street(num_views, points_a_view=20, reach=4, views_a_frame=1, seed=0):
    """Views in a row that look aside; each point is seen by those within `reach`; half on edges.

    Poses, points and pixels are off, so that there is something to adjust.
    """
    rng = np.random.default_rng(seed)
    centers = np.column_stack([np.arange(num_views), np.zeros((num_views, 2))])
    homes = np.repeat(np.arange(num_views), points_a_view)
    points = np.column_stack([homes, *rng.uniform(-2, 2, (2, len(homes)))])
    points[:, 2] += 6
    views = homes[:, None] + np.arange(-reach, reach + 1)
    inside = (views >= 0) & (views < num_views)
    owners, views = np.nonzero(inside)[0], views[inside].astype(np.int32)
    is_edge = np.arange(len(points)) % 2 == 1
    local = points[owners] - centers[views]
    pixels = 500 * local[:, :2] / local[:, 2:] + rng.normal(0, 0.3, (len(owners), 2))
    angles = rng.uniform(0, np.pi, len(owners))
    normals = np.column_stack([np.cos(angles), np.sin(angles)]) * is_edge[owners, None]
    tangents = rng.normal(size=points.shape)
    tangents *= (is_edge / np.linalg.norm(tangents, axis=1))[:, None]
    turns = Rotation.from_rotvec(0.001 * rng.normal(size=(num_views, 3))).as_matrix()
    frames = (np.arange(num_views) // views_a_frame).astype(np.int32)
    count = int(frames.max()) + 1
    problem = ba.Problem(
        rotations=turns,
        translations=-np.einsum("vij,vj->vi", turns, centers),
        focals_px=np.full(num_views, 500.0),
        frames=frames,
        measured=ba.Measurements(
            offsets=np.searchsorted(owners, np.arange(len(points) + 1)),
            views=views,
            pixels=pixels,
            normals=normals,
        ),
        kinds=np.where(is_edge, ba.EDGE, ba.SFM),
        tangents=tangents,
        groups=np.arange(len(points)),
        indices=np.arange(len(points)),
    )
    state = ba.State(
        rotations=Rotation.from_rotvec(0.001 * rng.normal(size=(count, 3))).as_matrix(),
        translations=0.01 * rng.normal(size=(count, 3)),
        moved=0.001 * rng.normal(size=(count, 6)),
        points=points + 0.01 * rng.normal(size=points.shape),
    )
    return problem, state


def noise_of(problem, state):
    """Noise with the prior that holds the whole."""
    noise = Noise(
        sigmas_px=np.array([0.3, 0.2]), robust_factor=2.0, prior=Prior.none(problem.num_frames)
    )
    return replace(noise, prior=model_prior(problem, state, noise, 1e-3))


def numeric_jacobian(problem, state):
    """(2 N, 6 F + 3 P) differences of the residuals by the motions of frames and points."""
    frames, points = np.zeros((problem.num_frames, 6)), np.zeros(state.points.shape)
    columns = []
    for moved in (frames, points):
        for index in range(moved.size):
            moved.flat[index] = 1e-6
            along = np.einsum("pi,pi->p", points, problem.tangents)[:, None] * problem.tangents
            ends = [apply_step(problem, state, s * frames, s * (points - along)) for s in (1, -1)]
            after, before = (ba.linearized(problem, end).residuals().ravel() for end in ends)
            seen = np.isfinite(after)
            columns.append(np.subtract(after, before, where=seen, out=np.zeros(len(seen))) / 2e-6)
            moved.flat[index] = 0
    return np.column_stack(columns)


def dense_prior(prior):
    size = len(prior.held)
    dense = prior.held @ prior.core @ prior.held.T
    for frame, block in enumerate(prior.blocks):
        dense[6 * frame : 6 * frame + 6, 6 * frame : 6 * frame + 6] += block
    assert dense.shape == (size, size)
    return dense


@pytest.mark.parametrize(("few", "narrow"), [(10, 0), (0, 100), (0, 0)])
@pytest.mark.parametrize("views_a_frame", [1, 2])
def test_step_is_that_of_the_dense_equations(views_a_frame, few, narrow, monkeypatch):
    monkeypatch.setattr(systems, "FEW_FRAMES", few)
    monkeypatch.setattr(systems, "NARROW_FRAMES", narrow)
    problem, state = street(8, 5, 2, views_a_frame)
    state.points[3] -= [0, 0, 20]  # behind the views
    noise = noise_of(problem, state)
    jacobian = numeric_jacobian(problem, state)
    residuals = ba.linearized(problem, state).residuals()
    seen = np.isfinite(residuals).all(axis=1)
    assert not seen.all()
    sigmas = noise.sigmas_px[problem.kinds][problem.measured.owners]
    ratios = (residuals**2).sum(axis=1) / (noise.robust_factor * sigmas) ** 2
    weights = np.repeat(np.where(seen, 1 / np.sqrt(1 + ratios) / sigmas, 0), 2)
    jacobian *= weights[:, None]
    weighted = weights * np.where(seen[:, None], residuals, 0).ravel()
    size = 6 * problem.num_frames
    system, gradient = jacobian.T @ jacobian, jacobian.T @ weighted
    prior = dense_prior(noise.prior)
    system[:size, :size] += prior
    gradient[:size] += prior @ state.moved.ravel()
    damping = 1e-3
    for point, tangent in enumerate(problem.tangents):  # edge points do not slide
        at = slice(size + 3 * point, size + 3 * point + 3)
        system[at, at] += np.trace(system[at, at]) * np.outer(tangent, tangent)
    system[np.diag_indices(len(system))] *= 1 + damping
    system[np.diag_indices(len(system))] += 1e-300
    usable = np.diag(system) > 1e-200
    expected = np.zeros(len(system))
    expected[usable] = -np.linalg.solve(system[np.ix_(usable, usable)], gradient[usable])
    step, points = solve_step(problem, state, noise, damping, shared_frames(problem))
    np.testing.assert_allclose(step.ravel(), expected[:size], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(points.ravel(), expected[size:], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("views_a_frame", [1, 2])
def test_slopes_are_those_of_projected_points(views_a_frame):
    problem, state = street(6, 5, 2, views_a_frame)
    # Without normals, residuals are the two coordinates of pixels.
    measured = replace(problem.measured, normals=np.zeros_like(problem.measured.normals))
    problem = replace(problem, measured=measured)
    slopes = numeric_jacobian(problem, state)[:, : 6 * problem.num_frames]
    frames = np.repeat(problem.frames[measured.views], 2)
    found = ba.mean_squared_slopes(problem, state)
    for frame in range(problem.num_frames):
        own = slopes[frames == frame, 6 * frame : 6 * frame + 6]
        expected = own.T @ own / (len(own) / 2)
        np.testing.assert_allclose(found[frame], expected, rtol=1e-5, atol=1e-2)


def test_a_frame_without_points_has_no_slopes():
    problem, state = street(6, 5, 2)
    keep = ~np.isin(problem.measured.views, [0])
    measured = ba.Measurements(
        offsets=np.searchsorted(problem.measured.owners[keep], np.arange(len(problem.kinds) + 1)),
        views=problem.measured.views[keep],
        pixels=problem.measured.pixels[keep],
        normals=problem.measured.normals[keep],
    )
    found = ba.mean_squared_slopes(replace(problem, measured=measured), state)
    assert not found[0].any()
    assert np.isfinite(found).all()


def test_frames_that_share_points():
    problem, _ = street(12, 3, 2, 2)
    dense = np.zeros((6, 6), bool)
    frames, owners = problem.frames[problem.measured.views], problem.measured.owners
    for point in range(len(problem.kinds)):
        seen = frames[owners == point]
        dense[np.ix_(seen, seen)] = True
    found = shared_frames(problem)
    np.testing.assert_array_equal(found.toarray() > 0, dense)
    assert found.has_sorted_indices


@pytest.mark.parametrize("narrow", [100, 0])
def test_many_views_take_memory_by_the_frames_that_share_points(narrow, monkeypatch):
    monkeypatch.setattr(systems, "NARROW_FRAMES", narrow)
    problem, state = street(2000, 10)
    noise = noise_of(problem, state)
    pattern = shared_frames(problem)
    assert pattern.nnz <= 2000 * 17  # of the 4,000,000 pairs
    tracemalloc.start()
    step, points = solve_step(problem, state, noise, 1e-6, pattern)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6  # dense equations of the poses alone take 1,152 MB
    after = cost_of(problem, apply_step(problem, state, step, points), noise)
    assert after < 0.6 * cost_of(problem, state, noise)


def test_steps_lower_the_cost_to_the_noise():
    problem, state = street(40, 40)
    noise = noise_of(problem, state)
    found, cost = minimize(problem, state, noise, 20)
    residuals = ba.linearized(problem, found).residuals()
    kinds = problem.kinds[problem.measured.owners]
    assert np.median(np.abs(residuals[kinds == ba.SFM])) < 0.25
    assert cost < 0.2 * cost_of(problem, state, noise)


def test_undetermined_points_need_damping():
    problem, state = street(6, 2, 1)
    noise = noise_of(problem, state)
    problem.measured.pixels[:] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        solve_step(problem, state, noise, 0.0, shared_frames(problem))


def test_wrong_arrays_are_errors():
    problem, state = street(6, 2, 1)
    equations = ba.linearized(problem, state)
    none = np.zeros(7, np.int64), np.zeros(0, np.int32)
    with pytest.raises(ValueError, match="unknown"):
        equations.reduce((1.0, 1.0), 2.0, 0.0, *none)
    with pytest.raises(ValueError, match="points and tangents"):
        ba.linearized(replace(problem, tangents=problem.tangents[:-1]), state)
