import itertools

import curves as known
import numpy as np
import pycolmap
import pytest
from chains import VIEW, build, make_chains, straight, topology
from hypothesis import given, settings
from hypothesis import strategies as st

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges2d.edge_graph import (
    build_edge_graph,
    drop_chains,
    join_chains,
    keep_polylines,
)
from colmap_edges.edges2d.topology import regular_polylines
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import EdgeGraphOptions


@pytest.mark.parametrize("reverse", [False, True])
def test_halves_of_a_line_are_joined_across_a_small_gap(reverse):
    left, right = straight((100, 50), (140, 55)), straight((143, 55.375), (183, 60.375))
    second = (right[::-1], -1) if reverse else (right, 1)
    graph = build(make_chains((left, 1), second), max_gap_points=4.0)
    assert graph.num_polylines == 1
    assert not graph.closed[0]
    steps = np.diff(graph.points[:, 0])
    assert (steps > 0).all() or (steps < 0).all()
    np.testing.assert_allclose(
        np.sort(graph.points[:, 0]), np.concatenate([left[:, 0], right[:, 0]])
    )
    assert len(topology(graph).smoothed) == 2
    np.testing.assert_allclose(graph.normals, np.tile(graph.normals[0], (len(graph.points), 1)))
    apart = build(make_chains((left, 1), second), max_gap_points=2.5)
    assert apart.num_polylines == 2


def test_halves_with_opposite_bright_sides_stay_apart():
    left, right = straight((100, 50), (140, 50)), straight((143, 50), (183, 50))
    assert build(make_chains((left, 1), (right, -1))).num_polylines == 2
    touching = straight((141, 50), (183, 50))
    assert build(make_chains((left, 1), (touching, -1))).num_polylines == 2


def test_turn_across_a_gap_must_be_small_but_touching_ends_may_turn():
    turn = np.radians(40)
    direction = np.array([np.cos(turn), np.sin(turn)])
    middle = np.array([np.cos(turn / 2), np.sin(turn / 2)])
    left = straight((100, 50), (140, 50))
    for gap, limit, count in ((3.0, 30.0, 2), (3.0, 50.0, 1), (1.5, 30.0, 1)):
        start = left[-1] + gap * middle
        chains = make_chains((left, 1), (straight(start, start + 40 * direction), 1))
        assert build(chains, max_join_angle_deg=limit).num_polylines == count


def test_nearest_of_two_continuations_is_joined():
    left = straight((100, 50), (140, 50))
    near, far = straight((142.5, 50), (180, 50)), straight((143, 51), (180, 51))
    joined, closed = join_chains(make_chains((far, 1), (left, 1), (near, 1)), 4.0, 30.0)
    assert len(closed) == 2
    lengths = sorted(np.diff(joined.offsets).tolist())
    assert lengths == sorted([len(far), len(left) + len(near)])


@pytest.mark.parametrize("pieces", [1, 2, 3])
def test_circle_closes(pieces):
    count = 240
    angle = 2 * np.pi * np.arange(count) / count
    points = np.array([300, 200]) + 40 * np.column_stack([np.cos(angle), np.sin(angle)])
    parts = [(part, 1) for part in np.split(points, pieces)]
    parts[-1] = (parts[-1][0][::-1], -1) if pieces > 1 else parts[-1]
    graph = build(make_chains(*parts))
    assert graph.num_polylines == 1
    assert graph.closed[0]
    nodes = topology(graph).end_nodes
    assert nodes[0, 0] == nodes[0, 1]
    around = np.linalg.norm(graph.points - np.roll(graph.points, 1, axis=0), axis=1)
    assert around.max() < 2


def test_filter_keeps_whole_components_of_the_longest():
    long = straight((50, 50), (250, 50))
    branch = straight((100, 51), (100, 71))  # touches the inside of `long`
    corner = straight((251.5, 51), (251.5, 70))  # meets its end; bright on the other side
    short = [straight((50, y), (70 + y / 10, y)) for y in range(150, 450, 20)]
    parts = [(p, 1) for p in short[:7]] + [(branch, 1), (long, 1), (corner, -1)]
    parts += [(p, 1) for p in short[7:]]
    everything = build(make_chains(*parts))
    assert everything.num_polylines == len(parts)
    options = EdgeGraphOptions(filter_regular_length=True, top_regular_length_ratio=0.05)
    kept, dropped = build_edge_graph(make_chains(*parts), VIEW, options)
    assert kept.num_polylines == 3
    assert len(kept.points) == len(long) + len(branch) + len(corner)
    assert kept.points[:, 1].max() < 75
    assert sorted(dropped.tolist()) == sorted(np.concatenate(short).tolist())
    top = regular_polylines(
        everything.points,
        topology(everything),
        EdgeGraphOptions(top_regular_length_ratio=0.1),
    )
    assert top.sum() == 4  # of 18, the two longest: `long` and a short one


