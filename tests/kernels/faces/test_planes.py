"""Planes chosen among candidates, and what lies on them, are those of plain numpy."""

import numpy as np
import pytest

from colmap_edges.kernels import _kernels

TOLERANCE, SLOPE = 1.5, 0.1
OPTIONS = (TOLERANCE, 0.01, 0.3, 0.7, 0.97)  # in the order of the kernel's options


def random_points(rng, count):
    """Points with tangents, rays and deviations; half of them near three planes."""
    points = rng.random((count, 3))
    for axis in range(3):
        near = slice(axis, count // 2, 3)
        points[near, axis] = 0.5 + 0.01 * rng.normal(size=len(points[near]))
    tangents = rng.normal(size=(count, 3))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    tangents[rng.random(count) < 0.7] = 0
    rays = 0.02 * rng.normal(size=(count, 3))
    return points, tangents, rays, 0.01 * rng.random(count)


def random_planes(rng, count):
    normals = rng.normal(size=(count, 3))
    normals[: count // 2] = np.eye(3)[np.arange(count // 2) % 3]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals, normals.sum(axis=1) * 0.5 + 0.1 * rng.normal(size=count)


def deviations(evidence, normal):
    return np.hypot(evidence[3], evidence[2] @ normal)


def on_plane(evidence, normal, offset, tolerance=TOLERANCE, slope=SLOPE):
    points, tangents = evidence[:2]
    near = np.abs(points @ normal - offset) <= tolerance * deviations(evidence, normal)
    return near & (np.abs(tangents @ normal) <= slope)


def closeness(evidence, normal, offset, tolerance=TOLERANCE):
    off = (evidence[0] @ normal - offset) / (tolerance * deviations(evidence, normal))
    return on_plane(evidence, normal, offset, tolerance) * np.maximum(1 - off**2, 0)


def fitted(evidence, weights, normal, offset):
    for factor in (2, 1.4, 1, 1):
        shares = weights * closeness(evidence, normal, offset, factor * TOLERANCE)
        if np.count_nonzero(shares) < 8:
            return None
        shares /= deviations(evidence, normal) ** 2
        middle = np.average(evidence[0], axis=0, weights=shares)
        off = (evidence[0] - middle) * np.sqrt(shares)[:, None]
        values, vectors = np.linalg.eigh(off.T @ off)
        if values[1] > 0.005 * values[2]:
            normal = vectors[:, 0]
        offset = middle @ normal
    return normal, offset


def snapped(evidence, weights, normal, offset, common):
    nearest = common[np.argmax(np.abs(common @ normal))]
    if abs(nearest @ normal) < np.cos(np.radians(10)):
        return normal, offset
    on = on_plane(evidence, normal, offset)
    tried = np.quantile(evidence[0][on] @ nearest, np.linspace(0.1, 0.9, 17))
    supports = [weights[on_plane(evidence, nearest, at)].sum() for at in tried]
    if max(supports) < OPTIONS[4] * weights[on].sum():
        return normal, offset
    near = on_plane(evidence, nearest, tried[np.argmax(supports)])
    shares = weights[near] / deviations(evidence, nearest)[near] ** 2
    return nearest, np.average(evidence[0][near] @ nearest, weights=shares)


def greedy(evidence, weights, planes, common, max_planes):
    """All candidates are weighed in every round."""
    _, min_share, explained, same_share, _ = OPTIONS
    listed = list(zip(*planes, strict=True))
    members = np.array([on_plane(evidence, *plane) for plane in listed])
    close = np.array([closeness(evidence, *plane) for plane in listed])
    support, left, found, owned = members @ weights, weights.copy(), [], []
    open_ = support >= min_share * weights.sum()
    while len(found) < max_planes and open_.any():
        values = np.where(open_, close @ left, 0)
        best = np.argmax(values)
        if values[best] < min_share * weights.sum():
            break
        open_[best] = False
        plane = fitted(evidence, left, *listed[best])
        if plane is None:
            continue
        plane = snapped(evidence, left, *plane, common)
        own = on_plane(evidence, *plane)
        open_ &= members @ (weights * own) <= same_share * support
        smaller = [min(weights[own].sum(), weights[other].sum()) for other in owned]
        shared = [weights[own & other].sum() for other in owned]
        if (np.array(shared) > same_share * np.array(smaller)).any():
            continue
        kept = (1 - (1 - explained) * closeness(evidence, *plane)) * left
        left[own] = kept[own]
        found.append(plane)
        owned.append(own)
    return found


@pytest.mark.parametrize("seed", range(6))
def test_planes_are_those_of_a_search_that_weighs_all(seed):
    rng = np.random.default_rng(seed)
    evidence = random_points(rng, int(rng.integers(100, 900)))
    weights = rng.random(len(evidence[0]))
    planes, common = random_planes(rng, 200), np.eye(3)[:2]
    expected = greedy(evidence, weights, planes, common, 12)
    normals, offsets, count = _kernels.search_planes(
        *evidence, weights, *planes, common, SLOPE, np.array(OPTIONS), 12, True
    )
    normals, offsets = normals[:count], offsets[:count]
    assert len(offsets) == len(expected) > 3
    for normal, offset, (other, place) in zip(normals, offsets, expected, strict=True):
        sign = np.sign(normal @ other)
        assert normal == pytest.approx(sign * other, abs=1e-6)
        assert offset == pytest.approx(sign * place, abs=1e-6)


def test_no_plane_without_points_or_candidates():
    none, options = np.zeros((0, 3)), np.array(OPTIONS)
    empty = np.zeros(0)
    found = _kernels.search_planes(
        none, none, none, empty, empty, none, empty, none, SLOPE, options, 9, True
    )
    assert found[0].shape == (0, 3)
    evidence = random_points(np.random.default_rng(0), 60)
    found = _kernels.search_planes(
        *evidence, np.ones(60), none, empty, none, SLOPE, options, 9, True
    )
    assert found[1].shape == (0,)


def test_planes_of_points_are_all_within_tolerance():
    rng = np.random.default_rng(2)
    evidence, (normals, offsets) = random_points(rng, 300), random_planes(rng, 9)
    starts, rows = _kernels.planes_of_points(*evidence, normals, offsets, 2.0, 0.3)
    planes = zip(normals, offsets, strict=True)
    expected = np.array([on_plane(evidence, *plane, 2.0, 0.3) for plane in planes]).T
    assert starts.tolist() == [0, *np.cumsum(expected.sum(axis=1))]
    assert rows.tolist() == np.nonzero(expected)[1].tolist()


def test_neighbors_share_the_most_points():
    rng = np.random.default_rng(3)
    sees = rng.random((50, 8)) < 0.3
    sees[:, 7] = False  # a view that sees nothing
    offsets = np.concatenate([[0], np.cumsum(sees.sum(axis=1))])
    observed_offsets = np.concatenate([[0], np.cumsum(sees.sum(axis=0))])
    views, observed = (np.nonzero(of)[1].astype(np.int32) for of in (sees, sees.T))
    starts, rows = _kernels.neighbors_of(offsets, views, observed_offsets, observed, 4)
    shared = sees.T.astype(int) @ sees
    for view in range(8):
        others = [v for v in range(8) if v != view and shared[view, v] > 0]
        expected = sorted(others, key=lambda v, of=shared[view]: (-of[v], v))[:4]
        assert rows[starts[view] : starts[view + 1]].tolist() == expected
