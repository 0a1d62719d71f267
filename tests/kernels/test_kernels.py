"""The kernels of EdgeView, association and crossings against plain numpy on random chains."""

from itertools import pairwise

import curves as known
import numpy as np
import pytest

from colmap_edges.core.arrays import offsets_of
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

FOCAL = 500.0


def single(array):
    """`array` rounded to single precision, in which the kernels keep points."""
    return array.astype(np.float32).astype(np.float64)


def random_chains(rng, count=12, closed_share=0.3):
    """Smooth random chains about 1 px apart: points, normals, offsets, closed."""
    points, normals, closed = [], [], []
    for _ in range(count):
        length = int(rng.integers(1, 120))
        loop = bool(rng.random() < closed_share) and length > 8
        if loop:
            angle = 2 * np.pi * np.arange(length) / length
            radii = length / (2 * np.pi) * (1 + 0.2 * np.cos(3 * angle + rng.uniform(0, 6)))
            part = radii[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        else:
            heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.08, length))
            part = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
        points.append(part + rng.uniform((-200, -150), (200, 150)))
        side = rng.choice([-1, 1])
        ahead = np.gradient(part, axis=0) if length > 1 else np.ones((1, 2))
        across = side * np.column_stack([-ahead[:, 1], ahead[:, 0]])
        normals.append(across / np.linalg.norm(across, axis=1, keepdims=True))
        closed.append(loop)
    offsets = offsets_of(np.array([len(part) for part in points], np.int64))
    return (
        single(np.concatenate(points)),
        single(np.concatenate(normals)),
        offsets,
        np.array(closed),
    )


def neighbor(index, steps, offsets, closed):
    """Point `steps` after `index` on its polyline, stopping at open ends."""
    p = np.searchsorted(offsets, index, side="right") - 1
    first, count = offsets[p], offsets[p + 1] - offsets[p]
    place = index - first + steps
    return first + (place % count if closed[p] else np.clip(place, 0, count - 1))


def tangents_of(points, offsets, closed):
    result = np.zeros_like(points)
    for i in range(len(points)):
        chord = points[neighbor(i, 3, offsets, closed)] - points[neighbor(i, -3, offsets, closed)]
        size = np.linalg.norm(chord)
        result[i] = chord / size if size > 0 else (1, 0)
    return result


def random_pose(rng):
    q = rng.normal(size=4) * (1, 0.1, 0.1, 0.1) + (3, 0, 0, 0)
    w, x, y, z = q / np.linalg.norm(q)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation, rng.normal(0, 0.5, 3)


ANY_SIDES = np.ones((256, 256), np.float32)


def edge_view(points, normals, offsets, closed, pose=None, focal=FOCAL, sides=None):
    rotation, translation = pose if pose else (np.eye(3), np.zeros(3))
    sides = np.zeros((len(points), 2), np.uint8) if sides is None else sides
    return _kernels.EdgeView(points, normals, sides, offsets, closed, rotation, translation, focal)


@pytest.mark.parametrize("seed", range(4))
def test_chain_points_are_linear_between_points_and_wrap(seed):
    rng = np.random.default_rng(seed)
    points, normals, offsets, closed = random_chains(rng)
    view = edge_view(points, normals, offsets, closed)
    positions = np.concatenate([np.arange(len(points)), rng.uniform(0, len(points), 500)])
    at, tangents = _kernels.chain_points(view, positions)
    low = positions.astype(int)
    expected = np.empty_like(at)
    for row, i in enumerate(low):
        p = np.searchsorted(offsets, i, side="right") - 1
        last = i == offsets[p + 1] - 1
        following = i + 1 if not last else (offsets[p] if closed[p] else i)
        expected[row] = points[i] + (positions[row] - i) * (points[following] - points[i])
    np.testing.assert_allclose(at, expected, atol=1e-12)
    np.testing.assert_allclose(tangents, tangents_of(points, offsets, closed)[low], atol=1e-7)


@pytest.mark.parametrize("position", [-0.1, 5.0, np.nan, np.inf])
def test_positions_off_the_chains_are_refused(position):
    points = np.column_stack([np.arange(5.0), np.zeros(5)])
    view = edge_view(points, np.zeros((5, 2)), np.array([0, 5]), np.zeros(1, bool))
    with pytest.raises(ValueError, match="not on a chain"):
        _kernels.chain_points(view, np.array([position]))


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
    view = edge_view(*chains, pose)
    found = _kernels.associate([view], worlds, directions, sides, max_distance, cosine, 1)[:, 0]
    expected = associate_reference(chains, pose, worlds, directions, sides, max_distance, cosine)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert (found[depths < 0] == -1).all()
    assert 50 < np.sum(found >= 0) < 295
    again = _kernels.associate([view], worlds, directions, sides, max_distance, cosine, 3)[:, 0]
    assert again.tobytes() == found.tobytes()