@settings(max_examples=50, deadline=None)
@given(st.lists(st.booleans(), min_size=6, max_size=6))
def test_kept_polylines_are_unchanged(mask):
    bar = straight((50, 100), (150, 100))
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    ring = np.array([300, 200]) + 20 * np.column_stack([np.cos(angle), np.sin(angle)])
    graph = build(
        make_chains(
            (straight((10, 10), (10, 40)), 1),
            (bar, 1),
            (straight((100, 101), (100, 160)), 1),
            (ring, 1),
            (straight((300, 20), (340, 25)), -1),
            (straight((120, 99), (120, 70)), -1),
        )
    )
    assert graph.num_polylines == 6
    assert graph.closed.sum() == 1
    keep = np.array(mask)
    kept = keep_polylines(graph, keep)
    assert kept.num_polylines == keep.sum()
    for new, old in enumerate(np.flatnonzero(keep)):
        a = slice(*kept.polyline_offsets[new : new + 2])
        b = slice(*graph.polyline_offsets[old : old + 2])
        for name in ("points", "undistorted", "normals"):
            np.testing.assert_array_equal(getattr(kept, name)[a], getattr(graph, name)[b])
    np.testing.assert_array_equal(kept.closed, graph.closed[keep])


def test_chains_with_unusable_points_are_dropped_whole():
    parts = [(straight((10, y), (30, y)), 1) for y in (10, 20, 30)]
    chains = make_chains(*parts)
    usable = np.ones(63, bool)
    usable[25] = False
    left, dropped = drop_chains(chains, usable)
    assert left.offsets.tolist() == [0, 21, 42]
    np.testing.assert_array_equal(left.points, np.concatenate([parts[0][0], parts[2][0]]))
    np.testing.assert_array_equal(dropped, parts[1][0])
    assert drop_chains(chains, np.ones(63, bool))[0] is chains


def test_distorted_lines_are_straight_in_undistorted_pixels():
    camera = pycolmap.Camera.create_from_model_name(1, "OPENCV", 500.0, 640, 480)
    camera.params = [500, 510, 322, 238, -0.2, 0.05, 0.002, -0.001]
    view = known.make_view(np.eye(3), np.zeros(3), camera=camera)
    undistorted = straight((-250, -180), (240, -150))
    image = view.image_from_undistorted(undistorted)
    sag = np.abs(cross(image - image[0], image[-1] - image[0])) / np.linalg.norm(
        image[-1] - image[0]
    )
    assert sag.max() > 3
    graph = build(make_chains((image, 1)), view)
    assert graph.num_polylines == 1
    np.testing.assert_array_equal(graph.points, image.astype(np.float32))
    np.testing.assert_allclose(graph.undistorted, undistorted, atol=2e-5)
    direction = (undistorted[-1] - undistorted[0]) / np.linalg.norm(
        undistorted[-1] - undistorted[0]
    )
    np.testing.assert_allclose(np.linalg.norm(graph.normals, axis=1), 1, rtol=1e-6)
    assert cross(direction, graph.normals).min() > 0.98  # across; square only without distortion


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def farthest_split(points, first, last, tolerance):
    """Indices Douglas-Peucker keeps after `first`, by plain recursion."""
    a, b = points[first], points[last]
    dx, dy = b - a
    squared = dx * dx + dy * dy
    worst, split = tolerance * tolerance, None
    for i in range(first + 1, last):
        px, py = points[i]
        t = ((px - a[0]) * dx + (py - a[1]) * dy) / squared if squared > 0 else 0.0
        t = min(max(t, 0.0), 1.0)
        ex, ey = a[0] + t * dx - px, a[1] + t * dy - py
        if ex * ex + ey * ey > worst:
            worst, split = ex * ex + ey * ey, i
    if split is None:
        return [last]
    return farthest_split(points, first, split, tolerance) + farthest_split(
        points, split, last, tolerance
    )


coordinates = st.floats(-50, 50).map(lambda x: round(x, 3))
polylines = st.lists(st.lists(st.tuples(coordinates, coordinates), max_size=25), max_size=4)


@settings(max_examples=150, deadline=None)
@given(polylines, st.sampled_from([0.0, 0.5, 1.0, 7.0, 200.0]))
def test_douglas_peucker_equals_recursion_and_keeps_the_tolerance(parts, tolerance):
    points = np.array([p for part in parts for p in part], float).reshape(-1, 2)
    offsets = offsets_of(np.array([len(part) for part in parts], np.int64))
    kept, kept_offsets = _kernels.douglas_peucker(points, offsets, tolerance)
    assert len(kept_offsets) == len(offsets)
    for p in range(len(parts)):
        first, last = offsets[p], offsets[p + 1] - 1
        own = kept[kept_offsets[p] : kept_offsets[p + 1]].tolist()
        if last < first:
            assert own == []
            continue
        split = farthest_split(points, first, last, tolerance) if last > first else []
        assert own == [first, *split]
        for a, b in itertools.pairwise(own):
            left_out = distances_to_segment(points[a : b + 1], points[a], points[b])
            assert left_out.max() <= tolerance + 1e-9


def distances_to_segment(points, a, b):
    squared = (b - a) @ (b - a)
    t = np.clip((points - a) @ (b - a) / squared, 0, 1) if squared > 0 else np.zeros(len(points))
    return np.linalg.norm(a + t[:, None] * (b - a) - points, axis=1)


@pytest.mark.parametrize("offsets", [[], [0], [0, 4], [1, 5], [0, 3, 2, 5], [0, 6]])
def test_douglas_peucker_refuses_offsets_that_do_not_fit(offsets):
    with pytest.raises(ValueError, match="offsets must"):
        _kernels.douglas_peucker(np.zeros((5, 2)), np.array(offsets, np.int64), 1.0)
