"""Sums over observations of curves against finite differences and plain sums."""

from itertools import pairwise

import numpy as np
import pytest
from random_chains import FOCAL, edge_index, neighbor, random_chains, random_pose

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


def observed_reference(reference, undistorted, inverse_depths, directions, positions, view, pose):
    """Residuals, slopes, slopes across and speeds of the points in one view; NaN where unseen."""
    seen = np.isfinite(positions)
    rotation = pose[0] @ reference[0].T
    translation = pose[1] - rotation @ reference[1]

    def projected(pixels, inverse):
        rays = np.column_stack([pixels / FOCAL, np.ones(len(pixels))])
        local = rays @ rotation.T + inverse[:, None] * translation
        return FOCAL * local[:, :2] / local[:, 2:]

    at, tangent = _kernels.chain_points(view, positions[seen])
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    here = projected(undistorted[seen], inverse_depths[seen])
    step = 1e-6
    moving = (projected(undistorted[seen], inverse_depths[seen] + step) - here) / step
    shifted = (
        projected(undistorted[seen] + step * directions[seen], inverse_depths[seen]) - here
    ) / step
    result = np.full((4, len(undistorted)), np.nan)
    for row, vectors in enumerate((here - at, moving, shifted)):
        result[row, seen] = np.sum(vectors * normal, axis=1)
    result[3, seen] = np.linalg.norm(moving, axis=1)
    return result


def test_sums_over_observations_are_those_of_finite_differences():
    rng = np.random.default_rng(5)
    reference, poses, scale = random_pose(rng), [random_pose(rng) for _ in range(4)], 30.0
    chains = [random_chains(rng) for _ in poses]
    views = [edge_index(*parts, pose) for parts, pose in zip(chains, poses, strict=True)]
    count = 600
    undistorted, inverse = rng.uniform(-150, 150, (count, 2)), rng.uniform(0.1, 0.3, count)
    directions = rng.normal(size=(count, 2))
    positions = np.column_stack([rng.uniform(0, len(parts[0]), count) for parts in chains])
    positions[rng.random(positions.shape) < 0.3] = np.nan
    positions[0] = np.nan
    curves = (*reference, FOCAL, undistorted, inverse)
    residuals, slopes, across, speeds = np.stack(
        [
            observed_reference(
                reference, undistorted, inverse, directions, positions[:, k], view, pose
            )
            for k, (view, pose) in enumerate(zip(views, poses, strict=True))
        ],
        axis=2,
    )
    weights = 1 / (1 + (residuals / scale) ** 2) ** 2
    products = (slopes**2, slopes * residuals, slopes * across, across**2, across * residuals)
    expected = [np.nansum(weights * each, axis=1) for each in products]
    expected += [np.nansum(speeds**2, axis=1), np.isfinite(positions).sum(axis=1)]
    sums = _kernels.sum_observations(*curves, directions, positions, views, scale, 1)
    for found, wanted in zip(sums, expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=1e-4 * np.abs(wanted).max())
    again = _kernels.sum_observations(*curves, directions, positions, views, scale, 3)
    assert again.tobytes() == sums.tobytes()
    found, slopes2 = _kernels.observation_residuals(*curves, positions, views, 2)
    np.testing.assert_allclose(found, residuals, atol=1e-9)
    np.testing.assert_allclose(slopes2, np.nansum(slopes**2, axis=1), rtol=1e-3)
    with pytest.raises(ValueError, match="differ in length"):
        _kernels.observation_residuals(*curves, positions, views[:3], 1)
    with pytest.raises(ValueError, match="not on a chain"):
        _kernels.observation_residuals(*curves, positions + 1e6, views, 1)


