"""Corners of chains are found at corners and not on bends; chains end there."""

import itertools
from dataclasses import replace

import chains as known_chains
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges2d import corners
from colmap_edges.edges2d.corners import cut_at_corners, find_corners
from colmap_edges.edges2d.detection import Chains, detect_chains
from colmap_edges.edges2d.edge_graph import join_chains
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import DetectionOptions


def make_chains(*parts):
    """Chains of (N, 2) points, normals to the left of their direction, sides that differ."""
    chains = known_chains.make_chains(*((points, 1) for points in parts))
    numbers = np.arange(len(chains.points), dtype=np.uint8)
    return replace(chains, sides=np.tile(numbers[:, None], 2))


def path(*vertices):
    """Points 1 px apart along straight lines between vertices; the last vertex is left out."""
    parts = []
    for a, b in itertools.pairwise(vertices):
        a, b = np.array(a, float), np.array(b, float)
        count = round(np.linalg.norm(b - a))
        parts.append(a + np.arange(count)[:, None] / count * (b - a))
    return np.concatenate(parts)


def rounded(points, sigma=1.5, closed=False):
    """The points as blur leaves a chain: cut short at corners."""
    kernel = cv2.getGaussianKernel(11, sigma).ravel()
    how = {"mode": "wrap"} if closed else {"mode": "reflect", "reflect_type": "odd"}
    padded = np.pad(points, ((5, 5), (0, 0)), **how)
    return np.column_stack([np.convolve(padded[:, k], kernel, "valid") for k in range(2)])


def arc(radius, sweep, center=(200.0, 200.0)):
    """Points about 1 px apart on an arc of `sweep` radians."""
    angles = np.linspace(0, sweep, round(radius * abs(sweep)) + 1)
    return np.array(center) + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def cut_open(chains, min_angle_deg=45.0):
    return cut_at_corners(chains, np.zeros(len(chains.offsets) - 1, bool), min_angle_deg)


