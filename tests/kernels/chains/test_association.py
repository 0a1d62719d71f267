"""Association of 3D points with chains against the nearest of all points."""

import curves as known
import numpy as np
import pytest
from random_chains import FOCAL, edge_index, neighbor, random_chains, random_pose, tangents_of

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


def associate_reference(chains, pose, worlds, directions, sides, max_distance, min_cosine):
    points, normals, offsets, closed = chains
    chain_tangents = tangents_of(points, offsets, closed)
    rotation, translation = pose
    result = np.full(len(worlds), -1.0)
    for row, (world, direction, side) in enumerate(zip(worlds, directions, sides, strict=True)):
        local, turned = rotation @ world + translation, rotation @ direction
        if local[2] <= 0:
            continue
        x = FOCAL * local[:2] / local[2]
        ahead = local + 1e-7 * turned
        t = FOCAL * ahead[:2] / ahead[2] - x
        t /= np.linalg.norm(t)
        distance = np.linalg.norm(points - x, axis=1)
        fits = (distance <= max_distance) & (np.abs(chain_tangents @ t) >= min_cosine)
        fits &= (t[0] * normals[:, 1] - t[1] * normals[:, 0]) * side >= 0
        if not fits.any():
            continue
        i = int(np.argmin(np.where(fits, distance, np.inf)))
        result[row] = i
        step = 1 if (x - points[i]) @ chain_tangents[i] > 0 else -1
        other = neighbor(i, step, offsets, closed)
        if other == i:
            continue
        start, end = (i, other) if step > 0 else (other, i)
        along = points[end] - points[start]
        fraction = np.clip((x - points[start]) @ along / (along @ along), 0, 0.999999)
        result[row] = start + fraction
    return result


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("max_distance", "max_angle_deg"), [(4.0, 15.0), (40.0, 40.0)])
def test_association_equals_the_nearest_of_all_points(seed, max_distance, max_angle_deg):
    rng = np.random.default_rng(seed)
    chains, pose = random_chains(rng), random_pose(rng)
    points, _, offsets, closed = chains
    nearby = rng.integers(0, len(points), 300)
    pixels = points[nearby] + rng.normal(0, 0.5 * max_distance, (300, 2))
    depths = np.where(rng.random(300) < 0.05, -1, 1) * rng.uniform(1, 5, 300)
    locals_ = depths[:, None] * np.column_stack([pixels / FOCAL, np.ones(300)])
    worlds = (locals_ - pose[1]) @ pose[0]
    along = tangents_of(points, offsets, closed)[nearby]
    directions = np.column_stack([along, np.zeros(300)]) @ pose[0]
    directions = (directions + rng.normal(0, 0.2, (300, 3))) * rng.choice([-1, 1], (300, 1))
    sides = rng.integers(-1, 2, 300).astype(np.int8)
    cosine = np.cos(np.radians(max_angle_deg))
    view = edge_index(*chains, pose)
    found = _kernels.associate([view], worlds, directions, sides, max_distance, cosine, 1)[:, 0]
    expected = associate_reference(chains, pose, worlds, directions, sides, max_distance, cosine)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert (found[depths < 0] == -1).all()
    assert 50 < np.sum(found >= 0) < 295
    again = _kernels.associate([view], worlds, directions, sides, max_distance, cosine, 3)[:, 0]
    assert again.tobytes() == found.tobytes()


def drop_lone_reference(positions, offsets):
    same = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    steps = np.abs(np.diff(positions, axis=0))
    steps[same[1:] != same[:-1]] = np.nan
    found = steps[np.isfinite(steps)]
    linked = steps <= (4 * np.median(found) if len(found) else 0.0)
    keep = np.zeros(positions.shape, bool)
    keep[1:] = linked
    keep[:-1] |= linked
    return np.where(keep, positions, np.nan)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0])
def test_lone_observations_are_dropped(share):
    rng = np.random.default_rng(5)
    offsets = np.array([0, 1, 1, 8, 30, 61])
    positions = 1000 + np.cumsum(rng.standard_cauchy((61, 4)), axis=0)
    positions[rng.random(positions.shape) < share] = np.nan
    found = _kernels.drop_lone(positions, offsets)
    np.testing.assert_array_equal(found, drop_lone_reference(positions, offsets))
    assert share == 1 or 0 < np.isfinite(found).sum() < np.isfinite(positions).sum()


