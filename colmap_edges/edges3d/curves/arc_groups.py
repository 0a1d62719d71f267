"""Groups of arcs that are one curve: parts of one circle, with unobserved gaps between them."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray, IntArray
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.groups import linked_groups


def find_arc_groups(curves: Curves3D, circles: IntArray, edges: Edges3D) -> IntArray:
    """(C,) first curve of the group of arcs that each curve belongs to.

    Arcs of one circle are one curve if they overlap, or if both ends at the gap between them are
    free ends of edges: an edge that ends at a node ends there, others go on unseen.

    Args:
        curves: the curves, in order along each edge.
        circles: (C,) the circle of each; equal numbers are equal circles.
        edges: the edges.
    """
    free = free_ends(curves, edges)
    links = [np.zeros((0, 2), np.int64)]
    order = np.argsort(circles, kind="stable")
    firsts = np.flatnonzero(np.diff(circles[order], prepend=-1))
    for members in np.split(order, firsts[1:]):
        if len(members) > 1:
            links.append(members[successive_parts(curves, members, free[members])])
    labels = linked_groups(np.concatenate(links), curves.num_curves)
    first = np.unique(labels, return_index=True)[1]
    return np.asarray(first[labels], np.int64)


def free_ends(curves: Curves3D, edges: Edges3D) -> BoolArray:
    """(C, 2) whether a curve's start and end are ends of its edge that meet no other edge."""
    last = np.diff(curves.edges, append=-1) != 0
    first = np.diff(curves.edges, prepend=-1) != 0
    open_ends = (edges.end_nodes < 0)[curves.edges]
    alone = (first & last) | ~edges.closed[curves.edges]
    return np.asarray(np.column_stack([first, last]) & open_ends & alone[:, None])


def successive_parts(curves: Curves3D, members: IntArray, free: BoolArray) -> IntArray:
    """(n, 2) pairs of (M,) arcs of one circle that are parts of one curve."""
    starts, lengths, turned = spans_on_first(curves, members)
    free = np.where(turned[:, None], free[:, ::-1], free)
    order = np.argsort(starts, kind="stable")
    starts, ends, free = starts[order], (starts + lengths)[order], free[order]
    reach = np.maximum.accumulate(ends)
    farthest = np.maximum.accumulate(np.where(ends == reach, np.arange(len(ends)), 0))
    behind = np.arange(1, len(order) + 1) % len(order)
    before, gap = farthest, starts[behind] + 2 * np.pi * (behind == 0) - reach
    same = (gap <= 0) | (free[before, 1] & free[behind, 0])
    return np.asarray(np.column_stack([order[before], order[behind]])[same])


def spans_on_first(curves: Curves3D, members: IntArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Positions of (M,) arcs on the circle of the first of them.

    Returns:
        (M,) angle at which each begins, from 0 to a full turn; (M,) its angle; (M,) whether it runs
        the other way.
    """
    frame = curves.frames[members[0]]
    turned = curves.normals[members] @ curves.normals[members[0]] < 0
    lengths = np.diff(curves.spans[members], axis=1)[:, 0]
    begins = curves.at(members, turned.astype(np.float64)) - frame[0]
    angles = np.arctan2(begins @ frame[2], begins @ frame[1]) % (2 * np.pi)
    return np.asarray(angles), np.abs(lengths), turned
