import numpy as np
import pytest

from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.observations import ChainObservations
from colmap_edges.edges3d.chains.filtering import (
    Limits,
    Traced,
    find_limits,
    lasting_points,
    scatter_of,
    sort_pieces,
)
from colmap_edges.options import PipelineOptions, TracingOptions, resolved


def traced_curves(log_chances, num_observations, lengths, residuals=0.0):
    """Curves of one reference whose points have these chances, observations and residuals."""
    count = len(log_chances)
    observed = np.arange(8)[None, :] < np.asarray(num_observations)[:, None]
    offsets = offsets_of(np.asarray(lengths, int))
    return Traced(
        points=np.zeros((count, 3)),
        sigmas=np.ones(count),
        uncertainties=np.ones(count),
        residuals=np.broadcast_to(np.asarray(residuals, float), count),
        log_chances=np.asarray(log_chances, float),
        offsets=offsets,
        reference=0,
        observations=ChainObservations.of_table(np.arange(8), np.where(observed, 1.0, np.nan)),
    )


def test_curves_that_chance_may_have_made_do_not_last():
    options = TracingOptions(curve_step_points=4)
    traced = traced_curves([-4.0] * 20 + [-0.3] * 20, [5] * 40, [20, 20])
    # 20 points at 4 px are evidence of 5: 10^-20 and 10^-1.5, against one in 60 tests.
    np.testing.assert_array_equal(lasting_points(traced, options, None), np.arange(40) < 20)


def test_points_observed_too_seldom_do_not_last_and_cut_curves():
    options = TracingOptions(curve_step_points=4, min_observations=3, min_curve_points=3)
    seen = np.full(22, 5)
    seen[2] = 2  # two points before it are no curve
    lasting = lasting_points(traced_curves([-4.0] * 22, seen, [22]), options, None)
    np.testing.assert_array_equal(lasting, np.arange(22) > 2)


def test_of_no_curves_nothing_lasts():
    nothing = traced_curves([], np.zeros(0, int), [])
    assert len(lasting_points(nothing, TracingOptions(), None)) == 0


def test_contours_do_not_last_where_it_is_known_how_much_edges_scatter():
    traced = traced_curves([-4.0] * 40, [5] * 40, [20, 20], [0.1] * 20 + [0.6] * 20)
    limits = Limits(uncertainty_px=1.0, residual_px=0.4, log_chance=-3.0)
    np.testing.assert_array_equal(lasting_points(traced, TracingOptions(), None), True)
    lasting = lasting_points(traced, TracingOptions(), limits)
    np.testing.assert_array_equal(lasting, np.arange(40) < 20)


def test_scatter_is_that_of_all_observations_but_those_that_fix_the_depths():
    rng = np.random.default_rng(5)
    seen, residuals = rng.integers(3, 9, 40), rng.random(40)
    groups = rng.permutation(np.repeat(np.arange(4), 10))
    traced = traced_curves(np.zeros(40), seen, [40], residuals)
    for group, found in enumerate(scatter_of(traced, groups)):
        rows = groups == group
        distances = np.repeat(residuals[rows], seen[rows] - 1)
        assert found == pytest.approx(distances.sum() / (len(distances) - rows.sum()))


def test_scatter_of_points_that_no_other_view_observes_is_zero():
    traced = traced_curves(np.zeros(3), [1, 1, 2], [3], [0.0, 0.0, 0.4])
    np.testing.assert_array_equal(scatter_of(traced, np.array([0, 0, 1])), [0.0, 0.4])


def test_what_scatters_is_an_outline_though_half_of_its_points_fit():
    fits, moves = [0.1, 0.3] * 10, [0.1, 0.9] * 10
    traced = traced_curves([-4.0] * 40, [6] * 40, [20, 20], fits + moves)
    limits = Limits(uncertainty_px=1.0, residual_px=0.4, log_chance=-3.0)
    edges, contours = sort_pieces(traced, np.ones(40, bool), limits, TracingOptions())
    np.testing.assert_array_equal(edges.residuals, fits)
    np.testing.assert_array_equal(contours.residuals, moves)


def test_limit_of_scatter_is_by_the_scenes_own_and_not_below_what_edges_have():
    options = TracingOptions(max_residual_ratio=2.0)
    clean, rough = (traced_curves([-4.0] * 5, [6] * 5, [5], of) for of in (0.01, 0.8))
    assert find_limits([clean], options).residual_px == options.min_residual_px
    upsampled = resolved(PipelineOptions(tracing=options), 1.5).tracing
    assert find_limits([clean], upsampled).residual_px == 1.5 * options.min_residual_px
    assert find_limits([rough], upsampled).residual_px == pytest.approx(2 * 0.8 * 5 / 4)


def test_limit_of_scatter_is_by_what_many_views_observe():
    options = TracingOptions(max_residual_ratio=2.0)
    edges, contours = traced_curves([-4.0] * 5, [8] * 5, [5], 0.3), [[-4.0] * 20, [3] * 20, [20]]
    many = find_limits([edges, traced_curves(*contours, 0.9)], options)
    assert many.residual_px == pytest.approx(2 * 0.3 * 7 / 6)  # of 30 observations, not of 5 points
    alone = find_limits([traced_curves(*contours, 0.9)], options)
    assert alone.residual_px == pytest.approx(2 * 0.9 * 2)
