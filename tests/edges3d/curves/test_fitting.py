"""What edges are said to be, on edges sampled from known curves."""

from dataclasses import fields, replace

import numpy as np
import pytest
from curve_edges import arc, edges_of, frame, rounded_rectangle, segment, shapes_of_each_kind

from colmap_edges.core.curves3d import KINDS, Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges3d.curves.fitting import fit_curves


def kinds(curves):
    return [KINDS[kind] for kind in curves.kinds]


def lines_around(count=30):
    """Straight edges, from which the noise is learned."""
    random = np.random.default_rng(7)
    starts, ends = random.normal(size=(2, count, 3))
    return [segment(a, b, 25) for a, b in zip(starts, ends, strict=True)]


@pytest.fixture(scope="module")
def shapes():
    return shapes_of_each_kind()


def test_each_kind_is_told(shapes):
    polylines = [*lines_around(), *(polyline for _, polyline, _ in shapes)]
    edges = edges_of(polylines, [False] * 30 + [closed for *_, closed in shapes])
    curves = fit_curves(edges)
    assert kinds(curves)[:30] == ["line"] * 30
    assert kinds(curves)[30:] == [kind for kind, *_ in shapes]
    np.testing.assert_array_equal(curves.edges, np.arange(36))
    still = ~edges.closed  # others may begin anywhere
    np.testing.assert_array_equal(curves.ranges[still, 0], edges.edge_offsets[:-1][still])
    radii = curves.radii[30:]
    np.testing.assert_allclose(radii[1:5, 0], [0.5, 0.4, 0.9, 0.8], rtol=0.005)
    np.testing.assert_allclose(radii[1:5, 1], [0.5, 0.4, 0.5, 0.5], rtol=0.005)
    assert np.isnan(radii[[0, 5]]).all()
    found, owners = curves.sampled(0.01)
    for curve, (_, polyline, _) in enumerate(shapes, 30):
        near = np.linalg.norm(found[owners == curve][:, None] - polyline, axis=2).min(axis=1)
        assert near.max() < 0.035  # half a step beside the noise


def test_deviations_are_those_of_repeated_trials():
    errors = []
    exact = [arc(np.zeros(3), frame(k), (1, 1), 0, 120, 40) for k in range(120)]
    curves = fit_curves(edges_of([*lines_around(), *exact], sigma=1e-3))
    chosen = curves.kinds == 1
    assert chosen.sum() > 115
    errors = (curves.radii[chosen, 0] - 1) / curves.radius_sigmas[chosen, 0]
    # Deviations are those of the effective noise, which is larger as errors have tails (TAILS).
    assert 0.2 < errors.std() < 1.1


def test_kind_changes_where_the_curve_does():
    outline = rounded_rectangle(1.0, 0.6, 0.2, 0.02)
    curves = fit_curves(edges_of([*lines_around(), outline], [False] * 30 + [True], sigma=3e-4))
    own = curves.edges == 30
    assert sorted(np.array(kinds(curves))[own].tolist()) == ["arc"] * 4 + ["line"] * 4
    np.testing.assert_allclose(curves.radii[own & (curves.kinds == 1), 0], 0.2, rtol=0.03)
    ends = curves.ends()[own]
    gaps = np.linalg.norm(ends - np.roll(ends[:, ::-1], -1, axis=0), axis=2)[:, 1]
    assert np.sort(gaps)[:7].max() < 0.005  # successive ones meet, but where the loop begins


def test_corner_is_where_lines_meet():
    corner = np.concatenate(
        [segment((0, 0, 0), (1, 0, 0), 30), segment((1, 0.03, 0), (1, 1, 0), 30)]
    )
    curves = fit_curves(edges_of([*lines_around(), corner]))
    first, second = np.flatnonzero(curves.edges == 30)
    ends = curves.ends()
    np.testing.assert_allclose(ends[first, 1], ends[second, 0], atol=1e-15)
    np.testing.assert_allclose(ends[first, 1], (1, 0, 0), atol=0.003)


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_noise_is_learned_where_deviations_are_wrong(shapes, factor):
    polylines = [*lines_around(60), *(polyline for _, polyline, _ in shapes[:3])]
    edges = edges_of(polylines, [False] * 62 + [True])
    curves = fit_curves(replace(edges, sigmas=factor * edges.sigmas))
    assert kinds(curves) == ["line"] * 61 + ["arc", "circle"]


