"""Edges are cut where they turn sharply, and only there, not at gaps in bends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from curve_edges import edges_of

from colmap_edges.edges3d.linking.bends import cut_at_bends, find_bends, go_on_smoothly

NOISE = 0.02  # of the distance between points, which is 1


def noisy(points, seed=0):
    return points + np.random.default_rng(seed).normal(scale=NOISE, size=points.shape)


def corner(turn_deg, count=12, rounded=0.3):
    """Two straight arms whose corner, at the origin, is a little inside by its neighbours."""
    turn = np.radians(turn_deg)
    steps = np.arange(count) + 0.5
    before = np.column_stack([-steps[::-1], 0 * steps, 0 * steps])
    behind = steps[:, None] * [np.cos(turn), np.sin(turn), 0]
    points = np.concatenate([before, behind])
    inside = np.array([-np.sin(turn / 2), np.cos(turn / 2), 0])
    points[count - 1 : count + 1] += rounded * np.sin(turn / 2) * inside
    return points


def bend(radius, turn_deg=90, arms=12):
    """Two straight arms with an arc between them."""
    turn = np.radians(turn_deg)
    angles = np.arange(0.5, radius * turn) / radius
    inside = radius * np.column_stack([np.sin(angles), 1 - np.cos(angles), 0 * angles])
    last = radius * np.array([np.sin(turn), 1 - np.cos(turn), 0])
    steps = np.arange(arms) + 0.5
    behind = last + steps[:, None] * [np.cos(turn), np.sin(turn), 0]
    return np.concatenate([np.column_stack([-steps[::-1], 0 * steps, 0 * steps]), inside, behind])


def ring(radius, first_deg, last_deg):
    angles = np.arange(np.radians(first_deg), np.radians(last_deg), 1 / radius)
    return radius * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])


def bends_of(points, closed=False):
    return find_bends(edges_of([points], [closed], 0)).tolist()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("turn_deg", [45, 60, 90, 120])
def test_an_edge_that_runs_around_a_corner_is_cut_there(turn_deg, seed):
    assert bends_of(noisy(corner(turn_deg), seed)) == [12]


@pytest.mark.parametrize("seed", range(5))
def test_smooth_edges_stay_whole(seed):
    for radius in (4, 6, 12, 50):
        assert bends_of(noisy(ring(radius, 0, 300), seed)) == []
    assert bends_of(noisy(corner(0, rounded=0), seed)) == []


@pytest.mark.parametrize("radius", [3, 4, 6, 12])
def test_fillets_are_hardly_ever_cut(radius):
    cut = [bool(bends_of(noisy(bend(radius), seed))) for seed in range(20)]
    assert sum(cut) <= 3


def test_the_pieces_of_a_cut_edge_have_all_of_its_points():
    edges = edges_of([noisy(ring(9, 0, 90)), noisy(corner(90)), noisy(ring(9, 0, 90))])
    cut = cut_at_bends(edges)
    np.testing.assert_array_equal(cut.points, edges.points)
    first, second, third = np.diff(edges.edge_offsets)
    assert np.diff(cut.edge_offsets).tolist() == [first, second // 2, second // 2, third]
    assert (cut.end_nodes == -1).all()


def test_a_closed_edge_is_cut_at_all_of_its_bends():
    steps = np.arange(16) / 16
    corners = np.array([(0, 0, 0), (16, 0, 0), (16, 16, 0), (0, 16, 0)], float)
    sides = [
        a + (steps + 0.5 / 16)[:, None] * (b - a)
        for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)
    ]
    square = noisy(np.roll(np.concatenate(sides), 5, axis=0))
    cut = cut_at_bends(edges_of([square], [True], 0))
    assert np.diff(cut.edge_offsets).tolist() == [16] * 4
    assert not cut.closed.any()
    assert all(np.ptp(piece, axis=0).min() < 1 for piece in np.split(cut.points[:, :2], 4))


def test_a_closed_edge_with_one_bend_stays_closed():
    steps, turn = np.arange(1, 13), np.radians(np.arange(175, -90, -5))
    arms = np.column_stack([np.r_[13 - steps, 0, 0 * steps], np.r_[0 * steps, 0, steps]])
    back = 12 + 12 * np.column_stack([np.cos(turn), np.sin(turn)])
    drop = np.column_stack([np.concatenate([arms, back]), np.zeros(len(arms) + len(back))])
    assert len(bends_of(noisy(np.roll(drop, 20, axis=0)))) == 1
    loop = edges_of([noisy(drop)], [True], 0)
    assert cut_at_bends(loop) is loop


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_the_unit_does_not_matter(scale):
    assert bends_of(scale * noisy(corner(60))) == [12]
    assert goes_on(scale * noisy(ring(5, 0, 120)), scale * noisy(ring(5, 150, 220)))


def goes_on(before, behind):
    """Whether the last end of the one and the first of the other are of one smooth curve."""
    edges = edges_of([before, behind], sigma=0)
    found = go_on_smoothly(edges, np.array([1, 2]), np.array([2, 1]))
    assert found[0] == found[1]
    return bool(found[0])


@pytest.mark.parametrize("seed", range(5))
def test_ends_beside_a_gap_in_a_circle_go_on_in_each_other(seed):
    for radius, gap_deg in ((4, 30), (5, 45), (8, 45)):
        whole = ring(radius, gap_deg, 200), ring(radius, -150, 0)
        assert goes_on(noisy(whole[1], seed), noisy(whole[0], seed + 9))
    # Three points are few, but those of the other side determine the bend.
    assert goes_on(noisy(ring(4, -150, 0), seed), noisy(ring(4, 20, 58), seed + 9))


@pytest.mark.parametrize("seed", range(5))
def test_ends_at_a_corner_do_not(seed):
    for gap in (0, 1, 3):
        points = noisy(corner(60, count=14), seed)
        assert not goes_on(points[: 14 - gap], points[14 + gap :])
    arcs = ring(9, -100, 0), ring(9, 0, 100)
    turned = arcs[1] * [-1, 1, 1] + [18.2, 0.4, 0]  # bent the other way, and to the other side
    turned = turned @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    turned += arcs[0][-1] + [0.3, 0.5, 0] - turned[0]
    assert not goes_on(noisy(arcs[0], seed), noisy(turned, seed + 9))


def test_pieces_of_two_points_determine_nothing():
    assert not goes_on(ring(4, -150, 0), ring(4, 20, 40))


def test_no_edges_have_no_bends():
    none = edges_of([np.zeros((0, 3))])
    none = replace(none, edge_offsets=np.zeros(1, np.int64), closed=np.zeros(0, bool))
    assert len(find_bends(none)) == 0
