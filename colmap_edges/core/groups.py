"""Groups of items that are linked to each other."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from colmap_edges.core.arrays import IntArray


def linked_groups(pairs: IntArray, count: int) -> IntArray:
    """(count,) group of each item, from 0: that of all items to which (n, 2) pairs lead from it."""
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)