def test_many_views_are_associated_as_each_alone():
    rng = np.random.default_rng(7)
    views = [edge_index(*random_chains(rng), random_pose(rng)) for _ in range(3)]
    worlds = rng.uniform((-1, -1, 2), (1, 1, 5), (20000, 3))
    rest = (rng.normal(size=worlds.shape), rng.integers(-1, 2, len(worlds)).astype(np.int8))
    together = _kernels.associate(views, worlds, *rest, 20.0, 0.5, 2)
    alone = [_kernels.associate([view], worlds, *rest, 20.0, 0.5, 1) for view in views]
    assert (together >= 0).any(axis=0).all()
    assert together.tobytes() == np.ascontiguousarray(np.hstack(alone)).tobytes()


def test_association_respects_distance_angle_and_side():
    points = np.column_stack([np.arange(-50.0, 51), np.zeros(101)])
    normals = np.tile([0.0, 1.0], (101, 1))  # to the side +1 of the direction x
    view = edge_index(points, normals, np.array([0, 101]), np.zeros(1, bool))

    def position(y=1.0, angle_deg=0.0, side=0, x=0.3):
        angle = np.radians(angle_deg)
        direction = np.array([[np.cos(angle), np.sin(angle), 0]])
        world = np.array([[x / FOCAL, y / FOCAL, 1]])
        sides = np.array([side], np.int8)
        cosine = np.cos(np.radians(15))
        return _kernels.associate([view], world, direction, sides, 4.0, cosine, 1)[0, 0]

    assert position() == pytest.approx(50.3)
    assert position(y=3.9) == pytest.approx(50.3)
    assert position(y=4.1) == -1
    assert position(angle_deg=14) == position(angle_deg=194) == position()
    assert position(angle_deg=16) == position(angle_deg=-16) == -1
    assert position(side=1) == position(side=-1, angle_deg=180) == position()
    assert position(side=-1) == position(side=1, angle_deg=180) == -1
    assert position(x=51.0) == pytest.approx(100)  # the open end
    assert position(x=-51.0) == pytest.approx(0, abs=1e-6)


def test_association_wraps_round_closed_chains():
    angle = 2 * np.pi * np.arange(200) / 200
    points = 30 * np.column_stack([np.cos(angle), np.sin(angle)])
    view = edge_index(points, points / 30, np.array([0, 200]), np.ones(1, bool))
    between = 2 * np.pi * 199.25 / 200
    world = np.array([[30 * np.cos(between) / FOCAL, 30 * np.sin(between) / FOCAL, 1.0]])
    direction = np.array([[-np.sin(between), np.cos(between), 0]])
    found = _kernels.associate([view], world, direction, np.zeros(1, np.int8), 4.0, 0.9, 1)[:, 0]
    assert found[0] == pytest.approx(199.25, abs=0.01)
    at, _ = _kernels.chain_points(view, found)
    np.testing.assert_allclose(at, FOCAL * world[:, :2], atol=0.01)


def test_points_without_tangents_are_refused():
    view = edge_index(np.zeros((1, 2)), np.zeros((1, 2)), np.array([0, 1]), np.zeros(1, bool))
    with pytest.raises(ValueError, match="differ in length"):
        _kernels.associate(
            [view], np.zeros((2, 3)), np.zeros((1, 3)), np.zeros(2, np.int8), 4.0, 0.9, 1
        )


def test_empty_view_observes_nothing():
    view = edge_index(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(1, np.int64), np.zeros(0, bool))
    one = np.array([[0.0, 0.0, 1.0]])
    found = _kernels.associate([view], one, one, np.zeros(1, np.int8), 4.0, 0.9, 1)
    assert found.tolist() == [[-1]]
    assert known.graph_from_undistorted(known.row(1)[0], [], [], []).num_polylines == 0


def test_positions_slide_along_their_chains():
    points = np.column_stack([np.arange(-50.0, 51), np.zeros(101)])
    straight = edge_index(
        points, np.tile([0.0, 1.0], (101, 1)), np.array([0, 101]), np.zeros(1, bool)
    )
    angle = 2 * np.pi * np.arange(200) / 200
    points = 30 * np.column_stack([np.cos(angle), np.sin(angle)])
    loop = edge_index(points, points / 30, np.array([0, 200]), np.ones(1, bool))
    at = np.array([[3.3, 1.0], [90.0, 0.0], [30 * np.cos(-0.04), 30 * np.sin(-0.04)]])
    curves = (np.eye(3), np.zeros(3), FOCAL, at, np.ones(3))
    start = np.array([[45.0, np.nan], [98.0, np.nan], [np.nan, 3.0]])
    found = _kernels.slide_positions(*curves, start, [straight, loop], 2)
    np.testing.assert_allclose(found[:2, 0], [53.3, 100], atol=1e-5)
    assert found[2, 1] == pytest.approx(200 - 0.04 / (2 * np.pi) * 200, abs=1e-3)
    assert np.isnan(found).tolist() == np.isnan(start).tolist()
