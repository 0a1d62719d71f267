import numpy as np
import pytest
from curve_scenes import make_view, ring_of_views
from hypothesis import given
from hypothesis import strategies as st
from pinhole_geometry import (
    cross_matrix,
    epipolar_lines,
    fundamental_matrix,
    point_segment_distances,
    reprojection_terms,
    triangulate,
    triangulate_linear,
    view_rays,
)

coordinate = st.floats(-1.5, 1.5)
VIEWS = ring_of_views()


def project(view, point):
    return view.project_undistorted(np.array([point]))[0][0]


def test_cross_matrix_is_the_cross_product():
    a, b = np.array([1.0, -2.0, 3.0]), np.array([0.5, 4.0, -1.0])
    np.testing.assert_allclose(cross_matrix(a) @ b, np.cross(a, b))


@given(coordinate, coordinate, coordinate, st.integers(0, 6), st.integers(0, 6))
def test_images_of_a_point_satisfy_the_epipolar_constraint(x, y, z, i, j):
    if i == j:
        return
    a, b = project(VIEWS[i], [x, y, z]), project(VIEWS[j], [x, y, z])
    fundamental = fundamental_matrix(VIEWS[i], VIEWS[j])
    line = epipolar_lines(fundamental, a[None])[0]
    assert np.hypot(line[0], line[1]) == pytest.approx(1)
    assert line @ np.append(b, 1) == pytest.approx(0, abs=1e-7)  # pixels from the line


def test_epipolar_line_of_equal_centres_is_nan():
    lines = epipolar_lines(fundamental_matrix(VIEWS[0], VIEWS[0]), np.array([[3.0, 4.0]]))
    assert np.isnan(lines).all()


@given(coordinate, coordinate, coordinate, st.integers(2, 7))
def test_triangulation_inverts_projection(x, y, z, count):
    pixels = np.array([project(view, [x, y, z]) for view in VIEWS[:count]])
    np.testing.assert_allclose(triangulate(VIEWS[:count], pixels), [x, y, z], atol=1e-7)
    np.testing.assert_allclose(triangulate_linear(VIEWS[:count], pixels), [x, y, z], atol=1e-7)


def test_rays_go_from_the_centre_through_the_point():
    point = np.array([0.3, -0.2, 0.5])
    ray = view_rays(VIEWS[2], project(VIEWS[2], point)[None])[0]
    expected = point - VIEWS[2].center
    np.testing.assert_allclose(ray, expected / np.linalg.norm(expected), atol=1e-12)


def test_point_behind_the_views_is_no_point():
    views = [make_view(0, (-1, 0, -6), (-1, 0, 0)), make_view(1, (1, 0, -6), (1, 0, 0))]
    diverging = np.array([[-80.0, 0.0], [80.0, 0.0]])  # the rays meet behind both
    assert np.isfinite(triangulate_linear(views, diverging)).all()
    assert np.isnan(triangulate(views, diverging)).all()


def test_parallel_rays_give_no_point():
    views = [make_view(0, (-1, 0, -6), (-1, 0, 0)), make_view(1, (1, 0, -6), (1, 0, 0))]
    assert np.isnan(triangulate(views, np.zeros((2, 2)))).all()


def test_jacobian_agrees_with_finite_differences():
    point, pixels = np.array([0.2, 0.4, -0.3]), np.zeros((7, 2))
    residuals, jacobian, _ = reprojection_terms(VIEWS, pixels, point)
    for k in range(3):
        moved = point + 1e-6 * np.eye(3)[k]
        difference = (reprojection_terms(VIEWS, pixels, moved)[0] - residuals) / 1e-6
        np.testing.assert_allclose(jacobian[:, k], difference, atol=1e-2)


def test_distances_to_segments():
    starts, ends = np.zeros((4, 2)), np.tile([10.0, 0.0], (4, 1))
    points = np.array([[5.0, 3.0], [-3.0, 4.0], [13.0, -4.0], [7.0, 0.0]])
    np.testing.assert_allclose(point_segment_distances(points, starts, ends), [3, 5, 5, 0])
    degenerate = point_segment_distances(np.array([[3.0, 4.0]]), np.zeros((1, 2)), np.zeros((1, 2)))
    np.testing.assert_allclose(degenerate, [5])
