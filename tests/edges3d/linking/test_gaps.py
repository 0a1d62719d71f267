"""Pieces that face each other are joined where views observe an edge between them."""

from functools import partial

import curves as known
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.sparse import csc_array

from colmap_edges.edges3d.linking.gaps import are_observed, hermite_weights, observed_along
from colmap_edges.edges3d.linking.joining import link_edges
from colmap_edges.options import PipelineOptions

VIEWS = known.row(6)
LINE = known.line((-0.5, 0, 0), (1.5, 0, 0))
BEFORE, AFTER = (0.0, 0.42), (0.48, 0.9)  # parameters of two pieces; the gap is six spacings
STEP = 0.01


def part_of(curve, first, last):
    return lambda t: curve(first + (last - first) * np.asarray(t))


ARC = part_of(known.circle((0.5, 0, 0), 0.8), 0.0, 0.4)


def pieces_of(curve, views):
    """The two pieces of a curve as edges that each of some views observes."""
    t = [np.arange(first, last, STEP) for first, last in (BEFORE, AFTER)]
    return known.observed_edges([curve(of) for of in t], views)


def num_linked(curve, chains, observing=range(6), num_threads=1):
    """Edges left of two pieces, in views with such chains."""
    graphs = [known.graph_of(view, of) for view, of in zip(VIEWS, chains, strict=True)]
    given = known.tracing_input(VIEWS, graphs)
    pieces, options = pieces_of(curve, list(observing)), PipelineOptions()
    goes_on = partial(are_observed, pieces, given, options, num_threads)
    return link_edges(pieces, options.linking, goes_on).num_edges


def broken(curve):
    return [part_of(curve, *BEFORE), part_of(curve, *AFTER)]


@pytest.mark.parametrize("num_threads", [1, 2])
@pytest.mark.parametrize("curve", [LINE, ARC])
def test_pieces_are_joined_where_chains_go_on(curve, num_threads):
    assert num_linked(curve, [[curve]] * 6, num_threads=num_threads) == 1
    assert num_linked(curve, [broken(curve)] * 6, num_threads=num_threads) == 2


@pytest.mark.parametrize(("count", "expected"), [(2, 2), (3, 1)])
def test_as_many_views_must_see_it_as_an_edge_point_needs(count, expected):
    assert num_linked(ARC, [[ARC]] * count + [broken(ARC)] * (6 - count)) == expected


def test_views_that_observe_neither_end_are_not_asked():
    chains = [[LINE]] * 2 + [broken(LINE)] * 2 + [[LINE]] * 2
    assert num_linked(LINE, chains, observing=range(4)) == 2
    assert num_linked(LINE, chains, observing=(0, 1, 4)) == 1


def test_chains_that_cross_a_gap_do_not_count():
    places = LINE(np.linspace(BEFORE[1], AFTER[0], 5))[1:-1]
    half = np.array([0, 0.2, 0])
    across = [known.line(place - half, place + half) for place in places]
    assert num_linked(LINE, [[*broken(LINE), *across]] * 6) == 2


def test_one_place_without_a_chain_is_enough_to_keep_pieces_apart():
    first, last = BEFORE[1], AFTER[0]
    half = [part_of(LINE, BEFORE[0], 0.6 * first + 0.4 * last), part_of(LINE, *AFTER)]
    assert num_linked(LINE, [half] * 6) == 2


def test_short_gaps_need_no_view():
    pieces, options = pieces_of(LINE, [0]), PipelineOptions()
    points = np.arange(len(pieces.points))
    offsets = np.array([0, 20, len(points)])
    near = pieces.reordered(points, offsets, pieces.closed)
    asked = []

    def never(ends, a, b):
        asked.extend(zip(a.tolist(), b.tolist(), strict=True))
        return np.zeros(len(a), bool)

    assert link_edges(near, options.linking, never).num_edges == 1
    assert link_edges(pieces, options.linking, never).num_edges == 2
    assert asked == [(1, 2)]


def test_weights_are_those_of_cubic_hermite_splines():
    rng = np.random.default_rng(3)
    t, places, slopes = rng.random(5), rng.normal(size=2), rng.normal(size=2)
    expected = CubicHermiteSpline([0, 1], places, slopes)
    ruled = np.array([places[0], slopes[0], places[1], slopes[1]])
    points, tangents = ruled @ hermite_weights(t)
    np.testing.assert_allclose(points, expected(t))
    np.testing.assert_allclose(tangents, expected(t, 1))


def test_points_are_observed_along_a_curve_where_all_that_are_needed_are():
    chains = [[ARC]] * 3 + [broken(ARC)] * 3
    graphs = [known.graph_of(view, of) for view, of in zip(VIEWS, chains, strict=True)]
    given, t = known.tracing_input(VIEWS, graphs), np.array([0.3, 0.45])  # on a piece, in the gap
    points, tangents = ARC(t)[None], (ARC(t + 1e-4) - ARC(t))[None]
    asked = csc_array(np.array([[True, True, False, True, True, True]]))

    def views(*needed):
        mask = np.array([needed]) if needed else None
        angles = (20.0, 20.0)
        return observed_along(given, asked, points, tangents, 2.0, angles, 1, mask).views.tolist()

    assert views() == [0, 1]
    assert views(True, False) == [0, 1, 3, 4, 5]
