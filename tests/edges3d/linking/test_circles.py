"""Pieces of one circle are joined, with points where views observe the gap."""

import curves as known
import numpy as np
import pytest

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges3d.linking.circles import join_circles
from colmap_edges.options import PipelineOptions

VIEWS = known.ring(6)
RADIUS, STEP, NOISE = 0.4, np.radians(3.0), 2e-4


def at(angles, radius=RADIUS, center=(0, 0, 0)):
    return center + radius * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])


def arc(first_deg, last_deg, **circle):
    """Noisy points on a piece of a circle."""
    angles = np.arange(np.radians(first_deg), np.radians(last_deg), STEP)
    noise = np.random.default_rng(int(first_deg) % 97).normal(0, NOISE, (len(angles), 3))
    return at(angles, **circle) + noise


def joined(pieces, num_observing=6, num_threads=1, closed=False):
    """The edges, joined, if so many views have chains along the whole circle."""
    chains = [known.circle((0, 0, 0), RADIUS)]
    graphs = [
        known.graph_of(view, chains if index < num_observing else [])
        for index, view in enumerate(VIEWS)
    ]
    given = known.tracing_input(VIEWS, graphs)
    edges = known.observed_edges(pieces, range(len(VIEWS)), NOISE, closed)
    return join_circles(edges, given, PipelineOptions(), num_threads)


def off_circle(edges):
    return np.abs(np.linalg.norm(edges.points[:, :2], axis=1) - RADIUS)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_observed_gaps_are_filled_with_points_on_the_circle(num_threads):
    pieces = [arc(0, 120), arc(150, 260)[::-1]]
    edges = joined(pieces, num_threads=num_threads)
    assert edges.num_edges == 1
    added = edges.num_points - sum(map(len, pieces))
    assert 10 <= added <= 11  # the gap is 33 degrees
    steps = np.linalg.norm(np.diff(edges.points, axis=0), axis=1)
    assert steps.max() < 1.3 * RADIUS * STEP
    assert off_circle(edges).max() < 5 * NOISE
    assert (edges.observations.counts >= 3).all()
    assert len(edges.sigmas) == len(edges.colors) == edges.num_points


def test_short_gaps_that_no_view_observes_are_joined_without_points():
    pieces = [arc(0, 120), arc(138, 260)]
    edges = joined(pieces, num_observing=2)
    assert edges.num_edges == 1
    assert edges.num_points == sum(map(len, pieces))


def test_long_gaps_must_be_observed():
    pieces = [arc(0, 120), arc(160, 260)]
    assert joined(pieces, num_observing=6).num_edges == 1
    assert joined(pieces, num_observing=2).num_edges == 2
    assert joined([arc(0, 120), arc(180, 260)]).num_edges == 2  # too long


def test_points_beside_the_circle_at_its_ends_are_left_out():
    first, second = arc(0, 120), arc(124, 260)
    first[-2:] *= np.array([[1.02], [1.05]])
    edges = joined([first, second])
    assert edges.num_edges == 1
    assert off_circle(edges).max() < 5 * NOISE


@pytest.mark.parametrize("size", [5, 6, 7])
@pytest.mark.parametrize("beside", [0.01, 0.05])
def test_pieces_that_lie_beside_the_circle_at_both_ends_keep_two_points(size, beside):
    short = arc(126, 126 + 3 * size - 1)
    short[:4] *= 1 + beside * np.arange(4, 0, -1)[:, None]
    short[-3:] *= 1 - beside * np.arange(1, 4)[:, None]
    edges = joined([arc(0, 123), short, arc(126 + 3 * size, 280)])
    kept = (edges.points[:, None] == short).all(axis=2).any(axis=1)
    assert kept.sum() >= 2


def test_short_pieces_are_joined_to_the_circle_that_longer_ones_determine():
    assert joined([arc(0, 120), arc(126, 140)]).num_edges == 1


@pytest.mark.parametrize(
    "other",
    [
        arc(130, 250, center=(0, 0, 0.03)),  # another plane
        arc(130, 250, radius=0.43),  # concentric, but another radius
        np.linspace(at(np.radians([130.0]))[0], [-0.9, -0.1, 0], 30),  # a tangent
    ],
)
def test_other_curves_are_not_joined(other):
    assert joined([arc(0, 120), other]).num_edges == 2


def test_arcs_whose_ends_meet_other_edges_stay_apart():
    # As on the tips of a gear's teeth: edges lead away from both ends.
    down = [at(np.radians([of]))[0] + np.outer(np.arange(12), [0, 0, -0.02]) for of in (121, 132)]
    edges = joined([arc(0, 120), arc(133, 250), *down])
    assert edges.num_edges == 4


def test_straight_edges_in_line_are_left_to_other_tests():
    line = np.linspace([-0.5, 0, 0], [0.5, 0, 0], 40)
    assert joined([line[:20], line[22:]]).num_edges == 2


def test_closed_edges_stay_closed():
    loop = joined([arc(0, 358)], closed=True)
    assert loop.closed.tolist() == [True]
    assert loop.num_points == len(arc(0, 358))


def test_nothing_in_nothing_out():
    given = known.tracing_input([], [])
    none = join_circles(Edges3D.none(), given, PipelineOptions(), 1)
    assert none.num_edges == 0
