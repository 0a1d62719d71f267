"""Detection of cylinders: hypotheses, their support by all views, acceptance, points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, IntArray
from colmap_edges.core.seen_points import NO_POINTS, joined_seen
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.surfaces.cylinders.extent import (
    Extent,
    extent_of,
    points_on,
    sight_of_extent,
)
from colmap_edges.surfaces.cylinders.hypotheses import Cylinders, find_hypotheses
from colmap_edges.surfaces.cylinders.lines import Lines
from colmap_edges.surfaces.cylinders.support import (
    Support,
    fitted,
    num_fixed_lines,
    supports_of,
)
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.round_evidence import (
    MAX_THROUGH,
    MIN_BOTH,
    SAME_SHARE,
    TRIED_SHARE,
    FoundRound,
    Rays,
    is_believed,
    on_both_sides,
)
from colmap_edges.surfaces.round_face import RoundFace

# Maximum share of the outlines' length that fixed edges observe: edges of posts do not move.
MAX_FIXED = 0.6
MAX_FIXED_LINES = 4  # maximum number of lines that may explain all outlines: those of a post
MAX_TRIED = 600  # maximum number of hypotheses
NUM_NEAR = 40  # number of views whose outlines rank hypotheses, the nearest ones
MAX_REFUSED = 8  # number of fitted hypotheses refused one after the other that ends the search


def find_cylinders(
    lines: Lines, views: Sequence[View], evidence: Evidence, random_seed: int
) -> FoundRound:
    """Find the cylinders whose outlines views show.

    Args:
        lines: straight pieces of the views' chains.
        views: all views.
        evidence: observed points, which lie on cylinders or contradict them.
        random_seed: of the choice of hypotheses where there are many.
    """
    by_view = rows_by_view(lines.views, len(views))
    free = [rows[lines.fixed[rows] <= MAX_FIXED] for rows in by_view]
    tried, bases = chosen_hypotheses(*find_hypotheses(lines, free), random_seed)
    near = lines_near(free, views, np.unique(bases))
    supports = []
    for base, rows in near.items():
        own = Cylinders(*(part[bases == base] for part in tried))
        for support in supports_of(lines.select(rows), own):
            supports.append(replace(support, rows=rows[support.rows]))
    scores = np.array([support.score for support in supports])
    rays = Rays.of(evidence, views)
    used, refused = np.zeros((2, len(lines.views)), bool)
    found, points, num_fits, last = [], [], 0, 0
    for h in np.argsort(-scores, kind="stable"):
        rows = supports[h].rows
        if num_fits - last == MAX_REFUSED:
            break
        if not may_be_outlines(lines, supports[h], used) or refused[rows].mean() > TRIED_SHARE:
            continue
        num_fits += 1
        one, support = fitted(lines, Cylinders(*(part[h : h + 1] for part in tried)))
        refused[rows] = refused[support.rows] = True
        if not may_be_outlines(lines, support, used):
            continue
        if num_fixed_lines(lines, one, support) <= MAX_FIXED_LINES:
            continue
        extent = extent_of(lines, one, support, len(views))
        sight = sight_of_extent(one, extent, rays, views)
        ends = one.points[0] + extent.starts[[0, -1], None] * one.axes[0]
        few = sight.through.sum() <= MAX_THROUGH * np.sum(~sight.before)
        if not few or not is_believed(extent.shown, ends, views):
            continue
        on = points_on(one, extent, views, evidence, sight)
        if on is not None:
            used[support.rows], last = True, num_fits
            found.append(cylinder_of(one, extent))
            points.append(on)
    return FoundRound(
        faces=found,
        points=joined_seen([NO_POINTS, *points]),
        num_tried=len(scores),
        num_fitted=num_fits,
    )


def chosen_hypotheses(
    found: Cylinders, bases: IntArray, random_seed: int
) -> tuple[Cylinders, IntArray]:
    """At most `MAX_TRIED` of the hypotheses, and their views."""
    count = len(found.radii)
    if count <= MAX_TRIED:
        return found, bases
    drawn = np.random.default_rng(random_seed).choice(count, MAX_TRIED, replace=False)
    chosen = np.sort(drawn)
    return Cylinders(*(part[chosen] for part in found)), bases[chosen]


def lines_near(
    free: Sequence[IntArray], views: Sequence[View], bases: IntArray
) -> dict[int, IntArray]:
    """Of (V,) lines by view, those of the `NUM_NEAR` views nearest to each of (B,) views."""
    centers = np.array([view.center for view in views])
    count = min(NUM_NEAR, len(views))
    nearest = cKDTree(centers).query(centers[bases], count)[1].reshape(len(bases), count)
    return {
        base: np.concatenate([free[view] for view in np.sort(own)])
        for base, own in zip(bases.tolist(), nearest, strict=True)
    }


def may_be_outlines(lines: Lines, support: Support, used: BoolArray) -> bool:
    """Whether lines are outlines of a new cylinder: free ones, on both sides in some views."""
    rows = support.rows
    if not len(rows) or used[rows].mean() > SAME_SHARE:
        return False
    left, right = (lines.views[rows[support.sides == side]] for side in range(2))
    fixed = np.average(lines.fixed[rows], weights=lines.lengths[rows])
    return bool(fixed <= MAX_FIXED and len(np.intersect1d(left, right)) >= MIN_BOTH)


def cylinder_of(one: Cylinders, extent: Extent) -> RoundFace:
    """A cylinder for the output."""
    ends = extent.starts[[0, -1]]
    return RoundFace(
        kind="cylinder",
        point=one.points[0],
        direction=one.axes[0],
        profile=np.column_stack([ends, np.repeat(one.radii, 2)]),
        views=np.flatnonzero(on_both_sides(extent.shown)),
    )