def test_drifts_are_the_residuals_of_a_circle_that_tangents_do_not_explain():
    rng = np.random.default_rng(9)
    reference, poses, scale = random_pose(rng), [random_pose(rng) for _ in range(5)], 30.0
    chains = [random_chains(rng) for _ in poses]
    views = [edge_index(*parts, pose) for parts, pose in zip(chains, poses, strict=True)]
    count = 100
    undistorted, inverse = rng.uniform(-150, 150, (count, 2)), rng.uniform(0.1, 0.3, count)
    directions = rng.normal(size=(count, 2))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    positions = np.column_stack([rng.uniform(0, len(parts[0]), count) for parts in chains])
    positions[rng.random(positions.shape) < 0.2] = np.nan
    curves = (*reference, FOCAL, undistorted, inverse)
    found = _kernels.rounding_drifts(*curves, directions, positions, views, scale, 1)
    rows = np.full((4, count, len(views)), np.nan)  # residual, slope, across, rounding
    world = (np.column_stack([undistorted / FOCAL, np.ones(count)]) / inverse[:, None]) - (
        reference[1]
    )
    for k, (view, pose, parts) in enumerate(zip(views, poses, chains, strict=True)):
        at = observed_reference(
            reference, undistorted, inverse, directions, positions[:, k], view, pose
        )
        rows[:3, :, k] = at[:3]
        seen = np.flatnonzero(np.isfinite(positions[:, k]))
        tangent = _kernels.chain_points(view, positions[seen, k])[1]
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
        bright = parts[1][positions[seen, k].astype(int)]
        local = world[seen] @ reference[0] @ pose[0].T + pose[1]
        pixels = FOCAL * local[:, :2] / local[:, 2:]
        # Pixels per world unit across the plane of sight through the line.
        plane = np.column_stack([normal, -np.sum(normal * pixels, axis=1) / FOCAL])
        speed = FOCAL / local[:, 2] * np.linalg.norm(plane, axis=1)
        rows[3, seen, k] = np.sign(np.sum(normal * bright, axis=1)) * speed
    own = np.linalg.norm(
        np.column_stack([directions, np.sum(directions * undistorted, axis=1) / FOCAL]), axis=1
    )
    rows[3] /= (FOCAL * inverse * own)[:, None]  # per pixel of the reference view
    for i in range(count):
        seen = np.isfinite(positions[i])
        if seen.sum() < 2:
            continue
        residual, slope, across, rounding = rows[:, i, seen]
        side = np.sign(np.sum(across * rounding))
        matrix = np.column_stack([np.append(slope, 0), np.append(across, 1)])
        root = np.append(1 / (1 + (residual / scale) ** 2), 1)
        solved = np.linalg.lstsq(root[:, None] * matrix, root * np.append(rounding, side), None)[0]
        expected = rounding - np.column_stack([slope, across]) @ solved
        np.testing.assert_allclose(found[i, seen], expected, atol=0.02 * np.abs(rounding).max())
        assert np.isnan(found[i, ~seen]).all()
    again = _kernels.rounding_drifts(*curves, directions, positions, views, scale, 3)
    assert again.tobytes() == found.tobytes()
    with pytest.raises(ValueError, match="differ in length"):
        _kernels.rounding_drifts(*curves, directions[1:], positions, views, scale, 1)


def smooth_gray(index, fraction, reach, sides, offsets, closed):
    """(2,) mean gray over `reach` points to both sides of a fractional position."""
    here, after = (
        np.mean(
            [sides[neighbor(index, k + ahead, offsets, closed)] for k in range(-reach, reach + 1)],
            axis=0,
        )
        for ahead in (0, 1)
    )
    return (1 - fraction) * here + fraction * after


def gray_differences(chain, sides, own, position, speed, reach):
    """(2,) gray less the reference view's, (2,) its change with inverse depth; None off scale."""
    points, _, offsets, closed = chain
    index, step = int(position), max(reach, 1)
    ends = (neighbor(index, steps, offsets, closed) for steps in (1, -1))
    spacing = 0.5 * np.linalg.norm(np.subtract(*(points[end] for end in ends)))
    if not 0.4 < spacing < 2:
        return None

    def gray(steps):
        at = neighbor(index, steps, offsets, closed)
        return smooth_gray(at, position - index, reach, sides, offsets, closed)

    return gray(0) - own, (gray(step) - gray(-step)) / (2 * step) * speed / spacing