@pytest.mark.parametrize("turn_deg", [50, 70, 90, 120, 140])
def test_both_pieces_lead_straight_to_the_corner_and_share_it(turn_deg):
    angle = np.radians(turn_deg)
    corner = np.array([140.0, 50.0])
    end = corner + 40 * np.array([np.cos(angle), np.sin(angle)])
    pieces, closed = cut_open(make_chains(rounded(path((100, 50), corner, end))))
    assert len(closed) == 2 and not closed.any()
    first, second = np.split(np.arange(len(pieces.points)), pieces.offsets[1:-1])
    np.testing.assert_allclose(pieces.points[first[-1]], corner, atol=0.1)
    np.testing.assert_array_equal(pieces.points[first[-1]], pieces.points[second[0]])
    np.testing.assert_allclose(pieces.points[first][:, 1], 50, atol=0.1)
    across = np.array([-np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose((pieces.points[second] - corner) @ across, 0, atol=0.1)
    for piece, normal in ((first, (0, 1)), (second, across)):
        assert (pieces.normals[piece] @ normal > 0.99).all()
        steps = np.linalg.norm(np.diff(pieces.points[piece], axis=0), axis=1)
        assert steps.max() < 1.8


def test_chains_far_from_corners_are_unchanged():
    chains = make_chains(
        rounded(path((100, 50), (140, 50), (140, 90))), arc(60, 2.0), path((20, 20), (60, 40))
    )
    pieces, closed = cut_open(chains)
    assert len(closed) == 4
    np.testing.assert_array_equal(pieces.points[:35], chains.points[:35])
    np.testing.assert_array_equal(pieces.sides[:35], chains.sides[:35])
    rest = chains.offsets[1]
    np.testing.assert_array_equal(pieces.points[pieces.offsets[2] :], chains.points[rest:])


@pytest.mark.parametrize("radius", [5, 6, 7, 8, 10, 12, 15, 20, 30, 50])
@pytest.mark.parametrize("closed", [False, True])
def test_bends_are_no_corners(radius, closed):
    turn = np.linspace(0, 2 * np.pi, round(2 * np.pi * radius), endpoint=False)
    circle = 200 + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    chains = make_chains(circle)
    pieces, still = cut_at_corners(chains, np.array([closed]), 45.0)
    assert pieces is chains
    assert still.tolist() == [closed]


def test_turns_below_the_limit_are_no_corners():
    chains = make_chains(rounded(path((100, 50), (140, 50), (180, 90))))  # 45 degrees
    assert len(cut_open(chains, 40.0)[1]) == 2
    assert len(cut_open(chains, 50.0)[1]) == 1
    assert len(cut_open(chains, 180.0)[1]) == 1


@pytest.mark.parametrize("start", [0, 1, 3, 20, 39, 45, 77, 100, 159])
def test_closed_chains_are_cut_alike_wherever_they_begin(start):
    square = rounded(path((50, 50), (90, 50), (90, 90), (50, 90), (50, 50)), closed=True)
    chains = make_chains(np.roll(square, -start, axis=0))
    pieces, closed = cut_at_corners(chains, np.array([True]), 45.0)
    assert len(closed) == 4 and not closed.any()
    ends = pieces.points[np.column_stack([pieces.offsets[:-1], pieces.offsets[1:] - 1])]
    np.testing.assert_array_equal(ends[:, 1], np.roll(ends[:, 0], -1, axis=0))
    found = sorted(map(tuple, np.round(ends[:, 0]).astype(int).tolist()))
    assert found == [(50, 50), (50, 90), (90, 50), (90, 90)]
    np.testing.assert_allclose(ends[:, 0], np.round(ends[:, 0]), atol=0.1)
    assert len(pieces.points) == len(square) + 4


def test_closed_chain_with_one_corner_begins_and_ends_there():
    """A drop: three quarters of a circle and the two tangents that meet."""
    r = 30.0
    circle = arc(r, -1.5 * np.pi) - 200  # from (r, 0) over (0, -r) to (0, r)
    drop = np.concatenate([circle, path((0, r), (r, r), (r, 0))])
    chains = make_chains(rounded(drop, closed=True) + 100)
    pieces, closed = cut_at_corners(chains, np.array([True]), 45.0)
    assert closed.tolist() == [False]
    np.testing.assert_allclose(pieces.points[[0, -1]], [[130, 130]] * 2, atol=0.15)


def test_corners_of_a_blurred_image_are_found_to_a_fraction_of_a_pixel():
    vertices = np.array([[40.3, 30.2], [120.6, 44.7], [131.2, 120.4], [60.9, 131.5]])
    fine = np.full((180 * 8, 180 * 8), 60, np.uint8)
    cv2.fillPoly(fine, [np.round(vertices * 8 - 0.5).astype(np.int32)], 180)
    image = cv2.GaussianBlur(
        cv2.resize(fine, (180, 180), interpolation=cv2.INTER_AREA), (0, 0), 0.7
    )
    chains, closed = join_chains(detect_chains(image, DetectionOptions()), 4.0, 30.0)
    found, crossings = find_corners(chains, closed, 45.0)
    away = np.linalg.norm(crossings[:, None] - vertices, axis=2)
    assert sorted(away.argmin(axis=1).tolist()) == [0, 1, 2, 3]
    assert away.min(axis=1).max() < 0.4
    before = np.linalg.norm(chains.points[found][:, None] - vertices, axis=2).min(axis=1)
    assert before.min() > 0.8  # how far the chain passes from them


@pytest.mark.parametrize("lengths", [(), (1,), (2, 3), (17, 1, 16), (5,) * 4])
@pytest.mark.parametrize("closed", [False, True])
def test_chains_too_short_for_corners_are_left_alone(lengths, closed):
    random = np.random.default_rng(0)
    parts = [random.uniform(0, 4, (n, 2)) + 50 for n in lengths]
    points = np.concatenate([np.zeros((0, 2)), *parts])
    chains = Chains(
        points=points,
        normals=points,
        sides=np.zeros((len(points), 2), np.uint8),
        offsets=offsets_of(np.array(lengths, np.int64)),
    )
    pieces, still = cut_at_corners(chains, np.full(len(lengths), closed), 45.0)
    assert len(pieces.points) >= len(points)
    assert len(still) >= len(lengths)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_point_of_random_walks_is_lost(seed):
    """Every point is in a piece, corners in two; chains without corners stay closed."""
    random = np.random.default_rng(seed)
    parts = []
    for _ in range(4):
        heading = np.cumsum(random.choice([0, 0, 0, 0, 0, 0, 0.2, -0.2, 1.5, -1.5], 80))
        parts.append(np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0))
    chains = make_chains(*parts)
    closed = random.random(4) < 0.5
    found, _ = find_corners(chains, closed, 45.0)
    pieces, still = cut_at_corners(chains, closed, 45.0)
    assert len(pieces.points) == len(chains.points) + len(found)
    per_chain = np.bincount(np.searchsorted(chains.offsets, found, "right") - 1, minlength=4)
    expected = np.where(closed, np.maximum(per_chain, 1), per_chain + 1)
    assert len(still) == expected.sum()
    assert still.sum() == (closed & (per_chain == 0)).sum()
    assert (np.diff(found) > 0).all()


def line_through(points):
    """Mean, forward unit direction and scatter of the least-squares line."""
    center = points.mean(axis=0)
    _, values, axes = np.linalg.svd(points - center)
    direction = axes[0] * np.where(axes[0] @ (points[-1] - points[0]) < 0, -1, 1)
    return center, direction, values[1] / np.sqrt(len(points))


def corner_at(points, min_angle_deg):
    """Where lines cross, and how far from the point in the middle of 17, if there is a corner."""
    before, here, after = points[:6], points[8], points[11:]
    chords = before[-1] - before[0], after[-1] - after[0]
    norms = np.linalg.norm(chords[0]) * np.linalg.norm(chords[1])
    if chords[0] @ chords[1] > np.cos(np.radians(min_angle_deg - corners.NOISE_DEG)) * norms:
        return None
    (a, u, scatter_a), (b, v, scatter_b) = line_through(before), line_through(after)
    if u @ v > np.cos(np.radians(min_angle_deg)) or max(scatter_a, scatter_b) > 0.35:
        return None
    crossing = a + np.linalg.solve(np.column_stack([u, -v]), b - a)[0] * u
    distance = np.linalg.norm(crossing - here)
    opened = 1 / np.sqrt(max((1 + u @ v) / 2, 1e-6)) - 1
    onward = (crossing - before[-1]) @ u > 0 and (after[0] - crossing) @ v > 0
    return (distance, crossing) if distance <= min(0.5 + 4 * opened, 5) and onward else None


def corners_of_chain(points, closed, min_angle_deg):
    """Corners of one chain, point by point, the nearest to it first; 6 points stay free around."""
    count = len(points)
    if count <= 16:
        return []
    found = []
    for i in range(count) if closed else range(8, count - 8):
        corner = corner_at(points[np.arange(i - 8, i + 9) % count], min_angle_deg)
        if corner is not None:
            found.append((corner[0], i, corner[1]))
    kept = []
    for _, i, crossing in sorted(found, key=lambda corner: corner[0]):
        gaps = [abs(i - j) for j, _ in kept]
        if all((min(gap, count - gap) if closed else gap) > 6 for gap in gaps):
            kept.append((i, crossing))
    return sorted(kept, key=lambda corner: corner[0])


@pytest.mark.parametrize("seed", range(20))
def test_kernel_finds_the_corners_that_a_search_by_hand_finds(seed):
    random = np.random.default_rng(seed)
    parts = []
    for length in random.integers(3, 120, 15):
        heading = np.cumsum(random.choice([0, 0, 0, 0, 0.1, -0.1, 0.9, -0.9, 1.5], length))
        steps = np.column_stack([np.cos(heading), np.sin(heading)])
        parts.append(np.cumsum(steps + random.normal(0, 0.05, steps.shape), axis=0))
    closed = random.random(15) < 0.5
    chains = make_chains(*parts)
    found, crossings = find_corners(chains, closed, 45.0)
    expected = [
        (first + i, crossing)
        for first, part, loop in zip(chains.offsets, parts, closed, strict=False)
        for i, crossing in corners_of_chain(part, loop, 45.0)
    ]
    assert len(expected) > 0
    assert found.tolist() == [i for i, _ in expected]
    np.testing.assert_allclose(crossings, [crossing for _, crossing in expected], atol=1e-6)


def test_kernel_refuses_inconsistent_arrays():
    limits = (3, 6, 0.8, 0.7, 0.35, 0.5, 4.0, 5.0)
    with pytest.raises(ValueError, match="offsets"):
        _kernels.find_corners(np.zeros((3, 2)), np.array([0, 4]), np.zeros(1, bool), *limits)
    with pytest.raises(ValueError, match="as many chains"):
        _kernels.find_corners(np.zeros((3, 2)), np.array([0, 3]), np.zeros(2, bool), *limits)
    with pytest.raises(ValueError, match="too short"):
        _kernels.find_corners(np.zeros((3, 2)), np.array([0, 3]), np.zeros(1, bool), 0, *limits[1:])
