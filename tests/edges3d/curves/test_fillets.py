"""Rounded corners of few points between lines are arcs, sharp ones are not."""

from itertools import pairwise

import numpy as np
import pytest
from curve_edges import edges_of, lines_around, rounded_rectangle, segment

from colmap_edges.core.curves3d import ARC, LINE
from colmap_edges.edges3d.curves.fitting import fit_curves


def outline_curves(radius, roll, step=0.02, sigma=3e-4):
    """The curves of a closed outline that begins anywhere."""
    outline = np.roll(rounded_rectangle(1.0, 0.6, radius, step / 20)[::20], roll, axis=0)
    edges = edges_of([*lines_around(), outline], [False] * 30 + [True], sigma=sigma)
    return fit_curves(edges)


@pytest.mark.parametrize("roll", [0, 3, 40])
@pytest.mark.parametrize("radius", [0.07, 0.08])
def test_rounded_corners_of_few_points_are_arcs(radius, roll):
    curves = outline_curves(radius, roll)
    own = curves.edges == 30
    kinds = curves.kinds[own]
    assert (kinds == LINE).sum() == 4
    assert (kinds == ARC).sum() == 4
    arcs = own & (curves.kinds == ARC)
    np.testing.assert_allclose(curves.radii[arcs, 0], radius, rtol=0.05)
    inside = np.diff(curves.ranges[arcs], axis=1)[:, 0]
    assert ((inside >= 3) & (inside <= 8)).all()
    assert (np.diff(curves.spans[arcs], axis=1) < np.pi).all()
    # Lines and arcs meet: what is sampled is the outline throughout.
    points, owners = curves.sampled(0.005)
    points = points[curves.edges[owners] == 30]
    dense = rounded_rectangle(1.0, 0.6, radius, 0.001)
    off = np.linalg.norm(points[:, None] - dense, axis=2).min(axis=1)
    assert off.max() < 0.004


def test_sharp_corners_are_none():
    corners = [(0, 0, 0), (1, 0, 0), (1, 0.6, 0), (0, 0.6, 0), (0, 0, 0)]
    sides = [segment(a, b, 40)[:-1] for a, b in pairwise(corners)]
    outline = np.concatenate(sides)
    outline[39] += (-0.004, 0.004, 0)  # a corner that blur has rounded
    edges = edges_of([*lines_around(), outline], [False] * 30 + [True], sigma=3e-4)
    assert fit_curves(edges).kinds.tolist() == [LINE] * 34


def test_stray_points_between_lines_are_no_fillet():
    random = np.random.default_rng(3)
    middle = np.array([1, 0, 0]) + 0.05 * random.normal(size=(5, 3))
    broken = np.concatenate(
        [segment((0, 0, 0), (0.95, 0, 0), 40), middle, segment((1, 0.05, 0), (1, 1, 0), 40)]
    )
    curves = fit_curves(edges_of([*lines_around(), broken], sigma=3e-4))
    assert ARC not in curves.kinds[curves.edges == 30]