def test_many_views_are_associated_as_each_alone():
    rng = np.random.default_rng(7)
    views = [edge_view(*random_chains(rng), random_pose(rng)) for _ in range(3)]
    worlds = rng.uniform((-1, -1, 2), (1, 1, 5), (20000, 3))
    rest = (rng.normal(size=worlds.shape), rng.integers(-1, 2, len(worlds)).astype(np.int8))
    together = _kernels.associate(views, worlds, *rest, 20.0, 0.5, 2)
    alone = [_kernels.associate([view], worlds, *rest, 20.0, 0.5, 1) for view in views]
    assert (together >= 0).any(axis=0).all()
    assert together.tobytes() == np.ascontiguousarray(np.hstack(alone)).tobytes()


def observed_reference(driver, ideal, inverse_depths, directions, positions, view, pose):
    """Residuals, slopes, slopes across and speeds of the points in one view; NaN where unseen."""
    seen = np.isfinite(positions)
    rotation = pose[0] @ driver[0].T
    translation = pose[1] - rotation @ driver[1]

    def projected(pixels, inverse):
        rays = np.column_stack([pixels / FOCAL, np.ones(len(pixels))])
        local = rays @ rotation.T + inverse[:, None] * translation
        return FOCAL * local[:, :2] / local[:, 2:]

    at, tangent = _kernels.chain_points(view, positions[seen])
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    here = projected(ideal[seen], inverse_depths[seen])
    step = 1e-6
    moving = (projected(ideal[seen], inverse_depths[seen] + step) - here) / step
    shifted = (projected(ideal[seen] + step * directions[seen], inverse_depths[seen]) - here) / step
    result = np.full((4, len(ideal)), np.nan)
    for row, vectors in enumerate((here - at, moving, shifted)):
        result[row, seen] = np.sum(vectors * normal, axis=1)
    result[3, seen] = np.linalg.norm(moving, axis=1)
    return result


