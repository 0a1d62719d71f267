"""Flat arrays of rows (CSR), compared with lists of lists."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from colmap_edges.core.arrays import (
    entries_of,
    evenly_chosen,
    joined_lists,
    long_runs,
    medians_of,
    offsets_of,
    order_of,
    owners_of,
    parts_of,
    ranks_of,
    row_numbers,
    runs_of,
)
from colmap_edges.core.groups import linked_groups
from colmap_edges.core.observations import ChainObservations

lengths_of_rows = st.lists(st.integers(0, 4), max_size=8)


@given(lengths_of_rows, st.data())
def test_rows_are_those_of_lists(lengths, data):
    starts = [sum(lengths[:row]) for row in range(len(lengths) + 1)]
    rows = [list(range(a, b)) for a, b in pairwise(starts)]
    counts = np.array(lengths, np.int64)
    offsets = offsets_of(counts)
    assert offsets.tolist() == starts
    assert [part.tolist() for part in parts_of(np.arange(sum(lengths)), offsets)] == rows
    assert owners_of(offsets).tolist() == [i for i, row in enumerate(rows) for _ in row]
    assert ranks_of(counts).tolist() == [rank for row in rows for rank in range(len(row))]
    chosen = data.draw(st.lists(st.integers(0, len(rows) - 1), max_size=8)) if rows else []
    expected = [entry for row in chosen for entry in rows[row]]
    assert entries_of(offsets, np.array(chosen, np.int64)).tolist() == expected


@given(st.lists(st.integers(0, 70000), max_size=20), st.sampled_from([np.int32, np.int64]))
def test_order_is_stable(keys, kind):
    expected = sorted(range(len(keys)), key=lambda i: keys[i])
    values = np.array(keys, kind)
    for limit in (max(keys, default=0) + 1, 1 << 20):
        assert order_of(values, limit).tolist() == expected


@given(
    st.lists(st.tuples(*3 * [st.integers(-3, 3) | st.integers(-(2**40), 2**40)]), max_size=20),
    st.sampled_from([np.int32, np.int64]),
)
def test_rows_are_numbered_in_their_order(rows, kind):
    table = np.array(rows, np.int64).reshape(-1, 3)
    table = table if kind == np.int64 else table.astype(kind)
    found = row_numbers(table)
    expected = np.unique(table, axis=0, return_inverse=True)[1].reshape(-1)
    np.testing.assert_array_equal(np.unique(found, return_inverse=True)[1], expected)


def test_medians_of_values_by_owner():
    rng = np.random.default_rng(0)
    owners, values = rng.integers(0, 20, 100) * 2, rng.normal(size=100)
    values[rng.permutation(100)[:30]] = np.nan
    values[owners == 4] = np.nan
    found = medians_of(values, owners, 40)
    for owner in range(40):
        own = values[(owners == owner) & np.isfinite(values)]
        expected = np.median(own) if len(own) else np.nan
        np.testing.assert_equal(found[owner], expected)


@given(st.lists(st.lists(st.integers(0, 9), max_size=4), max_size=6))
def test_lists_are_joined(lists):
    owners, entries = joined_lists(lists)
    assert owners.tolist() == [i for i, row in enumerate(lists) for _ in row]
    assert entries.tolist() == [entry for row in lists for entry in row]


def test_runs_end_where_any_array_changes():
    mask = np.array([True, True, False, False, True, True, True])
    rows = np.array([0, 0, 0, 0, 0, 1, 1])
    assert runs_of(mask, rows).tolist() == [0, 0, 1, 1, 2, 3, 3]
    assert long_runs(mask, 2, rows).tolist() == [True, True, False, False, False, True, True]
    assert long_runs(mask, 3).tolist() == [False] * 4 + [True] * 3
    assert runs_of(mask[:0]).tolist() == []


@given(st.integers(0, 40), st.integers(1, 12))
def test_evenly_chosen_indices_are_distinct_and_spread(count, most):
    chosen = evenly_chosen(count, most)
    steps = np.diff(chosen)
    assert len(chosen) == min(count, most)
    assert chosen[:1].tolist() == [0][:count]
    assert (steps > 0).all() and np.ptp(steps) <= 1 if len(steps) else True


def test_linked_items_are_of_one_group():
    assert linked_groups(np.array([[0, 3], [3, 4], [5, 5]]), 6).tolist() == [0, 1, 2, 0, 0, 3]
    assert linked_groups(np.zeros((0, 2), np.int64), 2).tolist() == [0, 1]


def test_rows_of_a_table_are_selected_with_their_entries():
    observed = ChainObservations(
        offsets=np.array([0, 2, 2, 3]),
        views=np.array([4, 5, 6], np.int32),
        positions=np.array([0.5, 1.5, 2.5]),
    )
    found = observed.select(np.array([2, 1, 0, 2]))
    assert found.offsets.tolist() == [0, 1, 1, 3, 4]
    assert found.views.tolist() == [6, 4, 5, 6]
    assert found.owners.tolist() == [0, 2, 2, 3]
    assert [(view, rows.tolist()) for view, rows in found.by_view()] == [
        (4, [1]),
        (5, [2]),
        (6, [0, 3]),
    ]
