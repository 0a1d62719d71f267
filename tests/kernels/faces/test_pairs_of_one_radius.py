"""Pairs of outlines that may be of one cylinder are those of plain numpy."""

import numpy as np
import pytest

from colmap_edges.kernels import _kernels

MIN_SINE, SLACK_PX = 0.14, 40.0


def units(rng, *shape):
    vectors = rng.normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def random_view(rng, count):
    """The kernel's arguments of a view: half of its pairs are of cylinders along the z axis."""
    center, focal = 4 * units(rng), rng.uniform(300, 600)
    normals, middles = units(rng, count, 2), units(rng, count)
    for of in normals, middles:
        of[: count // 2, ..., 2] *= 0.01
        of /= np.linalg.norm(of, axis=-1, keepdims=True)
    turns, rays = rng.uniform(0, 0.6, (count, 2)), near_axis(rng, center, count)
    return center, focal, normals, middles, turns, rays


def near_axis(rng, center, count):
    """Rays to places near a line along the z axis: of one distance from it, but for noise."""
    angles = rng.uniform(0, 2 * np.pi, (count, 1, 1)) + 0.3 * rng.normal(size=(count, 2, 2))
    around = np.stack([np.cos(angles), np.sin(angles), rng.normal(size=angles.shape)], axis=-1)
    rays = around - center
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def passing(ray, start, axis, point, focal):
    """The distance of a ray from an axis less and plus `SLACK_PX`, and its depth there."""
    sine = np.linalg.norm(np.cross(axis, ray))
    across = point - start - (point - start) @ axis * axis
    depth = across @ ray / sine**2
    distance = abs(np.cross(axis, ray) @ (point - start)) / sine
    return distance - SLACK_PX * depth / focal, distance + SLACK_PX * depth / focal, depth


def are_of_one_radius(one, other, a, b):
    axis = np.cross(one[3][a], other[3][b])
    sine = np.linalg.norm(axis)
    axis /= sine
    turns = [np.abs(view[2][i] @ axis) - view[4][i] for view, i in ((one, a), (other, b))]
    if sine <= MIN_SINE or np.max(turns) >= 0:
        return False
    planes = np.array([one[3][a], other[3][b], axis])
    point = np.linalg.solve(planes, [planes[0] @ one[0], planes[1] @ other[0], axis @ one[0]])
    least, most, depths = np.transpose(
        [
            passing(ray, view[0], axis, point, view[1])
            for view, i in ((one, a), (other, b))
            for ray in view[5][i].reshape(4, 3)
        ]
    )
    return np.all(depths > 0) and max(least.max(), 0) <= most.min()


@pytest.mark.parametrize("seed", range(4))
def test_pairs_of_one_radius_are_those_of_numpy(seed):
    rng = np.random.default_rng(seed)
    one, other = random_view(rng, 60), random_view(rng, 40)
    found = _kernels.pairs_of_one_radius(*one, *other, MIN_SINE, SLACK_PX)
    expected = [(a, b) for a in range(60) for b in range(40) if are_of_one_radius(one, other, a, b)]
    assert len(expected) > 5
    assert [tuple(pair) for pair in found.tolist()] == expected


def test_without_pairs_there_are_none():
    rng = np.random.default_rng(0)
    one, other = random_view(rng, 5), random_view(rng, 0)
    assert _kernels.pairs_of_one_radius(*one, *other, MIN_SINE, SLACK_PX).shape == (0, 2)


def test_arrays_of_other_lengths_are_refused():
    one = random_view(np.random.default_rng(0), 5)
    with pytest.raises(ValueError, match="differs in number"):
        _kernels.pairs_of_one_radius(*one, *one[:5], one[5][:4], MIN_SINE, SLACK_PX)
