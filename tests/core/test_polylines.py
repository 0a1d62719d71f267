"""Joining of polylines end to end: ends, pairs, paths and points, on hand-made arrays."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.polylines import (
    cross,
    curve_tangents,
    end_points,
    lengths_of,
    match_best_first,
    nearest_on_lines,
    points_along,
    walk_joined,
)


def test_ends_of_pieces():
    tips, inner = end_points(np.array([0, 5, 6, 8]), reach=3)
    assert tips.tolist() == [0, 4, 5, 5, 6, 7]
    assert inner.tolist() == [3, 1, 5, 5, 7, 6]  # the other end where there is no third point


def test_no_pieces_have_no_ends():
    tips, inner = end_points(np.array([0]), reach=3)
    assert len(tips) == len(inner) == 0
    assert walk_joined(np.zeros(0, np.int64)) == []
    order, lengths = points_along([], np.zeros(0, np.int64), np.zeros(0, np.int64))
    assert len(order) == len(lengths) == 0


def match(num_ends, rows):
    """Pairs of (end, end, allowed, cost)."""
    a, b, allowed, costs = (np.array(column) for column in zip(*rows, strict=True))
    return match_best_first(num_ends, a, b, allowed, costs.astype(float)).tolist()


def test_cheapest_pairs_go_first():
    rows = [(0, 2, True, 2), (0, 3, True, 1), (2, 5, True, 3)]
    assert match(6, rows) == [3, -1, 5, 0, -1, 2]


def test_pairs_that_may_not_join_do_not():
    assert match(4, [(0, 3, False, 0), (1, 2, True, 9)]) == [-1, 2, 1, -1]


def test_among_equals_the_first_pair_wins():
    assert match(6, [(0, 4, True, 1), (0, 2, True, 1)]) == [4, -1, -1, -1, 0, -1]


def test_matching_without_points():
    none = np.zeros(0, np.int64)
    assert (
        match_best_first(4, none, none, none.astype(bool), none.astype(float)).tolist() == [-1] * 4
    )


def test_a_path_is_walked_through_its_pieces():
    # The end of piece 2 goes on at the end of piece 0, whose start goes on at the start of 1.
    partner = np.array([2, 5, 0, -1, -1, 1])
    assert walk_joined(partner) == [([3, 0, 5], False)]


def test_a_ring_is_walked_once_and_closed():
    partner = np.array([5, 2, 1, 4, 3, 0])
    assert walk_joined(partner) == [([0, 2, 4], True)]


def test_a_piece_alone_is_open_or_joined_to_itself():
    assert walk_joined(np.array([-1, -1, 3, 2])) == [([0], False), ([2], True)]


def test_points_along_paths():
    begins, stops = np.array([0, 3, 7]), np.array([3, 5, 9])
    paths = [([0, 3], False), ([5], True)]
    order, lengths = points_along(paths, begins, stops)
    assert order.tolist() == [0, 1, 2, 4, 3, 8, 7]
    assert lengths.tolist() == [5, 2]


@st.composite
def joined_pieces(draw):
    """Lengths of some pieces, and the end that goes on each end."""
    lengths = draw(st.lists(st.integers(1, 5), max_size=8))
    ends = draw(st.permutations(range(2 * len(lengths))))
    partner = np.full(len(ends), -1, np.int64)
    for a, b in zip(ends[::2], ends[1::2], strict=True):
        if draw(st.booleans()):
            partner[a], partner[b] = b, a
    return np.array(lengths, np.int64), partner


@given(joined_pieces())
def test_every_piece_is_on_one_path_and_every_point_once(pieces):
    lengths, partner = pieces
    paths = walk_joined(partner)
    assert sorted(end // 2 for path, _ in paths for end in path) == list(range(len(lengths)))
    for path, closed in paths:
        for end, following in pairwise(path):
            assert partner[end ^ 1] == following
        assert (partner[path[-1] ^ 1] == path[0]) == closed
        assert closed or partner[path[0]] == partner[path[-1] ^ 1] == -1
    offsets = offsets_of(lengths)
    order, counts = points_along(paths, offsets[:-1], offsets[1:])
    assert sorted(order.tolist()) == list(range(lengths.sum()))
    assert counts.tolist() == [sum(lengths[end // 2] for end in path) for path, _ in paths]


@given(st.integers(0, 30), st.integers(0, 2**32 - 1))
def test_matches_are_mutual_and_none_was_missed(count, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.integers(0, 6, count), rng.integers(6, 12, count)
    allowed, costs = rng.random(count) < 0.7, rng.integers(0, 4, count).astype(float)
    partner = match_best_first(12, a, b, allowed, costs)
    matched = np.flatnonzero(partner >= 0)
    assert (partner[partner[matched]] == matched).all()
    for row in np.flatnonzero(allowed):  # a pair is left out only for one as cheap at least
        if partner[a[row]] != b[row]:
            taken = {(e, partner[e]) for e in (a[row], b[row]) if partner[e] >= 0}
            assert taken
            pairs = [tuple(sorted(pair)) for pair in taken]
            cheapest = [costs[allowed & (a == low) & (b == high)].min() for low, high in pairs]
            assert min(cheapest) <= costs[row]


@pytest.mark.parametrize("dimension", [2, 3])
def test_tangents_are_central_differences_within_a_curve(dimension):
    points = np.array([0, 1, 4, 9, 100, 103, 50])[:, None] * np.ones(dimension)
    tangents = curve_tangents(points, np.array([0, 4, 6, 7]))
    expected = np.array([1, 4, 8, 5, 3, 3, 0])
    np.testing.assert_array_equal(tangents, expected[:, None] * np.ones(dimension))


def test_no_points_have_no_tangents():
    assert curve_tangents(np.zeros((0, 3)), np.zeros(1, np.int64)).shape == (0, 3)


def test_lines_are_nearest_where_their_connection_is_perpendicular_to_both():
    random = np.random.default_rng(2)
    origins, ways = random.normal(size=(2, 20, 3)), random.normal(size=(2, 20, 3))
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    near = nearest_on_lines(origins[0], ways[0], origins[1], ways[1])
    for point, origin, way in zip(near, origins, ways, strict=True):
        np.testing.assert_allclose(np.cross(point - origin, way), 0, atol=1e-9)
        np.testing.assert_allclose(np.einsum("ni,ni->n", near[1] - near[0], way), 0, atol=1e-9)


@pytest.mark.parametrize("shape", [(3,), (0, 3), (7, 3), (4, 1, 3), (2, 5, 2, 3)])
def test_products_and_lengths_are_numpys_bit_by_bit(shape):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=shape), rng.normal(size=3)
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
    np.testing.assert_array_equal(cross(b, a), np.cross(b, a))
    np.testing.assert_array_equal(lengths_of(a), np.linalg.norm(a, axis=-1))
    np.testing.assert_array_equal(lengths_of(a[..., :2]), np.linalg.norm(a[..., :2], axis=-1))
