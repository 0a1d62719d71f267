"""Detection of cylinders: hypotheses, their support by all views, acceptance, points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from colmap_edges.core.arrays import BoolArray
from colmap_edges.core.seen_points import NO_POINTS, joined_seen
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.surfaces.cylinders.extent import profile_of
from colmap_edges.surfaces.cylinders.hypotheses import Cylinders, find_hypotheses
from colmap_edges.surfaces.cylinders.lines import Lines
from colmap_edges.surfaces.cylinders.support import (
    Support,
    fitted,
    num_fixed_lines,
    supports_of,
)
from colmap_edges.surfaces.faces.evidence import Evidence
from colmap_edges.surfaces.revolution.bodies import found_on
from colmap_edges.surfaces.round_evidence import MIN_BOTH, SAME_SHARE, TRIED_SHARE, FoundRound, Rays

# Maximum share of the outlines' length that fixed edges observe: edges of posts do not move.
MAX_FIXED = 0.6
MAX_FIXED_LINES = 4  # maximum number of lines that may explain all outlines: those of a post
MAX_REFUSED = 8  # number of fitted hypotheses refused one after the other that ends the search


def find_cylinders(lines: Lines, views: Sequence[View], evidence: Evidence) -> FoundRound:
    """Find the cylinders whose outlines views show.

    Args:
        lines: straight pieces of the views' chains.
        views: all views.
        evidence: observed points, which lie on cylinders or contradict them.
    """
    by_view = rows_by_view(lines.views, len(views))
    free = [rows[lines.fixed[rows] <= MAX_FIXED] for rows in by_view]
    found = find_hypotheses(lines, free)
    tried = [Cylinders(*(part[h : h + 1] for part in found)) for h in range(len(found.radii))]
    supports = supports_of(lines, found)
    rays = Rays.of(evidence, views)
    used, refused = np.zeros((2, len(lines.views)), bool)
    faces, points, num_fits, last = [], [], 0, 0
    for h in np.argsort([-support.score for support in supports], kind="stable").tolist():
        rows = supports[h].rows
        if num_fits - last == MAX_REFUSED:
            break
        if not may_be_outlines(lines, supports[h], used) or refused[rows].mean() > TRIED_SHARE:
            continue
        num_fits += 1
        one, support = fitted(lines, tried[h])
        refused[rows] = refused[support.rows] = True
        if not may_be_outlines(lines, support, used):
            continue
        if num_fixed_lines(lines, one, support) <= MAX_FIXED_LINES:
            continue
        profile = profile_of(lines, one, support, views)
        if profile and (body := found_on(profile, rays, views, evidence)):
            used[support.rows], last = True, num_fits
            faces += body[0]
            points.append(body[1])
    return FoundRound(
        faces=faces,
        points=joined_seen([NO_POINTS, *points]),
        num_tried=len(tried),
        num_fitted=num_fits,
    )


def may_be_outlines(lines: Lines, support: Support, used: BoolArray) -> bool:
    """Whether lines are outlines of a new cylinder: free ones, on both sides in some views."""
    rows = support.rows
    if not len(rows) or used[rows].mean() > SAME_SHARE:
        return False
    left, right = (lines.views[rows[support.sides == side]] for side in range(2))
    fixed = np.average(lines.fixed[rows], weights=lines.lengths[rows])
    return bool(fixed <= MAX_FIXED and len(np.intersect1d(left, right)) >= MIN_BOTH)