@pytest.mark.parametrize(("scale", "offset"), [(1e-6, 0.0), (1e6, 0.0), (1.0, 5e4)])
def test_unit_and_origin_change_nothing(shapes, scale, offset):
    polylines = [*lines_around(), *(polyline for _, polyline, _ in shapes[:4])]
    edges = edges_of(polylines, [False] * 32 + [True, False])
    moved = replace(edges, points=scale * edges.points + offset, sigmas=scale * edges.sigmas)
    one, other = fit_curves(edges), fit_curves(moved)
    np.testing.assert_array_equal(one.kinds, other.kinds)
    np.testing.assert_array_equal(one.ranges, other.ranges)
    np.testing.assert_allclose(scale * one.radii, other.radii, rtol=1e-5)


def test_a_stray_point_is_of_no_curve_and_parts_none():
    edges = edges_of(lines_around())
    points = edges.points.copy()
    points[12] += (0.2, 0.1, -0.3)
    curves = fit_curves(replace(edges, points=points))
    assert kinds(curves) == ["line"] * 30
    middle = (edges.points[0] + edges.points[24]) / 2
    np.testing.assert_allclose(curves.at(np.array([0]), np.array([0.5]))[0], middle, atol=0.005)


def test_points_without_deviations_and_without_noise():
    polylines = [segment((0, 0, 0), (1, 1, 1), 30), arc(np.zeros(3), frame(5), (1, 1), 0, 200, 60)]
    curves = fit_curves(edges_of(polylines, sigma=0))
    assert kinds(curves) == ["line", "arc"]
    np.testing.assert_allclose(curves.radii[1], 1, rtol=1e-6)


def test_short_edges_are_lines_and_none_is_none():
    assert fit_curves(Edges3D.none()).num_curves == 0
    polylines = [segment((k, 0, 0), (k, 1, 0), 2 + k) for k in range(4)]
    assert kinds(fit_curves(edges_of(polylines))) == ["line"] * 4


def test_threads_change_nothing(shapes):
    polylines = [polyline for _, polyline, _ in shapes]
    edges = edges_of(polylines, [closed for *_, closed in shapes])
    one, other = (fit_curves(edges, num_threads=threads) for threads in (1, 4))
    for entry in fields(Curves3D):
        np.testing.assert_array_equal(getattr(one, entry.name), getattr(other, entry.name))


@pytest.mark.parametrize("seed", range(12))
def test_degenerate_edges_give_finite_curves(seed):
    """Points on one place, on a grid, of any size, and deviations that are none."""
    random = np.random.default_rng(seed)
    polylines, closed = [], []
    for kind in random.integers(0, 5, random.integers(1, 10)):
        count = int(random.integers(1, 40))
        walk = np.cumsum(random.normal(size=(count, 3)), axis=0)
        shapes = (
            np.zeros((count, 3)),
            walk,
            np.round(walk),
            segment((0, 0, 0), (1, 1, 0), count),
            arc(np.zeros(3), np.eye(3), (1, 1), 0, 700, count),
        )
        polylines.append(shapes[kind] * 10.0 ** random.integers(-6, 6))
        closed.append(bool(random.random() < 0.4) and count > 2)
    edges = edges_of(polylines, closed, sigma=float(random.choice([0, 1e-9, 1e-3, 10])))
    sigmas = edges.sigmas.copy()
    sigmas[random.random(len(sigmas)) < 0.2] = random.choice([np.nan, np.inf, 0])
    for regularize in (False, True):
        curves = fit_curves(replace(edges, sigmas=sigmas), regularize=regularize)
        assert np.isfinite(curves.frames).all() and np.isfinite(curves.spans).all()
        assert np.isfinite(curves.control_points).all() and np.isfinite(curves.lengths()).all()
        assert (np.diff(curves.ranges)[:, 0] >= 2).all()