def test_sums_over_observations_are_those_of_finite_differences():
    rng = np.random.default_rng(5)
    driver, poses, scale = random_pose(rng), [random_pose(rng) for _ in range(4)], 30.0
    chains = [random_chains(rng) for _ in poses]
    views = [edge_view(*parts, pose) for parts, pose in zip(chains, poses, strict=True)]
    count = 600
    ideal, inverse = rng.uniform(-150, 150, (count, 2)), rng.uniform(0.1, 0.3, count)
    directions = rng.normal(size=(count, 2))
    positions = np.column_stack([rng.uniform(0, len(parts[0]), count) for parts in chains])
    positions[rng.random(positions.shape) < 0.3] = np.nan
    positions[0] = np.nan
    curves = (*driver, FOCAL, ideal, inverse)
    residuals, slopes, across, speeds = np.stack(
        [
            observed_reference(driver, ideal, inverse, directions, positions[:, k], view, pose)
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


def test_association_respects_distance_angle_and_side():
    points = np.column_stack([np.arange(-50.0, 51), np.zeros(101)])
    normals = np.tile([0.0, 1.0], (101, 1))  # to the side +1 of the direction x
    view = edge_view(points, normals, np.array([0, 101]), np.zeros(1, bool))

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
    view = edge_view(points, points / 30, np.array([0, 200]), np.ones(1, bool))
    between = 2 * np.pi * 199.25 / 200
    world = np.array([[30 * np.cos(between) / FOCAL, 30 * np.sin(between) / FOCAL, 1.0]])
    direction = np.array([[-np.sin(between), np.cos(between), 0]])
    found = _kernels.associate([view], world, direction, np.zeros(1, np.int8), 4.0, 0.9, 1)[:, 0]
    assert found[0] == pytest.approx(199.25, abs=0.01)
    at, _ = _kernels.chain_points(view, found)
    np.testing.assert_allclose(at, FOCAL * world[:, :2], atol=0.01)


def line_chains(rng, count):
    """Straight chains, each side of which is a dark one and a bright one at once: no normals."""
    parts = []
    for _ in range(count):
        direction = rng.normal(size=2)
        direction /= np.linalg.norm(direction)
        length = rng.integers(10, 80)
        parts.append(rng.uniform(-200, 200, 2) + np.arange(length)[:, None] * direction)
    offsets = offsets_of(np.array([len(part) for part in parts], np.int64))
    points = single(np.concatenate(parts))
    return points, np.zeros_like(points), offsets, np.zeros(count, bool)


def crossings_reference(chains, start, end):
    """(position, fraction of start -> end) of every chain segment crossed by start -> end."""
    points, _, offsets, _ = chains
    inner = np.ones(len(points), bool)
    inner[offsets[1:] - 1] = False
    first = np.flatnonzero(inner)
    along, chord = points[first + 1] - points[first], end - start
    gap = points[first] - start
    det = chord[0] * along[:, 1] - chord[1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (gap[:, 0] * along[:, 1] - gap[:, 1] * along[:, 0]) / det
        t = (gap[:, 0] * chord[1] - gap[:, 1] * chord[0]) / det
    hit = (s >= 0) & (s <= 1) & (t >= 0) & (t < 1)
    return first[hit] + t[hit], s[hit]


def project(rotation, translation, pixel, rho):
    local = rotation @ np.array([*(pixel / FOCAL), 1.0]) + rho * translation
    return FOCAL * local[:2] / local[2]


@pytest.mark.parametrize("seed", range(4))
def test_crossings_are_those_of_all_segments(seed):
    """A neighbour given twice agrees with itself in each crossing: the sample gets one of them."""
    rng = np.random.default_rng(seed)
    chains = line_chains(rng, 80)
    translation = rng.choice([-1, 1], 3) * rng.uniform((0.5, 0.5, 0), (1, 1, 0.4))
    pose = random_pose(rng)[0], translation
    samples = single(rng.uniform(-100, 100, (150, 2)))
    source = edge_view(
        samples, np.zeros((150, 2)), np.arange(151, dtype=np.int64), np.zeros(150, bool)
    )
    view = edge_view(*chains, pose)
    counts = np.zeros(3, int)
    for index, sample in enumerate(samples):
        low, high = np.sort(rng.uniform(0.05, 0.9, 2))
        if rng.random() < 0.3:  # short pieces, most of which cross nothing or one chain
            high = low + 0.1 * (high - low)
        depth, _, _, _, _, positions = _kernels.chain_depths(
            source, [view, view], np.array([index]), np.array([0, 1]), np.array([[low, high]]),
            steps=1.0,
            max_disagreement_px=0.1,
            side_likelihoods=ANY_SIDES,
            min_angle_sin=0.0, visibility_rate=1.0, detection_rate=0.6, none_score=-1e9,
            break_penalty=0.0, max_clusters=6, num_threads=1,
        )  # fmt: skip
        start, end = (project(*pose, sample, rho) for rho in (low, high))
        if np.linalg.norm(end - start) < 1.1:
            continue
        expected, _ = crossings_reference(chains, start, end)
        margin = 1e-3 * (end - start)
        wider, _ = crossings_reference(chains, start - margin, end + margin)
        ends = np.abs(expected - np.round(expected)) < 1e-3
        if len(wider) != len(expected) or ends.any():
            continue  # at the very end of the piece or of a segment: either answer is right
        counts[min(len(expected), 2)] += 1
        assert len(positions) == (2 if len(expected) else 0)
        if len(expected):
            assert positions[0] == positions[1]
            assert np.abs(expected - positions[0]).min() < 1e-6
            at, _ = _kernels.chain_points(view, positions[:1])
            np.testing.assert_allclose(project(*pose, sample, depth[0]), at[0], atol=1e-6)
    assert counts.min() > 5, counts


MIDDLES = (np.arange(1000) + 0.5) / 1000  # of equal parts of 0 to 1


def two_crossings(their_sides, off_px=0.0):
    """A chain through the origin, and two views that see chains at depths of 2 and of 4 there.

    Those of the second, whose baseline is twice as long, are off to the side.
    """
    along = np.linspace(-20, 20, 41)
    points, normals = np.column_stack([np.zeros(41), along]), np.tile([[1.0, 0.0]], (82, 1))
    source = edge_view(
        points,
        normals[:41],
        np.array([0, 41]),
        np.zeros(1, bool),
        sides=gray_sides(41 * [(60, 180)]),
    )
    views = []
    for shift in (0.5, 1.0):  # to the side, so that a depth of z is seen FOCAL * shift / z away
        places = [FOCAL * shift / z + (off_px if shift == 1 else 0) for z in (2, 4)]
        chains = [np.column_stack([np.full(41, place), along]) for place in places]
        pose = np.eye(3), np.array([shift, 0.0, 0.0])
        sides = gray_sides(np.repeat(their_sides, 41, axis=0))
        offsets = np.array([0, 41, 82])
        views.append(
            edge_view(
                np.concatenate(chains), normals, offsets, np.zeros(2, bool), pose, sides=sides
            )
        )
    return source, views


def gray_sides(values):
    return np.array(values, np.uint8)


def depth_by_sides(their_sides, table, off_px=0.0):
    source, views = two_crossings(their_sides, off_px)
    depths, _, scores, _, _, positions = _kernels.chain_depths(
        source, views, np.array([20]), np.array([0, 1]), np.array([[0.1, 1.0]]), 1.0, 1.0, table,
        0.1, 0.5, 0.8, 0.0, 4.0, 6, 1,
    )  # fmt: skip
    return depths[0], scores[0], len(positions)


@pytest.mark.parametrize("true_depth", [2, 4])
def test_depth_where_the_sides_look_alike_is_likelier(true_depth):
    likelier = ANY_SIDES.copy()
    likelier[:5, :5], likelier[:, 100:] = 3.0, 0.5
    alike, other, unlike = (63, 177), (63, 120), (63, 60)
    sides, others = (
        [same, unlike] if true_depth == 2 else [unlike, same] for same in (alike, other)
    )
    depth, score, supports = depth_by_sides(sides, likelier)
    assert depth == pytest.approx(1 / true_depth)
    assert supports == 2
    # What the sides say counts once a view that sees the edge, in proportion.
    same_depth, neither, _ = depth_by_sides(others, likelier)
    assert same_depth == depth
    nearest = 0.2 + 0.8 / np.exp(-2 * MIDDLES**2).mean()  # of crossings at one place
    seen = []
    for each in (score, neither):  # the logarithm of (1 + seen) (1 + nearest seen) / 4
        roots = np.roots([nearest, 1 + nearest, 1 - 4 * np.exp(each)])
        seen.append(roots.max())
    assert seen[0] == pytest.approx(3 * seen[1])


def test_the_nearer_crossings_are_the_more_they_agree():
    shares = np.array([0, 0.2, 0.5, 0.8, 0.99, 1.01])  # of the window
    sides = [(60, 180), (60, 180)]
    found = [depth_by_sides(sides, ANY_SIDES, share * np.hypot(1, 2)) for share in shares]
    supports = [of[2] for of in found]
    assert supports == [2, 2, 2, 2, 2, 0]
    likelihoods = np.exp([of[1] for of in found[:5]])
    expected = 0.2 + 0.8 * np.exp(-2 * shares[:5] ** 2) / np.exp(-2 * MIDDLES**2).mean()
    drops = np.diff(likelihoods) / np.diff(expected)  # affine in it: the view may not see the edge
    np.testing.assert_allclose(drops, drops[0], rtol=1e-3)
    assert drops[0] > 0


def test_sides_without_likelihood_are_no_match():
    table = ANY_SIDES.copy()
    table[50:, 50:] = 0
    sides = [(200, 20), (60, 20)]  # both sides differ; one does
    depth, _, supports = depth_by_sides(sides, table)
    assert (depth, supports) == (pytest.approx(1 / 4), 2)
    assert depth_by_sides([(200, 20), (200, 20)], table)[2] == 0


@pytest.mark.parametrize(
    "change",
    [
        {"offsets": np.array([0, 4])},
        {"offsets": np.array([0, 6])},
        {"offsets": np.array([1, 5])},
        {"offsets": np.array([0, 7, 5]), "closed": np.zeros(2, bool)},
        {"offsets": np.array([0, 2, 5])},
        {"normals": np.zeros((4, 2))},
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(change):
    arrays = {
        "points": np.zeros((5, 2)),
        "normals": np.zeros((5, 2)),
        "offsets": np.array([0, 5]),
        "closed": np.zeros(1, bool),
    }
    edge_view(**arrays)
    with pytest.raises(ValueError, match="fit together"):
        edge_view(**{**arrays, **change})


def test_bad_focal_lengths_and_samples_are_refused():
    with pytest.raises(ValueError, match="focal"):
        edge_view(np.zeros((1, 2)), np.zeros((1, 2)), np.array([0, 1]), np.zeros(1, bool), focal=0)
    view = edge_view(np.zeros((1, 2)), np.zeros((1, 2)), np.array([0, 1]), np.zeros(1, bool))
    with pytest.raises(ValueError, match="differ in length"):
        _kernels.associate(
            [view], np.zeros((2, 3)), np.zeros((1, 3)), np.zeros(2, np.int8), 4.0, 0.9, 1
        )
    with pytest.raises(ValueError, match="not a point"):
        _kernels.chain_depths(
            view, [view], np.array([1]), np.array([0, 1]), np.ones((1, 2)), 1.0, 1.5, ANY_SIDES,
            0.1, 0.5, 0.6, 4.0, 4.0, 6, 1,
        )  # fmt: skip


def test_empty_view_observes_nothing():
    view = edge_view(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(1, np.int64), np.zeros(0, bool))
    one = np.array([[0.0, 0.0, 1.0]])
    found = _kernels.associate([view], one, one, np.zeros(1, np.int8), 4.0, 0.9, 1)
    assert found.tolist() == [[-1]]
    assert known.graph_from_ideal(known.row(1)[0], [], [], []).num_polylines == 0


def test_bilinear_by_hand():
    gray = np.array([[0, 100], [50, 250]], np.uint8)
    image = np.ascontiguousarray(np.stack([gray, gray // 2, 0 * gray], axis=2))
    points = np.array([[0, 0], [1, 1], [0.5, 0], [0.5, 0.5], [-3, 9]])
    expected = np.array([0, 250, 50, 100, 50])
    found = _kernels.bilinear(image, points)
    assert found.tolist() == np.column_stack([expected, expected / 2, 0 * expected]).tolist()
    single_pixel = np.ascontiguousarray(image[:1, 1:])
    assert _kernels.bilinear(single_pixel, np.array([[0.4, 0.7]])).tolist() == [[100, 50, 0]]
    with pytest.raises(ValueError, match="empty"):
        _kernels.bilinear(image[:0], points)


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
    """(2,) gray less the driver's, and (2,) its change with inverse depth; None off its scale."""
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
    driver, poses = random_pose(rng), [random_pose(rng) for _ in range(3)]
    chains = [random_chains(rng) for _ in range(4)]
    grays = [rng.integers(0, 256, (len(chain[0]), 2)).astype(np.uint8) for chain in chains]
    own, *views = (
        edge_view(*chain, pose, sides=sides)
        for chain, pose, sides in zip(chains, [driver, *poses], grays, strict=True)
    )
    offsets, window = np.array([0, 5, 45, 120, 200]), 4
    count = offsets[-1]
    ideal, inverse = rng.uniform(-150, 150, (count, 2)), rng.uniform(0.1, 0.3, count)
    indices = rng.integers(0, len(chains[0][0]), count)
    positions = np.column_stack([rng.uniform(0, len(c[0]), count) for c in chains[1:]])
    positions[rng.random(positions.shape) < 0.2] = np.nan
    curves = (*driver, FOCAL, ideal, inverse)
    information, gradient = np.zeros(count), np.zeros(count)
    for k, pose in enumerate(poses):
        rotation = pose[0] @ driver[0].T
        translation = pose[1] - rotation @ driver[1]
        for first, last in pairwise(offsets):
            rows = ([], [])
            for i in range(first, last):
                if np.isnan(positions[i, k]):
                    continue
                local = rotation @ [*ideal[i] / FOCAL, 1] + inverse[i] * translation
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
    with pytest.raises(ValueError, match="not on a chain of the driver"):
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


def test_positions_slide_along_their_chains():
    points = np.column_stack([np.arange(-50.0, 51), np.zeros(101)])
    straight = edge_view(
        points, np.tile([0.0, 1.0], (101, 1)), np.array([0, 101]), np.zeros(1, bool)
    )
    angle = 2 * np.pi * np.arange(200) / 200
    points = 30 * np.column_stack([np.cos(angle), np.sin(angle)])
    loop = edge_view(points, points / 30, np.array([0, 200]), np.ones(1, bool))
    at = np.array([[3.3, 1.0], [90.0, 0.0], [30 * np.cos(-0.04), 30 * np.sin(-0.04)]])
    curves = (np.eye(3), np.zeros(3), FOCAL, at, np.ones(3))
    start = np.array([[45.0, np.nan], [98.0, np.nan], [np.nan, 3.0]])
    found = _kernels.slide_positions(*curves, start, [straight, loop], 2)
    np.testing.assert_allclose(found[:2, 0], [53.3, 100], atol=1e-5)
    assert found[2, 1] == pytest.approx(200 - 0.04 / (2 * np.pi) * 200, abs=1e-3)
    assert np.isnan(found).tolist() == np.isnan(start).tolist()
