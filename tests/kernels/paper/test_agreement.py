"""Where intervals of views agree, against a count at every place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from colmap_edges.kernels import _kernels

INTERVALS = st.lists(
    st.tuples(st.integers(0, 30), st.integers(1, 8), st.integers(0, 4)), max_size=25
)


def agreed(intervals, min_views):
    lows = np.array([low for low, _, _ in intervals], float)
    widths = np.array([width for _, width, _ in intervals], float)
    views = np.array([view for _, _, view in intervals], np.int32)
    return _kernels.agreed_depths(lows, lows + widths, views, min_views)


def counts_by_brute_force(intervals):
    """Views whose intervals hold each multiple of 1/4."""
    places = np.arange(0, 40, 0.25)
    return places, np.array(
        [len({v for low, width, v in intervals if low <= x <= low + width}) for x in places]
    )


@given(INTERVALS, st.integers(1, 3))
def test_agreement_is_where_most_views_overlap(intervals, min_views):
    places, counts = counts_by_brute_force(intervals)
    depths, num_views = agreed(intervals, min_views)
    assert (np.diff(num_views) <= 0).all()
    for depth, number in zip(depths, num_views, strict=True):
        assert number == counts_by_brute_force(intervals)[1][round(4 * depth)]
    assert num_views.max(initial=0) == (counts.max() if counts.max() >= min_views else 0)
    # Every run of places that more views allow than those on both sides of it is there once.
    changes = np.flatnonzero(np.diff(counts))
    runs = np.split(np.arange(len(places)), changes + 1)
    levels = [0, *(counts[run[0]] for run in runs), 0]
    expected = sorted(
        levels[k]
        for k in range(1, len(levels) - 1)
        if levels[k] >= max(min_views, 1) and levels[k] > max(levels[k - 1], levels[k + 1])
    )
    assert sorted(num_views.tolist()) == expected


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="differ in number"):
        _kernels.agreed_depths(np.zeros(2), np.zeros(2), np.zeros(1, np.int32), 1)
    with pytest.raises(ValueError, match="negative"):
        _kernels.agreed_depths(np.zeros(1), np.zeros(1), np.full(1, -1, np.int32), 1)
