import numpy as np
import pytest

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges3d.chains.contours import Seen, fit_radii
from colmap_edges.edges3d.chains.filtering import (
    Limits,
    filter_pieces,
    find_limits,
    lasting_points,
    scatter_of_points,
)
from colmap_edges.edges3d.chains.traced_curves import TracedCurves, TracedObservations
from colmap_edges.options import TracingOptions


def traced_curves(log_chances, num_observations, lengths, residuals=0.0, drifts=0.0, num_views=8):
    """Curves of one reference whose points have these chances, observations and residuals.

    Residuals are those of points, or (N, V) of points in views.
    """
    count = len(log_chances)
    observed = np.arange(num_views)[None, :] < np.asarray(num_observations)[:, None]
    residuals, drifts = (
        np.broadcast_to(of if of.ndim == 2 else of.reshape(-1, 1), observed.shape)
        for of in (np.asarray(residuals, float), np.asarray(drifts, float))
    )
    offsets = offsets_of(np.asarray(lengths, int))
    return TracedCurves(
        points=np.zeros((count, 3)),
        sigmas=np.ones(count),
        uncertainties=np.ones(count),
        log_chances=np.asarray(log_chances, float),
        offsets=offsets,
        reference=0,
        observations=TracedObservations.of_table(
            np.arange(num_views),
            np.where(observed, 1.0, np.nan),
            residuals=residuals.astype(np.float32),
            drifts=drifts.astype(np.float32),
        ),
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
    seen, residuals = rng.integers(3, 9, 40), rng.normal(size=(40, 8))
    traced = traced_curves(np.zeros(40), seen, [40], residuals)
    found, spare = scatter_of_points([traced])
    np.testing.assert_array_equal(spare, seen - 2)
    for point, scatter in enumerate(found):
        distances = np.abs(residuals[point, 1 : seen[point]])  # the reference view is the first
        assert scatter == pytest.approx(distances.sum() / (len(distances) - 1), rel=1e-6)


def test_scatter_of_points_that_no_other_view_observes_is_zero():
    traced = traced_curves(np.zeros(3), [1, 1, 2], [3], [0.0, 0.0, 0.4])
    np.testing.assert_allclose(scatter_of_points([traced])[0], [0.0, 0.0, 0.4], rtol=1e-6)


def test_what_scatters_is_an_outline_though_half_of_its_points_fit():
    fits, moves = [0.1, 0.3] * 10, [0.1, 0.9] * 10
    traced = traced_curves([-4.0] * 40, [6] * 40, [20, 20], fits + moves)
    limits = Limits(uncertainty_px=1.0, residual_px=0.4, log_chance=-3.0)
    edges, contours = filter_pieces(traced, np.ones(40, bool), limits, TracingOptions())
    np.testing.assert_array_equal(edges.observations.residuals, np.repeat(np.float32(fits), 6))
    np.testing.assert_array_equal(contours.observations.residuals, np.repeat(np.float32(moves), 6))


def test_limit_of_scatter_is_by_the_scenes_own_and_not_below_what_edges_have():
    options = TracingOptions(max_residual_ratio=2.0)
    clean, rough = (traced_curves([-4.0] * 5, [6] * 5, [5], of) for of in (0.01, 0.8))
    assert find_limits([clean], options).residual_px == options.min_residual_px
    assert find_limits([rough], options).residual_px == pytest.approx(2 * 0.8 * 5 / 4, rel=1e-6)


def test_limit_of_scatter_is_by_what_many_views_observe():
    options = TracingOptions(max_residual_ratio=2.0)
    edges, contours = traced_curves([-4.0] * 5, [8] * 5, [5], 0.3), [[-4.0] * 20, [3] * 20, [20]]
    many = find_limits([edges, traced_curves(*contours, 0.9)], options)
    assert many.residual_px == pytest.approx(2 * 0.3 * 7 / 6)  # of 30 observations, not of 5 points
    alone = find_limits([traced_curves(*contours, 0.9)], options)
    assert alone.residual_px == pytest.approx(2 * 0.9 * 2)


def seen_from(angles_deg, radius, displacement, noise, seed=0):
    """A rounded edge of this radius in pixels, seen from these angles, the reference view's first.

    Its lines of sight are tangent to a circle. Plain least squares place a fixed point in the
    plane across the edge; the residuals are of 40 points of the edge, (40, V), like the drifts.
    """
    angles = np.radians(angles_deg)
    rows = np.column_stack([np.cos(angles), np.sin(angles)])
    across = np.eye(len(angles)) - rows @ np.linalg.pinv(rows)
    noisy = np.random.default_rng(seed).normal(0, noise, (40, len(angles)))
    residuals = (noisy - radius - displacement) @ across.T
    drifts = np.broadcast_to(across.sum(axis=1), residuals.shape)
    seen = np.full(40, len(angles))
    return traced_curves([-4.0] * 40, seen, [40], residuals, drifts, len(angles))


NARROW, WIDE = np.linspace(0, 16, 9), np.linspace(-60, 60, 12)
LIMITS = Limits(uncertainty_px=1.0, residual_px=0.35, log_chance=-3.0)


def is_edge(traced):
    """Whether all of its points are on an edge; the others are on a contour."""
    edges, contours = filter_pieces(traced, np.ones(40, bool), LIMITS, TracingOptions())
    assert sorted([len(edges.points), len(contours.points)]) == [0, 40]
    return len(edges.points) == 40


@pytest.mark.parametrize("angles", [NARROW, WIDE], ids=["narrow", "wide"])
@pytest.mark.parametrize("noise", [0.02, 0.1, 0.2])
@pytest.mark.parametrize("displacement", [0.0, 0.5, -0.7])
def test_noisy_and_displaced_edges_are_edges(angles, noise, displacement):
    assert is_edge(seen_from(angles, 0.0, displacement, noise))


@pytest.mark.parametrize(
    ("angles", "radius"), [(NARROW, 80.0), (NARROW, -80.0), (WIDE, 5.0), (WIDE, -15.0)]
)
@pytest.mark.parametrize("noise", [0.02, 0.1, 0.2])
def test_outlines_of_rounded_bodies_are_contours(angles, radius, noise):
    traced = seen_from(angles, radius, 0.0, noise)
    assert not is_edge(traced)
    found = fit_radii(Seen.of(traced, np.zeros(40, int)))
    assert found == pytest.approx([radius], rel=0.1)


def test_the_residuals_of_contours_may_be_as_small_as_those_of_edges():
    noisy, moving = seen_from(WIDE, 0.0, 0.0, 0.25), seen_from(NARROW, 50.0, 0.0, 0.01)
    sizes = [np.abs(of.observations.residuals).mean() for of in (moving, noisy)]
    assert sizes[0] < sizes[1]
    assert is_edge(noisy)
    assert not is_edge(moving)


def test_a_radius_that_three_views_seem_to_have_is_noise():
    traced = seen_from([0, 20, 40, 60], 1.5, 0.0, 0.1)
    assert abs(fit_radii(Seen.of(traced, np.zeros(40, int)))[0]) > 1
    assert is_edge(traced)


def test_displaced_edges_scatter_too_much_for_a_fixed_edge():
    traced = seen_from(np.linspace(-80, 80, 12), 0.0, 0.7, 0.33)
    assert scatter_of_points([traced])[0].mean() > LIMITS.residual_px
    assert is_edge(traced)
