"""Depths along chains against the crossings of all segments, and their likelihoods by hand."""

import numpy as np
import pytest
from random_chains import FOCAL, edge_index, random_pose, single

from colmap_edges.core.arrays import offsets_of
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

ANY_SIDES = np.ones((256, 256), np.float32)


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
    source = edge_index(
        samples, np.zeros((150, 2)), np.arange(151, dtype=np.int64), np.zeros(150, bool)
    )
    view = edge_index(*chains, pose)
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
            min_angle_sin=0.0, visibility_rate=1.0, detection_rate=0.6,
            min_log_likelihood_ratio=-1e9,
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
    source = edge_index(
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
            edge_index(
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


def score_with_a_third_view(depths):
    """Log likelihood ratio of a depth that two views agree on; the third sees it at none of these.

    Its chains are at the given depths.
    """
    source, views = two_crossings([(60, 180), (60, 180)])
    along, pose = np.linspace(-20, 20, 41), (np.eye(3), np.array([1.5, 0.0, 0.0]))
    chains = [np.column_stack([np.full(41, FOCAL * 1.5 / z), along]) for z in depths]
    normals, offsets = np.tile([[1.0, 0.0]], (82, 1)), np.array([0, 41, 82])
    views.append(edge_index(np.concatenate(chains), normals, offsets, np.zeros(2, bool), pose))
    return _kernels.chain_depths(
        source, views, np.array([20]), np.array([0, 1]), np.array([[0.1, 1.0]]), 1.0, 1.0,
        ANY_SIDES, 0.1, 0.5, 0.8, 0.0, 4.0, 6, 1,
    )[2][0]  # fmt: skip


def test_views_that_cannot_see_a_depth_say_nothing_about_it():
    """Depths of 2 and 4 agree in two views; a third that sees neither there speaks against them."""
    alone = depth_by_sides([(60, 180), (60, 180)], ANY_SIDES)[1]
    assert score_with_a_third_view([1.2, 1.3]) == pytest.approx(alone)  # to one side of both
    assert alone - 0.6 < score_with_a_third_view([1.2, 9.0]) < alone - 0.3


def test_samples_off_the_chains_are_refused():
    view = edge_index(np.zeros((1, 2)), np.zeros((1, 2)), np.array([0, 1]), np.zeros(1, bool))
    with pytest.raises(ValueError, match="not a point"):
        _kernels.chain_depths(
            view, [view], np.array([1]), np.array([0, 1]), np.ones((1, 2)), 1.0, 1.5, ANY_SIDES,
            0.1, 0.5, 0.6, 4.0, 4.0, 6, 1,
        )  # fmt: skip
