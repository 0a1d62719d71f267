"""Polylines near pixels and candidates of edge points against all segments of random chains."""

from dataclasses import replace

import numpy as np
import pytest
from crossings import crossings, rounded, segments_of
from curve_scenes import circle, graph_of, helix, line, ring_of_views
from pinhole_geometry import epipolar_lines, fundamental_matrix, point_segment_distances

from colmap_edges.edges2d.edge_index import at_positions, make_edge_index
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

VIEWS = ring_of_views(3)


def wiggly(view, rng):
    """Open and closed chains with segments of very different lengths."""
    graph = graph_of(view, [line((-1, -1, 0), (1, 1, 0)), circle((0, 0, 0), 0.8), helix()])
    lengths = np.diff(graph.polyline_offsets)
    walks = [
        rng.uniform(-300, 300, 2) + np.cumsum(rng.normal(scale=scale, size=(n, 2)), axis=0)
        for n, scale in zip(lengths, (2.0, 1.0, 6.0), strict=True)
    ]
    return rounded(replace(graph, undistorted=np.concatenate(walks)))


RNG = np.random.default_rng(0)
GRAPHS = [wiggly(view, RNG) for view in VIEWS]
INDEXES = [make_edge_index(graph, view) for graph, view in zip(GRAPHS, VIEWS, strict=True)]


def random_starts(count):
    """(count,) views, and positions on their chains."""
    views = RNG.integers(0, 3, count).astype(np.int32)
    sizes = np.array([len(graph.undistorted) for graph in GRAPHS])
    return views, RNG.uniform(0, sizes[views])


def test_near_polylines_are_those_of_brute_force():
    views, positions = random_starts(300)
    radii = RNG.uniform(0, 60, 300)
    pixels = np.array(
        [GRAPHS[v].undistorted[int(p)] for v, p in zip(views, positions, strict=True)]
    )
    pixels += RNG.normal(scale=20, size=(300, 2))
    pixels[0] = np.nan
    pixels[1] = 1e6
    offsets, polylines, places, distances = _kernels.near_polylines(
        INDEXES, views, pixels, radii, 2
    )
    assert offsets[-1] > 100
    assert offsets[2] == 0
    for q in range(2, 300):
        graph = GRAPHS[views[q]]
        rows, a, b = segments_of(graph)
        ids = graph.polyline_ids[rows]
        apart = point_segment_distances(np.tile(pixels[q], (len(a), 1)), a, b)
        best = {i: apart[ids == i].min() for i in np.unique(ids)}
        expected = {i: d for i, d in best.items() if d <= radii[q]}
        found = slice(offsets[q], offsets[q + 1])
        assert polylines[found].tolist() == list(expected)
        np.testing.assert_allclose(distances[found], list(expected.values()), atol=1e-9)
        at = at_positions(graph, places[found], graph.undistorted)[0]
        gaps = np.linalg.norm(at - pixels[q], axis=1)
        np.testing.assert_allclose(gaps, distances[found], atol=1e-9)
        assert graph.polyline_ids[places[found].astype(int)].tolist() == list(expected)


def epipolar_line(view, position, other):
    pixel = at_positions(GRAPHS[view], np.array([position]), GRAPHS[view].undistorted)[0]
    return epipolar_lines(fundamental_matrix(VIEWS[view], VIEWS[other]), pixel)[0]


def check(found, expected):
    """Found (offsets, views, positions) are the expected lists of (view, position)."""
    offsets, views, positions = found
    assert offsets.tolist() == np.cumsum([0, *(len(each) for each in expected)]).tolist()
    wanted = np.array([place for each in expected for place in each])
    np.testing.assert_array_equal(views, wanted[:, 0])
    np.testing.assert_allclose(positions, wanted[:, 1], atol=1e-6)


def test_candidates_in_spheres_are_the_crossings_in_their_circles():
    views, positions = random_starts(600)
    centers, radii = RNG.uniform(-1, 1, (20, 3)), RNG.uniform(0.5, 2, 20)
    sphere = RNG.integers(0, 20, 600)
    seen = np.tile(np.arange(3, dtype=np.int32), 20)
    offsets = np.arange(0, 61, 3)
    expected = []
    for view, position, s in zip(views, positions, sphere, strict=True):
        found = []
        for other in np.delete(np.arange(3), view):
            places, pixels = crossings(GRAPHS[other], epipolar_line(view, position, other))
            middle, depth = VIEWS[other].project_undistorted(centers[s : s + 1])
            inside = np.linalg.norm(pixels - middle, axis=1) <= (
                radii[s] * VIEWS[other].focal_px / depth
            )
            found += [(other, place) for place in places[inside]]
        expected.append(found)
    assert sum(len(each) for each in expected) > 500
    arguments = (INDEXES, views, positions, sphere, centers, radii, offsets, seen)
    check(_kernels.candidates_in_spheres(*arguments, 2), expected)


def test_candidates_in_pecs_are_the_crossings_of_polylines_of_the_label():
    views, positions = random_starts(200)
    labels = np.array([0, 1, -1, 1, 0, 0, 1, 1, 0], np.int32)
    anywhere = np.tile([0.0, np.inf], (3, 1))
    expected = []
    for view, position in zip(views, positions, strict=True):
        found, label = [], labels[3 * view + GRAPHS[view].polyline_ids[int(position)]]
        for other in np.delete(np.arange(3), view) if label >= 0 else ():
            places, _ = crossings(GRAPHS[other], epipolar_line(view, position, other))
            of_place = labels[3 * other + GRAPHS[other].polyline_ids[places.astype(int)]]
            found += [(other, place) for place in places[of_place == label]]
        expected.append(found)
    assert sum(len(each) for each in expected) > 500
    check(_kernels.candidates_in_pecs(INDEXES, views, positions, labels, anywhere, 2), expected)


def test_views_without_edges_are_searchable():
    empty = [make_edge_index(graph_of(view, []), view) for view in VIEWS]
    offsets = _kernels.near_polylines(
        empty, np.array([0], np.int32), np.zeros((1, 2)), np.array([50.0]), 1
    )[0]
    assert offsets.tolist() == [0, 0]


def test_places_off_the_chains_are_refused():
    labels, anywhere = np.zeros(9, np.int32), np.tile([0.0, np.inf], (3, 1))
    one = np.zeros(1, np.int32)
    for position in (-0.5, float(len(GRAPHS[0].undistorted)), np.nan):
        with pytest.raises(ValueError, match="not on a chain"):
            _kernels.candidates_in_pecs(INDEXES, one, np.array([position]), labels, anywhere, 1)
    with pytest.raises(ValueError, match="view index"):
        _kernels.candidates_in_pecs(INDEXES, one + 3, np.zeros(1), labels, anywhere, 1)
    with pytest.raises(ValueError, match="one label"):
        _kernels.candidates_in_pecs(INDEXES, one, np.zeros(1), labels[1:], anywhere, 1)
