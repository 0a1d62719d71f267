from dataclasses import replace

import numpy as np
import pytest
from curve_scenes import Curve, circle, graph_of, helix, line, ring_of_views
from pinhole_geometry import point_segment_distances

from colmap_edges.edges3d.paper.edge_field import ChainPositions, build_edge_field, next_points

VIEWS = ring_of_views(3)


def random_field(seed=0):
    """Wiggly open and closed chains with segments of very different lengths."""
    rng = np.random.default_rng(seed)
    graphs = []
    for view in VIEWS:
        graph = graph_of(view, [line((-1, -1, 0), (1, 1, 0)), circle((0, 0, 0), 0.8), helix()])
        walk = np.concatenate(
            [
                rng.uniform(-300, 300, 2) + np.cumsum(rng.normal(scale=scale, size=(n, 2)), axis=0)
                for n, scale in zip(np.diff(graph.polyline_offsets), (2.0, 1.0, 6.0), strict=True)
            ]
        )
        graphs.append(replace(graph, ideal=walk, points=view.image_from_ideal(walk)))
    return build_edge_field(VIEWS, graphs)


def segments_of(field, view):
    ids = np.repeat(np.arange(field.num_polylines), np.diff(field.polyline_offsets))
    rows = np.flatnonzero((field.polyline_views[ids] == view) & (field.next_points >= 0))
    return rows, ids[rows], field.ideal[rows], field.ideal[field.next_points[rows]]


def test_next_points_of_open_closed_empty_and_single():
    offsets = np.array([0, 3, 6, 6, 7])
    following = next_points(offsets, np.array([False, True, False, True]))
    np.testing.assert_array_equal(following, [1, 2, -1, 4, 5, 3, -1])


def test_lines_cross_where_brute_force_says():
    field = random_field()
    rng = np.random.default_rng(2)
    angles = rng.uniform(0, 2 * np.pi, 300)
    angles[:4] = np.arange(4) * np.pi / 2  # along the axes
    lines = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-400, 400, 300)])
    views = rng.integers(0, 3, 300).astype(np.int32)
    offsets, segments, fractions = field.kernel.intersect_lines(views, lines, 2)
    assert offsets[-1] > 500
    for q in range(300):
        rows, _, a, b = segments_of(field, views[q])
        before, after = (p @ lines[q, :2] + lines[q, 2] for p in (a, b))
        crossed = (before < 0) != (after < 0)
        found = slice(offsets[q], offsets[q + 1])
        np.testing.assert_array_equal(segments[found], rows[crossed])
        share = before[crossed] / (before[crossed] - after[crossed])
        np.testing.assert_allclose(fractions[found], share, atol=1e-6)


def test_near_polylines_are_those_of_brute_force():
    field = random_field()
    rng = np.random.default_rng(3)
    radii = rng.uniform(0, 60, 300)
    places = rng.integers(0, len(field.ideal), 300)
    pixels = field.ideal[places] + rng.normal(scale=20, size=(300, 2))
    pixels[0] = np.nan
    pixels[1] = 1e6
    views = field.views_at(ChainPositions(segments=places, fractions=np.zeros(300)))
    near = field.find_near(views, pixels, radii, 2)
    assert near.offsets[-1] > 100
    assert near.offsets[2] == 0
    for q in range(2, 300):
        _, ids, a, b = segments_of(field, views[q])
        distances = point_segment_distances(np.tile(pixels[q], (len(a), 1)), a, b)
        best = {i: distances[ids == i].min() for i in np.unique(ids)}
        expected = {i: d for i, d in best.items() if d <= radii[q]}
        found = slice(near.offsets[q], near.offsets[q + 1])
        assert near.polylines[found].tolist() == list(expected)
        np.testing.assert_allclose(near.distances[found], list(expected.values()), atol=1e-9)
    places = field.ideal_points(near.positions)
    np.testing.assert_allclose(
        np.linalg.norm(places - pixels[near.queries], axis=1), near.distances, atol=1e-9
    )
    np.testing.assert_array_equal(field.polylines_at(near.positions), near.polylines)
    np.testing.assert_array_equal(field.views_at(near.positions), views[near.queries])


def test_tangent_of_a_straight_chain():
    field = build_edge_field(VIEWS[:1], [graph_of(VIEWS[0], [line((-1, -1, 0), (1, 1, 0))])])
    last = len(field.ideal) - 2
    places = ChainPositions(segments=np.array([0, 50, last]), fractions=np.array([0, 0.5, 1.0]))
    direction = field.ideal[-1] - field.ideal[0]
    expected = np.tile(direction / np.linalg.norm(direction), (3, 1))
    np.testing.assert_allclose(field.tangents(places), expected, atol=1e-6)
    np.testing.assert_allclose(field.image_points(places)[2], field.points[-1], atol=1e-9)


def test_views_without_edges_are_searchable():
    field = build_edge_field(VIEWS, [graph_of(v, []) for v in VIEWS])
    near = field.find_near(np.array([0], np.int32), np.zeros((1, 2)), np.array([50.0]), 1)
    assert near.offsets.tolist() == [0, 0]
    offsets = field.kernel.intersect_lines(np.array([1], np.int32), np.array([[1.0, 0, 0]]), 1)[0]
    assert offsets.tolist() == [0, 0]


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="1 edge graphs for 3 views"):
        build_edge_field(VIEWS, [graph_of(VIEWS[0], [])])
    graph = graph_of(VIEWS[0], [Curve(np.array([[0.0, 0, 0], [1, 0, 0]]))])
    broken = replace(graph, ideal=np.full_like(graph.ideal, np.nan))
    with pytest.raises(ValueError, match="finite"):
        build_edge_field(VIEWS[:1], [broken])
    field = build_edge_field(VIEWS[:1], [graph])
    with pytest.raises(ValueError, match="not on a chain"):
        field.kernel.tangents(np.array([len(graph.ideal) - 1]), np.array([0.5]))
