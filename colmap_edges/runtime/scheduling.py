"""Order in which views are processed, so that few edge graphs are in memory at once.

The order affects only how often graphs are read from disk, not the result: each view is processed
after the views whose edges it must not trace again.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from colmap_edges.core.arrays import IntArray, joined_lists
from colmap_edges.core.view import rows_by_view


def local_order(neighbors: Sequence[IntArray]) -> IntArray:
    """(V,) views ordered so that neighbours are close (reverse Cuthill-McKee)."""
    count, pairs = len(neighbors), joined_lists(neighbors)
    links = csr_array((np.ones(len(pairs[0])), pairs), shape=(count, count))
    order = reverse_cuthill_mckee((links + links.T).tocsr(), symmetric_mode=True)
    return np.asarray(order, np.int64)


class Schedule:
    """Hands out views so that each follows the earlier views that it depends on.

    Among the possible next views, it takes the one that needs the fewest graphs not in memory.
    """

    def __init__(self, order: IntArray, needed: Sequence[IntArray], num_kept: int) -> None:
        """Start with nothing done.

        Args:
            order: (V,) the views; of two dependent views the earlier one is processed first.
            needed: for each view, the other views that it needs.
            num_kept: views that stay in memory.
        """
        count = len(order)
        rank = np.empty(count, np.int64)
        rank[order] = np.arange(count)
        related = [np.union1d(a, b) for a, b in zip(needed, users_of(needed), strict=True)]
        self.later = [others[rank[others] > rank[v]] for v, others in enumerate(related)]
        self.needed = [np.append(others, view) for view, others in enumerate(needed)]
        self.num_awaited = np.bincount(
            np.concatenate([np.zeros(0, np.int64), *self.later]), minlength=count
        )
        self.ready = self.num_awaited == 0
        self.place = np.empty(count, np.int64)
        self.place[local_order(needed)] = np.arange(count)
        self.num_missing = np.array([len(others) for others in self.needed], np.int64)
        self.users = users_of(self.needed)
        self.recent: OrderedDict[int, None] = OrderedDict()
        self.num_kept = num_kept

    def take(self) -> int | None:
        """The next view; None if all remaining views wait for unfinished ones."""
        views = np.flatnonzero(self.ready)
        if len(views) == 0:
            return None
        view = int(views[np.lexsort((self.place[views], self.num_missing[views]))[0]])
        self.ready[view] = False
        for other in self.needed[view].tolist():
            self.use(other)
        return view

    def use(self, view: int) -> None:
        """Mark a view as recently used; the least recently used one is dropped."""
        if view in self.recent:
            self.recent.move_to_end(view)
            return
        self.recent[view] = None
        self.num_missing[self.users[view]] -= 1
        if len(self.recent) > self.num_kept:
            old, _ = self.recent.popitem(last=False)
            self.num_missing[self.users[old]] += 1

    def finish(self, view: int) -> None:
        """Mark a view as finished, so that others no longer wait for it."""
        later = self.later[view]
        self.num_awaited[later] -= 1
        self.ready[later[self.num_awaited[later] == 0]] = True


def users_of(needed: Sequence[IntArray]) -> list[IntArray]:
    """For each view, the views that need it."""
    users, views = joined_lists(needed)
    return [users[rows] for rows in rows_by_view(views, len(needed))]
