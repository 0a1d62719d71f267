"""How far apart two edges are seen and project, against plain numpy."""

import numpy as np
import pytest
from random_chains import FOCAL, edge_index, random_chains, random_pose, tangents_of

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

RADIUS_PX, MIN_COSINE = 8.0, 0.7


def places_near_chains(rng, chains, pose, count):
    """World points near a view's chains, places beside them and steps along them."""
    points, _, offsets, closed = chains
    at = rng.integers(0, len(points), count)
    pixels, depths = points[at] + rng.normal(0, 2, (count, 2)), rng.uniform(1, 5, count)
    depths[:5] *= -1
    worlds = (depths[:, None] * np.column_stack([pixels / FOCAL, np.ones(count)]) - pose[1]) @ pose[
        0
    ]
    along = np.column_stack([tangents_of(points, offsets, closed)[at], np.zeros(count)]) @ pose[0]
    beside = rng.normal(0, 4 / FOCAL, (count, 3)) * np.abs(depths)[:, None]
    return worlds, beside, along * np.abs(depths)[:, None] * 4 / FOCAL


def separations_reference(view, pose, points, offsets, steps, positions):
    rotation, translation = pose

    def projected(worlds):
        local = worlds @ rotation.T + translation
        return FOCAL * local[:, :2] / np.where(local[:, 2] > 0, local[:, 2], np.nan)[:, None]

    ends = points + offsets
    sides = np.zeros(len(points), np.int8)
    for k, place in enumerate((points, ends)):
        near = _kernels.associate([view], place, steps, sides, RADIUS_PX, MIN_COSINE, 1)[:, 0]
        positions[:, k] = np.where(positions[:, k] >= 0, positions[:, k], near)
    chords = projected(points + steps / 2) - projected(points - steps / 2)
    normals = np.column_stack([-chords[:, 1], chords[:, 0]])
    normals /= np.linalg.norm(chords, axis=1, keepdims=True)
    seen = [_kernels.chain_points(view, np.maximum(of, 0))[0] for of in positions.T.copy()]
    apart = np.sum((seen[1] - seen[0]) * normals, axis=1)
    both = (positions >= 0).all(axis=1)
    return np.sum((projected(ends) - projected(points)) * normals, axis=1), np.where(
        both, apart, np.nan
    )


@pytest.mark.parametrize("seed", range(4))
def test_separations_are_those_of_projections_and_of_chains(seed):
    rng = np.random.default_rng(seed)
    chains, pose = random_chains(rng), random_pose(rng)
    view = edge_index(*chains, pose)
    places = places_near_chains(rng, chains, pose, 300)
    rows = rng.permutation(300)[:200]
    positions = rng.uniform(0, len(chains[0]), (200, 2))
    positions[rng.random(positions.shape) < 0.7] = -1
    expected = separations_reference(view, pose, *(each[rows] for each in places), positions.copy())
    found = _kernels.separations(view, *places, rows, positions, RADIUS_PX, MIN_COSINE, 1)
    assert 5 < np.isfinite(found[1]).sum() < 200
    np.testing.assert_allclose(found, expected, atol=1e-6)
    again = _kernels.separations(view, *places, rows, positions, RADIUS_PX, MIN_COSINE, 3)
    assert again.tobytes() == found.tobytes()


def test_separations_refuse_what_is_not_there():
    rng = np.random.default_rng(1)
    chains, pose = random_chains(rng), random_pose(rng)
    view, places = edge_index(*chains, pose), [np.ones((2, 3))] * 3
    unknown = np.full((1, 2), -1.0)
    for rows, positions in (
        ([2], unknown),
        ([-1], unknown),
        ([0], unknown + 1e9),
        ([0, 1], unknown),
    ):
        with pytest.raises(ValueError):
            _kernels.separations(view, *places, np.array(rows), positions, 4.0, 0.5, 1)
