from dataclasses import replace

import numpy as np
import pytest
from curve_scenes import (
    circle,
    distances_to_curves,
    graph_of,
    helix,
    line,
    make_view,
    ring_of_views,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.edges3d.paper.observations import edge_neighbours, observations_at
from colmap_edges.edges3d.paper.places import index_views
from colmap_edges.edges3d.paper.sampling import sample_edges
from colmap_edges.edges3d.paper.visibility import (
    drop_doubtful_views,
    expand_visibility,
    filter_outliers,
    keep_points,
    min_inlier_views,
)
from colmap_edges.options import SamplingOptions, VisibilityOptions

VIEWS = ring_of_views()
LINE, HELIX = line((-0.3, -1, 0), (0.2, 1, 0.3)), helix()
OPTIONS = VisibilityOptions()


def edges_of(curves, view_indices, spacing=60, views=VIEWS):
    """3D edges on known curves with exact observations in some views."""
    points, lengths = [], []
    for curve in curves:
        points.append(curve.points[spacing:-spacing:spacing])
        lengths.append(len(points[-1]))
    points = np.concatenate(points)
    pixels = np.array([views[v].project(points)[0] for v in view_indices])
    count = len(view_indices)
    return Edges3D(
        points=points,
        edge_offsets=np.concatenate([[0], np.cumsum(lengths)]),
        closed=np.array([curve.closed for curve in curves]),
        observations=Observations.of_pixels(
            offsets=np.arange(0, count * len(points) + 1, count),
            views=np.tile(np.array(view_indices, np.int32), len(points)),
            pixels=pixels.transpose(1, 0, 2).reshape(-1, 2),
        ),
        sigmas=np.full(len(points), np.nan),
        end_nodes=np.full((len(curves), 2), -1, np.int32),
        colors=np.arange(3 * len(points)).reshape(-1, 3).astype(np.uint8),
    )


def on_their_chains(edges, chains, max_distance_px=2.0):
    """The same edges with their observations at the nearest places of the chains."""
    observed = edges.observations
    pixels = np.empty((len(observed.views), 2))
    for view, rows in observed.by_view():
        pixels[rows] = chains.views[view].undistorted_from_image(observed.pixels[rows])
    near = chains.find_near(observed.views, pixels, np.full(len(pixels), max_distance_px), 1)
    order = np.lexsort((near.distances, near.queries))
    _, first = np.unique(near.queries[order], return_index=True)
    nearest = order[first]
    assert len(nearest) == len(pixels)
    placed = observations_at(observed.points, near.places.select(nearest), chains)
    return replace(edges, observations=placed.by_point(edges.num_points))


def check(edges):
    assert edges.edge_offsets[0] == edges.observations.offsets[0] == 0
    assert edges.edge_offsets[-1] == edges.num_points == len(edges.sigmas)
    assert len(edges.observations.offsets) == edges.num_points + 1
    assert (
        edges.observations.offsets[-1]
        == len(edges.observations.views)
        == len(edges.observations.pixels)
    )
    ids = np.repeat(np.arange(edges.num_points), np.diff(edges.observations.offsets))
    keys = ids * 1000 + edges.observations.views
    assert (np.diff(keys) > 0).all()  # a view at most once a point, ascending


def test_all_views_of_an_edge_are_found():
    chains = index_views(VIEWS, [graph_of(view, [LINE, HELIX]) for view in VIEWS])
    edges = on_their_chains(edges_of([LINE, HELIX], [0, 3, 6]), chains)
    expanded, stats = expand_visibility(edges, chains, OPTIONS, 1)
    check(expanded)
    views = np.diff(expanded.observations.offsets)
    assert np.mean(views == len(VIEWS)) > 0.9  # but near where the curves cross in an image
    assert distances_to_curves(expanded.points, [LINE, HELIX]).max() < 1e-3
    assert stats["observations_after"] == len(expanded.observations.views)
    assert stats["observations_before"] == 3 * edges.num_points


def expanded_views(graph_curves, options=OPTIONS, noise=None):
    """Views of LINE's points after expansion when view 1 sees other curves than the rest."""
    graphs = [graph_of(view, [LINE]) for view in VIEWS]
    graphs[1] = graph_of(VIEWS[1], graph_curves)
    if noise is not None:
        graphs[1] = replace(graphs[1], undistorted=graphs[1].undistorted + noise)
    chains = index_views(VIEWS, graphs)
    others = [v for v in range(len(VIEWS)) if v != 1]
    edges = on_their_chains(edges_of([LINE], others), chains)
    expanded, _ = expand_visibility(edges, chains, options, 1)
    check(expanded)
    return np.count_nonzero(expanded.observations.views == 1) / expanded.num_points


def test_the_same_curve_is_taken():
    assert expanded_views([LINE]) == 1


def test_two_near_polylines_are_left_alone():
    beside = line((-0.295, -1, 0), (0.205, 1, 0.3))
    assert expanded_views([LINE, beside]) == 0


def test_polyline_across_the_edge_is_left_alone():
    assert expanded_views([line((-1, 0.05, 0.15), (1, -0.05, 0.15))]) == 0


def test_polyline_too_far_away_is_left_alone():
    assert expanded_views([LINE], noise=np.array([6.0, 0.0])) == 0


def test_polyline_that_does_not_triangulate_is_left_alone():
    options = VisibilityOptions(max_error_px=1.0)
    assert expanded_views([LINE], options, noise=np.array([3.0, 0.0])) == 0
    assert expanded_views([LINE], options, noise=np.array([0.5, 0.0])) == 1


def test_view_that_looks_away_sees_nothing():
    views = (*VIEWS, make_view(len(VIEWS), (0, 0, -6), (0, 0, -12)))
    graphs = [graph_of(view, [LINE]) for view in VIEWS]
    chains = index_views(views, [*graphs, graphs[0]])
    edges = on_their_chains(edges_of([LINE], [0, 3, 6]), chains)
    expanded, _ = expand_visibility(edges, chains, OPTIONS, 1)
    assert len(VIEWS) not in expanded.observations.views


def test_expansion_does_not_depend_on_threads():
    rng = np.random.default_rng(0)
    chains = index_views(VIEWS, [graph_of(view, [LINE, HELIX], 0.5, rng) for view in VIEWS])
    edges = on_their_chains(edges_of([LINE, HELIX], [0, 3, 6]), chains)
    one, two = (expand_visibility(edges, chains, OPTIONS, n)[0] for n in (1, 2))
    assert one.points.tobytes() == two.points.tobytes()
    assert one.observations.pixels.tobytes() == two.observations.pixels.tobytes()


def test_no_edges_no_change():
    chains = index_views(VIEWS, [graph_of(view, [LINE]) for view in VIEWS])
    empty = keep_points(edges_of([LINE], [0, 1, 2]), np.zeros(32, bool))
    assert empty.num_edges == 0
    assert expand_visibility(empty, chains, OPTIONS, 1)[0].num_points == 0
    assert filter_outliers(empty, OPTIONS)[0].num_points == 0
    assert sample_edges(empty, chains, SamplingOptions(), 2.0).num_points == 0


@pytest.mark.parametrize(
    ("counts", "expected"), [([], 4), ([3, 3, 3], 4), ([6, 6, 7], 4), ([5, 9, 11], 5.5)]
)
def test_smallest_number_of_views(counts, expected):
    assert min_inlier_views(np.array(counts), 4) == expected


def bright_on_the_other_side(view, curve):
    graph = graph_of(view, [curve])
    return replace(graph, normals=-graph.normals)


def test_polyline_with_its_bright_side_on_the_other_side_is_left_alone():
    graphs = [graph_of(view, [LINE]) for view in VIEWS]
    graphs[1] = bright_on_the_other_side(VIEWS[1], LINE)
    chains = index_views(VIEWS, graphs)
    edges = on_their_chains(edges_of([LINE], [0, 3, 6]), chains)
    expanded, _ = expand_visibility(edges, chains, OPTIONS, 1)
    seen = set(expanded.observations.views.tolist())
    assert seen == set(range(len(VIEWS))) - {1}


def test_edges_that_few_views_see_are_dropped_whole():
    views = [0, 1, 2, 3, 4]
    chains = index_views(VIEWS, [graph_of(view, [LINE, HELIX]) for view in VIEWS])
    edges = on_their_chains(edges_of([LINE, HELIX], views), chains)
    count = int(edges.edge_offsets[1])
    keep = np.ones(len(edges.observations.views), bool)
    few = np.arange(5 * count).reshape(count, 5)[: count // 2 + 1, :2]
    keep[few.ravel()] = False  # three views left for more than half of the line's points
    keep[5 * count : 5 * count + 2] = False  # and for one point of the helix
    keep[5 * count + 30 : 5 * count + 33] = False  # two views left for another one
    thinned = replace(edges, observations=edges.observations.keep(keep))
    kept, stats = filter_outliers(thinned, OPTIONS)
    check(kept)
    assert (stats["edges_before"], stats["edges_after"]) == (2, 2)
    assert kept.edge_offsets.tolist() == [0, 6, edges.num_points - count - 1]
    np.testing.assert_array_equal(kept.points, np.delete(edges.points[count:], 6, axis=0))


def views_after_doubts(edges, chains):
    kept, stats = drop_doubtful_views(edges, chains, OPTIONS)
    assert stats["observations_kept"] == len(kept.observations.views)
    return np.bincount(kept.observations.views, minlength=len(VIEWS))


def test_views_that_see_an_edge_by_chance_are_left_out():
    chains = index_views(VIEWS, [graph_of(view, [LINE]) for view in VIEWS])
    edges = on_their_chains(edges_of([LINE], [0, 1, 2, 3, 4]), chains)
    count = edges.num_points
    np.testing.assert_array_equal(views_after_doubts(edges, chains)[:5], 5 * [count])
    # View 1 observes two points in a row, view 2 a third of them.
    few = np.ones((count, 5), bool)
    few[2:, 1] = False
    few[-(-count // 3) :, 2] = False
    rare = replace(edges, observations=edges.observations.keep(few.ravel()))
    counts = views_after_doubts(rare, chains)
    np.testing.assert_array_equal(counts[:5], [count, 0, -(-count // 3), count, count])


@pytest.mark.parametrize(("offset_px", "stays"), [(0.3, True), (1.0, False)])
def test_views_whose_chains_run_beside_an_edge_are_left_out(offset_px, stays):
    graphs = [graph_of(view, [LINE]) for view in VIEWS]
    edges = on_their_chains(edges_of([LINE], [0, 1, 2, 3, 4]), index_views(VIEWS, graphs))
    moved = replace(graphs[1], undistorted=graphs[1].undistorted + offset_px * graphs[1].normals)
    chains = index_views(VIEWS, [graphs[0], moved, *graphs[2:]])
    observed = edges.observations
    rows = observed.views == 1
    pixels = observed.pixels.copy()
    pixels[rows] += offset_px * observed.normals[rows]
    beside = replace(edges, observations=replace(observed, pixels=pixels))
    counts = views_after_doubts(beside, chains)
    assert counts[1] == (edges.num_points if stays else 0)
    assert (counts[[0, 2, 3, 4]] == edges.num_points).all()


@given(arrays(bool, 24), st.booleans())
def test_kept_pieces_are_runs_of_neighbours(keep, closed):
    ring = circle((0, 0, 0), 0.5)
    edges = replace(edges_of([ring], [0, 1, 2], 160), closed=np.array([closed]))
    keep = np.resize(keep, edges.num_points)
    kept = keep_points(edges, keep)
    check(kept)
    index = {tuple(p): i for i, p in enumerate(edges.points)}
    survivors = set()
    for begin, end in zip(kept.edge_offsets[:-1], kept.edge_offsets[1:], strict=True):
        piece = [index[tuple(p)] for p in kept.points[begin:end]]
        assert len(piece) >= 2
        steps = np.diff(piece)
        assert np.all((steps == 1) | (closed & (steps == 1 - edges.num_points)))
        survivors |= set(piece)
    _, after = edge_neighbours(edges)
    for i in np.flatnonzero(keep):
        if after[i] >= 0 and keep[after[i]]:
            assert {i, int(after[i])} <= survivors
    assert survivors <= set(np.flatnonzero(keep).tolist())
    assert kept.closed.tolist() == ([True] if closed and keep.all() else [False] * kept.num_edges)


def test_fine_samples_follow_the_curve_and_not_the_chord():
    rings = [circle((0.1, 0, 0), 0.8), HELIX]
    chains = index_views(VIEWS, [graph_of(view, rings) for view in VIEWS])
    edges = on_their_chains(edges_of(rings, [0, 1, 3, 5], 120), chains)
    sampled = sample_edges(edges, chains, SamplingOptions(spacing_px=2.0), 2.0)
    check(sampled)
    chord_error = 0.8 * (1 - np.cos(np.pi * 120 / 4000))
    distances = distances_to_curves(sampled.points, rings)
    assert np.median(distances) < chord_error / 4
    assert sampled.closed.tolist() == [True, False]
    assert sampled.num_points > 4 * edges.num_points
    # Points given stay where they are, in their order.
    place = [np.flatnonzero((sampled.points == p).all(axis=1))[0] for p in edges.points]
    assert (np.diff(place) > 0).all()
    steps = []
    for index, view in enumerate(VIEWS):
        if index not in (0, 1, 3, 5):
            continue
        pixels = view.project_undistorted(sampled.points)[0]
        step = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
        step = np.delete(step, sampled.edge_offsets[1:-1] - 1)
        steps.append(np.percentile(step, 95))
    assert max(steps) < 2.5


def test_expansion_of_unseen_noise_keeps_error_small():
    rng = np.random.default_rng(4)
    chains = index_views(VIEWS, [graph_of(view, [LINE], 1.0, rng) for view in VIEWS])
    edges = on_their_chains(edges_of([LINE], [0, 3, 6]), chains, 6.0)
    expanded, _ = expand_visibility(edges, chains, OPTIONS, 1)
    check(expanded)
    for index, view in enumerate(VIEWS):
        rows = expanded.observations.views == index
        ids = np.repeat(np.arange(expanded.num_points), np.diff(expanded.observations.offsets))[
            rows
        ]
        projected = view.project(expanded.points[ids])[0]
        errors = np.linalg.norm(projected - expanded.observations.pixels[rows], axis=1)
        assert errors.max(initial=0) <= OPTIONS.max_error_px + 1e-6
