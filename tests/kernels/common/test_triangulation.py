"""Triangulation of tracks against numpy."""

import numpy as np
import pytest
from curve_scenes import graph_of, ring_of_views
from pinhole_geometry import reprojection_terms, triangulate

from colmap_edges.edges2d.edge_index import make_edge_index
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

VIEWS = ring_of_views()
INDEXES = [make_edge_index(graph_of(view, []), view) for view in VIEWS]


def project(view, point):
    return view.project_undistorted(np.array([point]))[0][0]


def test_kernel_triangulates_like_numpy():
    rng = np.random.default_rng(1)
    views, pixels, offsets = [], [], [0]
    for _ in range(200):
        chosen = rng.permutation(len(VIEWS))[: rng.integers(2, 8)]
        point = rng.uniform(-1, 1, 3)
        views.append(chosen)
        pixels.append([project(VIEWS[v], point) + rng.normal(scale=1.0, size=2) for v in chosen])
        offsets.append(offsets[-1] + len(chosen))
    arguments = (
        INDEXES,
        np.array(offsets, np.int64),
        np.concatenate(views).astype(np.int32),
        np.concatenate(pixels),
    )
    points, errors = _kernels.triangulate_tracks(*arguments, 1)
    for i, chosen in enumerate(views):
        expected = triangulate([VIEWS[v] for v in chosen], np.array(pixels[i]))
        np.testing.assert_allclose(points[i], expected, atol=1e-5)
        residuals = reprojection_terms([VIEWS[v] for v in chosen], np.array(pixels[i]), points[i])
        largest = np.linalg.norm(residuals[0].reshape(-1, 2), axis=1).max()
        assert errors[i] == pytest.approx(largest, abs=1e-6)
    again = _kernels.triangulate_tracks(*arguments, 2)
    assert again[0].tobytes() == points.tobytes()


def test_kernel_marks_tracks_that_do_not_triangulate():
    one = np.array([0], np.int32), np.zeros((1, 2))
    points, errors = _kernels.triangulate_tracks(INDEXES, np.array([0, 1]), *one, 1)
    assert np.isnan(points).all()
    assert np.isinf(errors).all()
    with pytest.raises(ValueError, match="view index"):
        _kernels.triangulate_tracks(INDEXES, np.array([0, 1]), np.array([9], np.int32), one[1], 1)
    with pytest.raises(ValueError, match="offsets"):
        _kernels.triangulate_tracks(INDEXES, np.array([0, 2]), *one, 1)
