import numpy as np
from scipy.sparse import csr_array

from colmap_edges.csr import offsets_of
from colmap_edges.options import TracingOptions
from colmap_edges.sorting import Traced, lasting_points


def traced_curves(log_chances, num_observations, lengths):
    """Curves of one driver whose points have these chances and so many observations."""
    count = len(log_chances)
    observed = np.arange(8)[None, :] < np.asarray(num_observations)[:, None]
    offsets = offsets_of(np.asarray(lengths, int))
    return Traced(
        points=np.zeros((count, 3)),
        sigmas=np.ones(count),
        uncertainties=np.ones(count),
        residuals=np.zeros(count),
        log_chances=np.asarray(log_chances, float),
        offsets=offsets,
        views=np.arange(8),
        positions=csr_array(np.where(observed, 1.0, 0.0)),
    )


def test_curves_that_chance_may_have_made_do_not_last():
    options = TracingOptions(point_spacing_px=4)
    traced = traced_curves([-4.0] * 20 + [-0.3] * 20, [5] * 40, [20, 20])
    # 20 points at 4 px are evidence of 5: 10^-20 and 10^-1.5, against one in 60 tests.
    np.testing.assert_array_equal(lasting_points(traced, options), np.arange(40) < 20)


def test_points_observed_too_seldom_do_not_last_and_cut_curves():
    options = TracingOptions(point_spacing_px=4, min_observations=3, min_curve_points=3)
    seen = np.full(22, 5)
    seen[2] = 2  # two points before it are no curve
    lasting = lasting_points(traced_curves([-4.0] * 22, seen, [22]), options)
    np.testing.assert_array_equal(lasting, np.arange(22) > 2)


def test_of_no_curves_nothing_lasts():
    assert len(lasting_points(traced_curves([], np.zeros(0, int), []), TracingOptions())) == 0
