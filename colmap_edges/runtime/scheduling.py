"""Orders the views so that few edge graphs have to be in memory at once.

Which views are in memory at once decides how often graphs that wait on disk are read again. The
order changes nothing else: a view waits for those whose edges it must not trace once more.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from colmap_edges.core.arrays import IntArray


def local_order(neighbors: Sequence[IntArray]) -> IntArray:
    """(V,) views in an order in which neighbours are near each other (reverse Cuthill-McKee)."""
    count = len(neighbors)
    rows = np.repeat(np.arange(count), [len(others) for others in neighbors])
    columns = np.concatenate([np.zeros(0, np.int64), *neighbors])
    links = csr_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    order = reverse_cuthill_mckee((links + links.T).tocsr(), symmetric_mode=True)
    return np.asarray(order, np.int64)


class Schedule:
    """Hands out views so that each comes after those before it that it shares edges with.

    Of the views that may be next, the one comes that needs the fewest others which were not
    needed lately.
    """

    def __init__(self, order: IntArray, needed: Sequence[IntArray], num_kept: int) -> None:
        """Start with nothing done.

        Args:
            order: (V,) the views; of two of which one needs the other, the first goes first.
            needed: per view the others that it needs.
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
        """The next view; None while all that are left wait for views that are not done."""
        views = np.flatnonzero(self.ready)
        if len(views) == 0:
            return None
        view = int(views[np.lexsort((self.place[views], self.num_missing[views]))[0]])
        self.ready[view] = False
        for other in self.needed[view].tolist():
            self.use(other)
        return view

    def use(self, view: int) -> None:
        """Note that a view was needed; the one longest not needed is forgotten."""
        if view in self.recent:
            self.recent.move_to_end(view)
            return
        self.recent[view] = None
        self.num_missing[self.users[view]] -= 1
        if len(self.recent) > self.num_kept:
            old, _ = self.recent.popitem(last=False)
            self.num_missing[self.users[old]] += 1

    def finish(self, view: int) -> None:
        """Note that a view is done, so that others need not wait for it any more."""
        later = self.later[view]
        self.num_awaited[later] -= 1
        self.ready[later[self.num_awaited[later] == 0]] = True


def users_of(needed: Sequence[IntArray]) -> list[IntArray]:
    """Per view the views that need it."""
    rows = np.repeat(np.arange(len(needed)), [len(others) for others in needed])
    columns = np.concatenate([np.zeros(0, np.int64), *needed])
    order = np.argsort(columns, kind="stable")
    bounds = np.cumsum(np.bincount(columns, minlength=len(needed)))[:-1]
    return np.split(rows[order], bounds)
