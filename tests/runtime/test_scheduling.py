"""The order in which views are processed, and groups that may run concurrently."""

import numpy as np
import pytest

from colmap_edges.runtime.scheduling import Schedule, local_order


def grid_neighbors(side, reach):
    """Per cell of a square grid the cells at most `reach` away."""
    x, y = np.divmod(np.arange(side * side), side)
    near = (abs(x[:, None] - x) <= reach) & (abs(y[:, None] - y) <= reach)
    np.fill_diagonal(near, False)
    return [np.flatnonzero(row) for row in near]


def reads(order, needed, num_kept):
    """How often a view is read when the last `num_kept` stay in memory."""
    kept, count = [], 0
    for view in order:
        for other in (*needed[view], view):
            count += other not in kept
            kept = [*(k for k in kept if k != other), other][-num_kept:]
    return count


def taken(schedule):
    """The views in the order in which a schedule hands them out, one at a time."""
    order = []
    while (view := schedule.take()) is not None:
        order.append(view)
        schedule.finish(view)
    return order


def test_neighbours_are_near_each_other_in_the_local_order():
    needed = grid_neighbors(20, 1)
    shuffled = np.random.default_rng(0).permutation(400)
    order = local_order(needed)
    assert sorted(order) == list(range(400))
    assert reads(order, needed, 80) < 0.4 * reads(shuffled, needed, 80)
    assert local_order([np.zeros(0, np.int64)] * 3).tolist() in ([0, 1, 2], [2, 1, 0])


@pytest.mark.parametrize("seed", range(3))
def test_views_that_share_edges_keep_their_turn(seed):
    rng = np.random.default_rng(seed)
    needed = [np.sort(rng.choice(60, rng.integers(6), replace=False)) for _ in range(60)]
    needed = [others[others != view] for view, others in enumerate(needed)]
    order = rng.permutation(60)
    rank, place = np.argsort(order), np.argsort(taken(Schedule(order, needed, 10)))
    for view, others in enumerate(needed):
        np.testing.assert_array_equal(place[others] > place[view], rank[others] > rank[view])


def test_concurrent_tasks_share_no_items():
    needed = grid_neighbors(10, 1)
    schedule = Schedule(np.random.default_rng(0).permutation(100), needed, 10)
    running, done = [], set()
    while len(done) < 100:
        while (view := schedule.take()) is not None:
            assert not set(running) & set(needed[view])
            running.append(view)
        schedule.finish(running[0])
        done.add(running.pop(0))


def test_few_views_are_needed_anew():
    needed = grid_neighbors(20, 2)
    order = np.random.default_rng(0).permutation(400)
    assert reads(taken(Schedule(order, needed, 40)), needed, 40) < 0.5 * reads(order, needed, 40)
