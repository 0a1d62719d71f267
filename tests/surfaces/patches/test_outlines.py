"""Points of outlines beside patches."""

import numpy as np

from colmap_edges.core.outlines import NO_OUTLINES, Outlines
from colmap_edges.surfaces.patches.finding import NO_PATCHES
from colmap_edges.surfaces.patches.outlines import with_outlines


def some_outlines(first_view):
    return Outlines(
        points=np.arange(6.0).reshape(2, 3),
        normals=np.array([[0.0, 0, 1], [0, 1, 0]]),
        sigmas=np.array([0.1, 0.2]),
        colors=np.array([[30, 60, 90], [1, 2, 3]], np.uint8),
        track_offsets=np.array([0, 2, 5]),
        track_views=np.arange(first_view, first_view + 5, dtype=np.int32),
    )


def test_outlines_follow_patches_with_their_tracks():
    once = with_outlines(NO_PATCHES, some_outlines(0))
    twice = with_outlines(once, some_outlines(7))
    twice.check(num_views=12)
    assert twice.points.track_offsets.tolist() == [0, 2, 5, 7, 10]
    assert twice.points.chosen(np.array([2])).track_views.tolist() == [7, 8]
    assert twice.num_outlines == 4 and len(twice.textured.points) == 0
    assert twice.grays.tolist() == [60, 2, 60, 2]
    assert twice.tolerances.tolist() == twice.sigmas.tolist() == [0.1, 0.2, 0.1, 0.2]


def test_no_outlines_change_nothing():
    patches = with_outlines(NO_PATCHES, some_outlines(0))
    same = with_outlines(patches, NO_OUTLINES)
    assert np.array_equal(same.points.points, patches.points.points)
    assert np.array_equal(same.points.track_views, patches.points.track_views)
