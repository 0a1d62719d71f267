"""Marks and faint lines are those of plain numpy."""

from itertools import pairwise

import numpy as np
import pytest

from colmap_edges.kernels import _kernels

CELL, FOCAL, PRINCIPAL = 4, 40.0, np.array([24.0, 16.0])
ANGLES, WIDTH, PLACES, TURN, STEP = 120, 2.0, 4000, 0.08, 3.0
LEAST = (60, 3, 8)  # marks, views, stretches


def expected_marks(smooth, labels, normals, offsets, min_slope):
    """Pixel by pixel, for a camera at the origin that looks along z."""
    gy, gx = np.gradient(smooth)
    sizes, found = np.hypot(gx, gy), []
    for y in range(2, smooth.shape[0] - 2):
        for x in range(2, smooth.shape[1] - 2):
            plane = labels[y // CELL, x // CELL]
            if plane < 0 or sizes[y, x] <= min_slope:
                continue
            unit = np.array([gx[y, x], gy[y, x]]) / sizes[y, x]
            right, down = np.rint(unit / np.abs(unit).max()).astype(int)
            if sizes[y, x] < sizes[y + down, x + right]:
                continue
            if sizes[y, x] <= sizes[y - down, x - right]:
                continue
            pixels = np.array([x, y]) + 0.5 + np.array([[0, 0], [-unit[1], unit[0]]])
            rays = np.column_stack([(pixels - PRINCIPAL) / FOCAL, np.ones(2)])
            here, there = rays * (offsets[plane] / (rays @ normals[plane]))[:, None]
            length = np.linalg.norm(there - here)
            found.append((*here, *((there - here) / length), plane))
    return np.array(found)


def test_marks_lie_where_gray_changes_most():
    rng = np.random.default_rng(0)
    smooth = 100 * rng.random((32, 48))
    labels = np.repeat([[-1, 0, 1, 1]], 8, axis=0).repeat(3, axis=1).astype(np.int32)
    normals = np.array([[0, 0, 1.0], [0.6, 0, 0.8]])
    offsets = np.array([2.0, 5.0])
    points, directions, sizes, planes = _kernels.marks_of(
        np.eye(3), np.zeros(3), FOCAL, PRINCIPAL, smooth, labels, normals, offsets, 10.0
    )
    expected = expected_marks(smooth, labels, normals, offsets, 10.0)
    assert len(expected) > 50
    assert points == pytest.approx(expected[:, :3], abs=1e-9)
    assert directions == pytest.approx(expected[:, 3:6], abs=1e-9)
    assert planes.tolist() == expected[:, 6].tolist()
    assert sizes == pytest.approx(np.linalg.norm(points, axis=1) / FOCAL)


def random_marks(rng):
    """Marks on three lines of a plane, seen by several views, among others."""
    at, along = [rng.uniform(-40, 40, (400, 2))], [rng.normal(size=(400, 2))]
    for angle, place in ((0.3, 10.0), (1.9, -5.0), (2.9, 22.0)):
        direction = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-direction[1], direction[0]])
        count = int(rng.integers(150, 400))
        where = rng.uniform(-35, 35, count)
        at.append(np.outer(where, direction) + np.outer(place + rng.normal(size=count), normal))
        along.append(np.where(rng.random((count, 1)) < 0.5, -1, 1) * direction)
        along[-1] = along[-1] + 0.03 * rng.normal(size=(count, 2))
    at, along = np.concatenate(at), np.concatenate(along)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return at, along, rng.integers(0, 6, len(at))


def fitted(at, along, views, free, angle, place):
    """Members of a line, and their stretches; none where too few views agree."""
    for _ in range(2):
        direction = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-direction[1], direction[0]])
        near = free & (np.abs(at @ normal - place) < WIDTH) & (np.abs(along @ normal) < TURN)
        members = np.flatnonzero(near)
        if len(members) < LEAST[0]:
            return members[:0], members[:0]
        middle = at[members].mean(axis=0)
        off = at[members] - middle
        direction = np.linalg.eigh(off.T @ off)[1][:, 1]
        if (direction[0], direction[1]) < (0, 0):
            direction = -direction  # as the kernel's, from -90 to 90 degrees
        angle = np.arctan2(direction[1], direction[0])
        place = middle @ [-direction[1], direction[0]]
    steps = np.floor(at[members] @ direction / STEP).astype(int)
    seen = {step: len(set(views[members[steps == step]])) for step in steps}
    enough = np.array([seen[step] >= LEAST[1] for step in steps])
    if len(set(steps[enough])) < LEAST[2]:
        return members[:0], members[:0]
    return members[enough], steps[enough]


def expected_lines(at, along, views):
    """Tries all angles and places in the order of their votes."""
    angles = np.arctan2(along[:, 1], along[:, 0]) % np.pi
    across = np.cos(angles) * at[:, 1] - np.sin(angles) * at[:, 0]
    low = np.median(across) - PLACES / 2 * WIDTH
    columns = np.floor((across - low) / WIDTH).astype(int)
    rows = np.minimum((angles / np.pi * ANGLES).astype(int), ANGLES - 1)
    votes = np.zeros((ANGLES + 2, PLACES + 2), int)
    for row, column in zip(rows, columns, strict=True):
        votes[row : row + 3, column : column + 3] += 1
    votes = votes[1:-1, 1:-1]
    peaks = np.argwhere(votes >= LEAST[0])
    peaks = peaks[np.argsort(-votes[tuple(peaks.T)], kind="stable")]
    free, lines = np.ones(len(at), bool), []
    for row, column in peaks:
        angle, place = (row + 0.5) / ANGLES * np.pi, low + (column + 0.5) * WIDTH
        members, steps = fitted(at, along, views, free, angle, place)
        if len(members):
            free[members] = False
            lines.append(dict(zip(members.tolist(), steps.tolist(), strict=True)))
    return lines


@pytest.mark.parametrize("seed", range(6))
def test_lines_are_those_of_trying_all(seed):
    at, along, views = random_marks(np.random.default_rng(seed))
    offsets, marks, steps = _kernels.faint_lines(
        at, along, views, 1.0, ANGLES, WIDTH, PLACES, TURN, np.array(LEAST), STEP, 1000
    )
    lines = [
        dict(zip(marks[a:b].tolist(), steps[a:b].tolist(), strict=True))
        for a, b in pairwise(offsets)
    ]
    assert len(lines) >= 3
    assert lines == expected_lines(at, along, views)


def test_no_line_on_which_few_views_agree():
    at, along, views = random_marks(np.random.default_rng(0))
    offsets, marks, _ = _kernels.faint_lines(
        at, along, views % 2, 1.0, ANGLES, WIDTH, PLACES, TURN, np.array(LEAST), STEP, 1000
    )
    assert offsets.tolist() == [0]
    assert len(marks) == 0
