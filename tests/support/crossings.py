"""The segments of an edge graph, and which of them a line crosses: plain numpy."""

from dataclasses import replace

import numpy as np
from random_chains import single

from colmap_edges.edges2d.edge_index import next_points


def rounded(graph):
    """The graph with undistorted pixels in single precision, as the kernels keep them."""
    return replace(graph, undistorted=single(graph.undistorted))


def segments_of(graph):
    """(S,) points that have a next one, and (S, 2) pixels of both."""
    points = np.arange(len(graph.undistorted))
    following = next_points(graph, points)
    rows = np.flatnonzero(following != points)
    return rows, graph.undistorted[rows], graph.undistorted[following[rows]]


def crossings(graph, line):
    """(K,) positions on chains, ascending, that a (3,) line crosses, and their (K, 2) pixels."""
    rows, a, b = segments_of(graph)
    before, after = (p @ line[:2] + line[2] for p in (a, b))
    crossed = (before < 0) != (after < 0)
    share = before[crossed] / (before[crossed] - after[crossed])
    return rows[crossed] + share, a[crossed] + share[:, None] * (b - a)[crossed]
