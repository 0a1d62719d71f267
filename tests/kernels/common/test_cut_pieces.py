"""Cutting polylines into lines and arcs, against every way of cutting tried in numpy."""

import numpy as np
import pytest
from curve_edges import arc, segment
from scipy.optimize import least_squares

from colmap_edges.kernels import _kernels

COSTS = (10.0, 16.0, 9.0, 1.0, 1e12)  # line, arc, point of neither, variance, shared


def cut(points, weights, costs=COSTS, offsets=None, most=1000, threads=1):
    offsets = np.array([0, len(points)]) if offsets is None else offsets
    rows = np.tile(np.array(costs), (1, len(offsets) - 1, 1))
    return _kernels.cut_pieces(points, weights, offsets, rows, most, threads)


def line_residual(points, weights):
    q = points - np.average(points, axis=0, weights=weights)
    return np.linalg.eigvalsh((weights[:, None] * q).T @ q)[:2].sum()


def arc_residual(points, weights):
    """Off the plane nearest to the points, and from the best circle in it, by scipy."""
    q = points - np.average(points, axis=0, weights=weights)
    values, axes = np.linalg.eigh((weights[:, None] * q).T @ q)
    plane = q @ axes[:, 1:]

    def misses(circle):
        return np.sqrt(weights) * (np.linalg.norm(plane - circle[:2], axis=1) - circle[2])

    rows = np.column_stack([2 * plane, np.ones(len(plane))])
    start = np.linalg.lstsq(rows, (plane**2).sum(axis=1), rcond=None)[0]
    start[2] = np.sqrt(start[2] + start[:2] @ start[:2])
    return values[0] + min(2 * least_squares(misses, start, x_scale="jac").cost, values[1])


def least_cost(points, weights, costs):
    """Dynamic programming over all cuts, with the fits above."""
    line, arc_price, nothing, variance, shared = costs
    best = [0.0]
    for j in range(1, len(points) + 1):
        options = [best[-1] + nothing]
        for i in range(j - 2):
            part, w = points[i:j], weights[i:j]
            scale = variance * (1 + (j - i) / shared)
            options.append(best[i] + line + line_residual(part, w) / scale)
            if j - i >= 5:
                options.append(best[i] + arc_price + arc_residual(part, w) / scale)
        best.append(min(options))
    return best[-1]


@pytest.fixture
def bent():
    """A line that goes over into an arc, with noise of 1e-3 and a stray point."""
    points = np.concatenate(
        [
            segment((-1.5, -1, 0), (-0.1, -1, 0), 8),
            arc(np.zeros(3), np.eye(3), (1, 1), -90, 40, 12),
        ]
    )
    points += 1e-3 * np.random.default_rng(3).normal(size=points.shape)
    points[3, 2] += 0.3
    return points, np.full(len(points), 1e6)


@pytest.mark.parametrize("shared", [1e12, 16.0])
def test_cost_is_that_of_the_best_of_all_cuts(bent, shared):
    costs = (*COSTS[:4], shared)
    totals, *_ = cut(*bent, costs)
    # Taubin's distances are those of the best circle but for the square of the noise.
    np.testing.assert_allclose(totals[0, 0], least_cost(*bent, costs), rtol=0.02)


def test_pieces_cover_every_point_once_and_change_where_the_curve_does(bent):
    _, bounds, kinds, offsets = cut(*bent)
    assert offsets.tolist() == [0, len(kinds)]
    np.testing.assert_array_equal(bounds[1:, 0], bounds[:-1, 1])
    assert (bounds[0, 0], bounds[-1, 1]) == (0, 20)
    assert [3, 4] in bounds[kinds == -1].tolist()  # the stray point
    (found,) = bounds[kinds == 1]
    assert abs(found[0] - 8) <= 1 and found[1] == 20


def test_coarse_places_are_refined_to_points():
    points = np.concatenate(
        [segment((0, 0, 0), (1, 0, 0), 101), segment((1, 0.01, 0), (1, 1, 0), 137)]
    )
    points += 1e-4 * np.random.default_rng(0).normal(size=points.shape)
    weights = np.full(len(points), 1e8)
    _, bounds, kinds, _ = cut(points, weights, most=16)
    (first, second) = bounds[kinds == 0].tolist()
    assert first[0] == 0 and second[1] == 238
    assert abs(first[1] - 101) <= 1 and abs(second[0] - 101) <= 1


def test_threads_and_place_in_the_world_change_nothing(bent):
    points, weights = bent
    offsets = np.array([0, 20, 20, 40])
    both = np.concatenate([points, 2.0 + points])
    found = [cut(both, np.tile(weights, 2), offsets=offsets, threads=threads) for threads in (1, 4)]
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
    totals, bounds, _, pieces = found[0]
    assert totals[0, 1] == 0 and pieces[1] == pieces[2]  # a polyline of no points
    np.testing.assert_array_equal(bounds[pieces[2] :] - 20, bounds[: pieces[1]])


@pytest.mark.parametrize(
    ("weights", "offsets", "most"),
    [(np.ones(4), [0, 5], 10), (np.ones(5), [0, 4], 10), (np.ones(5), [0, 5], 0)],
)
def test_what_does_not_fit_is_refused(weights, offsets, most):
    with pytest.raises(ValueError, match=r"must|differ"):
        cut(np.zeros((5, 3)), weights, offsets=np.array(offsets), most=most)
