"""The chance that views observe a curve: against sums of binomials, and on crowded chains."""

from math import comb

import curves as known
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges2d.edge_index import make_edge_index
from colmap_edges.edges3d.chains.a_contrario import (
    CLOSE_SIGMAS,
    MIN_LOG,
    PRIOR_TRIALS,
    chance_of_observations,
)
from colmap_edges.edges3d.chains.curves import Curves
from colmap_edges.options import RefinementOptions

CLOSE_PX = CLOSE_SIGMAS * RefinementOptions().noise_px
DRIVER, *OTHERS = known.ring(7, arc_deg=60)
LINE = known.line((-0.6, -0.3, 0.2), (0.5, 0.4, 0.1))


def curve_on_driver(curve=LINE, num_points=8):
    """Points of a curve as the reference sees it, at their true depths."""
    graph = known.graph_of(DRIVER, [curve])
    rows = np.linspace(5, len(graph.undistorted) - 6, num_points).astype(np.int64)
    t = known.dense_parameters(DRIVER, curve)[rows]
    return Curves(
        undistorted=graph.undistorted[rows],
        inverse_depths=1 / DRIVER.project_undistorted(curve(t))[1],
        indices=rows,
        offsets=np.array([0, num_points]),
        sides=np.ones(num_points, np.int8),
    )


def chains_of(views, *curves):
    return [make_edge_index(known.graph_of(view, list(curves)), view) for view in views]


def chances(curves, residuals, edge_indexes, views=OTHERS):
    displacements = np.full(len(curves.undistorted), 1e-3)
    return chance_of_observations(
        DRIVER, curves, residuals, displacements, views, edge_indexes, RefinementOptions(), 1
    )


def tail(observed, trials, rate):
    """Probability of at least so many hits."""
    terms = (
        comb(trials, k) * rate**k * (1 - rate) ** (trials - k) for k in range(observed, trials + 1)
    )
    return sum(terms)


def residuals_of(counts, num_views):
    """(N, K) residuals of which so many are within reach in each row."""
    reached = np.arange(num_views) < np.array(counts)[:, None]
    return np.where(reached, 0.1, np.nan)


def test_without_other_chains_the_prior_is_the_rate():
    curves = curve_on_driver()
    counts = [0, 1, 2, 3, 4, 5, 6, 6]
    found = chances(curves, residuals_of(counts, 6), chains_of(OTHERS))
    rate = 1 / (8 * 6 + PRIOR_TRIALS)
    expected = [max(np.log10(tail(count, 6, rate)), MIN_LOG) for count in counts]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert found[0] == 0
    assert (np.diff(found[:6]) < 0).all()


def test_only_close_observations_are_evidence():
    curves = curve_on_driver(num_points=3)
    residuals = np.full((3, 6), np.nan)
    residuals[0, :2] = CLOSE_PX, -CLOSE_PX
    residuals[1, :2] = CLOSE_PX + 1e-9, -CLOSE_PX - 1e-9
    found = chances(curves, residuals, chains_of(OTHERS))
    assert found[0] < -1
    assert found[1:].tolist() == [0, 0]


def test_views_that_look_elsewhere_are_no_trials():
    away = [known.looking((9.0, 9.0, 3.0), target=(20, 20, 0), index=i) for i in range(6)]
    curves = curve_on_driver(num_points=2)
    found = chances(curves, residuals_of([0, 2], 6), chains_of(away), away)
    # No trial but the observations themselves: both must have hit by chance.
    assert found.tolist() == pytest.approx([0, 2 * np.log10(1 / PRIOR_TRIALS)])


def test_crowded_chains_make_observations_likely():
    shifts = np.arange(-60, 61)[:, None] * np.array([0.003, -0.004, 0.004])
    crowd = [known.line(LINE(np.zeros(1))[0] + s, LINE(np.ones(1))[0] + s) for s in shifts]
    curves = curve_on_driver()
    residuals = residuals_of([6] * 8, 6)
    alone, crowded = (chances(curves, residuals, chains_of(OTHERS, *c)) for c in ([LINE], crowd))
    assert (alone < -6).all()
    assert (crowded > -2.5).all()


def test_curves_are_judged_each_by_its_own_surroundings():
    two = curve_on_driver(num_points=8)
    two = Curves(**vars(two) | {"offsets": np.array([0, 6, 8])})
    found = chances(two, residuals_of([3] * 8, 6), chains_of(OTHERS))
    expected = [np.log10(tail(3, 6, 1 / (6 * n + PRIOR_TRIALS))) for n in (6, 2)]
    np.testing.assert_allclose(found, np.repeat(expected, (6, 2)))


def test_no_points_have_no_chance():
    none = Curves(
        undistorted=np.zeros((0, 2)),
        inverse_depths=np.zeros(0),
        indices=np.zeros(0, np.int64),
        offsets=offsets_of(np.zeros(0, np.int64)),
        sides=np.zeros(0, np.int8),
    )
    assert chances(none, np.zeros((0, 6)), chains_of(OTHERS, LINE)).shape == (0,)


@given(st.lists(st.integers(0, 6), min_size=2, max_size=8))
def test_logs_fall_with_every_view_that_observes(counts):
    curves = curve_on_driver(num_points=len(counts))
    found = chances(curves, residuals_of(counts, 6), NO_CHAINS)
    assert ((found >= MIN_LOG) & (found <= 0)).all()
    order = np.argsort(counts, kind="stable")
    assert (np.diff(found[order]) <= 0).all()


NO_CHAINS = chains_of(OTHERS)