def add_side_gray(rows, window, information, gradient):
    """Add what the (point, difference, slope) of one curve in one view on one side say."""
    if len(rows) < 6:
        return
    at, difference, slope = (np.array(column) for column in zip(*rows, strict=True))
    near = np.abs(at[:, None] - at) <= window
    difference = difference - near @ difference / near.sum(axis=1)
    slope = slope - near @ slope / near.sum(axis=1)
    noise2 = np.maximum(near @ difference**2 / near.sum(axis=1), 1)
    weight = (near.sum(axis=1) >= 6) / noise2 / (1 + difference**2 / (4 * noise2)) ** 2
    information[at] += weight * slope**2
    gradient[at] -= weight * slope * difference


@pytest.mark.parametrize("reach", [0, 2])
def test_side_gray_is_that_of_plain_sums(reach):
    rng = np.random.default_rng(8)
    reference, poses = random_pose(rng), [random_pose(rng) for _ in range(3)]
    chains = [random_chains(rng) for _ in range(4)]
    grays = [rng.integers(0, 256, (len(chain[0]), 2)).astype(np.uint8) for chain in chains]
    own, *views = (
        edge_index(*chain, pose, sides=sides)
        for chain, pose, sides in zip(chains, [reference, *poses], grays, strict=True)
    )
    offsets, window = np.array([0, 5, 45, 120, 200]), 4
    count = offsets[-1]
    undistorted, inverse = rng.uniform(-150, 150, (count, 2)), rng.uniform(0.1, 0.3, count)
    indices = rng.integers(0, len(chains[0][0]), count)
    positions = np.column_stack([rng.uniform(0, len(c[0]), count) for c in chains[1:]])
    positions[rng.random(positions.shape) < 0.2] = np.nan
    curves = (*reference, FOCAL, undistorted, inverse)
    information, gradient = np.zeros(count), np.zeros(count)
    for k, pose in enumerate(poses):
        rotation = pose[0] @ reference[0].T
        translation = pose[1] - rotation @ reference[1]
        for first, last in pairwise(offsets):
            rows = ([], [])
            for i in range(first, last):
                if np.isnan(positions[i, k]):
                    continue
                local = rotation @ [*undistorted[i] / FOCAL, 1] + inverse[i] * translation
                moving = FOCAL * (translation[:2] - local[:2] / local[2] * translation[2])
                tangent = _kernels.chain_points(views[k], positions[i : i + 1, k])[1][0]
                driven = smooth_gray(indices[i], 0.0, reach, grays[0], *chains[0][2:])
                speed = moving / local[2] @ tangent
                found = gray_differences(
                    chains[k + 1], grays[k + 1], driven, positions[i, k], speed, reach
                )
                for side in range(2) if found else ():
                    rows[side].append((i, found[0][side], found[1][side]))
            for of_side in rows:
                add_side_gray(of_side, window, information, gradient)
    arguments = (own, indices, offsets, reach, window)
    sums = _kernels.sum_side_gray(*curves, positions, views, *arguments, 1)
    assert (information > 0).sum() > 100
    np.testing.assert_allclose(sums[0], information, rtol=1e-5)
    np.testing.assert_allclose(sums[1], gradient, rtol=1e-5, atol=1e-6 * np.abs(gradient).max())
    again = _kernels.sum_side_gray(*curves, positions, views, *arguments, 3)
    assert again.tobytes() == sums.tobytes()
    with pytest.raises(ValueError, match="not on a chain of the reference view"):
        _kernels.sum_side_gray(
            *curves, positions, views, own, indices + 10**6, offsets, reach, window, 1
        )
    with pytest.raises(ValueError, match="end at the number of points"):
        _kernels.sum_side_gray(*curves, positions, views, own, indices, offsets[:-1], 0, 1, 1)
    with pytest.raises(ValueError, match="must not decrease"):
        _kernels.sum_side_gray(
            *curves, positions, views, own, indices, offsets[[0, 2, 1, 3, 4]], 0, 1, 1
        )
    with pytest.raises(ValueError, match="differ in length"):
        _kernels.sum_side_gray(*curves, positions, views, own, indices[:-1], offsets, 0, 1, 1)
