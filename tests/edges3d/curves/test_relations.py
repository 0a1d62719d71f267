"""Relations that the data supports: made exact; others: left alone."""

import numpy as np
import pytest
from curve_edges import arc, edges_of, frame, segment

from colmap_edges.edges3d.curves.fitting import fit_curves


@pytest.fixture(scope="module")
def block():
    """A box's edges, two concentric circles on its top and a slanted line, turned somehow."""
    turn = frame(11)
    corners = np.array([(x, y, z) for x in (0, 2) for y in (0, 3) for z in (0, 1)], float)
    pairs = [(i, i ^ bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    polylines = [segment(corners[i], corners[j], 40) for i, j in pairs]
    center = np.array([1, 1.5, 1])
    for radius in (0.5, 0.8):
        polylines.append(arc(center, np.eye(3), (radius, radius), 0, 354, 80))
    polylines.append(segment((0, 0, 0), (2, 3, 1), 60))
    closed = [False] * 12 + [True, True, False]
    return edges_of([polyline @ turn for polyline in polylines], closed, sigma=2e-3), turn


def test_directions_axes_and_planes_are_shared(block):
    edges, turn = block
    given, curves = fit_curves(edges), fit_curves(edges, regularize=True)
    ways = curves.frames[:12, 1] / np.linalg.norm(curves.frames[:12, 1], axis=1, keepdims=True)
    cosines = np.abs(ways @ ways.T)
    assert np.minimum(cosines, np.abs(1 - cosines)).max() < 1e-9  # parallel or perpendicular
    rough = given.frames[:12, 1] / np.linalg.norm(given.frames[:12, 1], axis=1, keepdims=True)
    cosines = np.abs(rough @ rough.T)
    assert np.minimum(cosines, np.abs(1 - cosines)).max() > 1e-5
    first, second = curves.frames[12:14, 0]
    np.testing.assert_allclose(first, second, atol=1e-9)  # one axis and one plane
    assert np.linalg.norm(given.frames[12, 0] - given.frames[13, 0]) > 1e-5
    normal = curves.normals[12]
    top = [k for k in range(12) if np.allclose(curves.ends()[k] @ turn.T @ (0, 0, 1), 1, atol=0.02)]
    heights = np.concatenate([curves.ends()[k] for k in top]) @ normal
    assert len(top) == 4 and np.ptp(heights) < 1e-9
    assert heights[0] == pytest.approx(float(first @ normal), abs=1e-9)


def test_errors_become_smaller_and_others_stay(block):
    edges, turn = block
    given, curves = fit_curves(edges), fit_curves(edges, regularize=True)
    true = np.abs(np.round(given.frames[:12, 1] @ turn.T))
    true /= np.linalg.norm(true, axis=1, keepdims=True)

    def angles(found):
        ways = found.frames[:12, 1] @ turn.T
        ways = np.abs(ways) / np.linalg.norm(ways, axis=1, keepdims=True)
        return np.arccos(np.minimum((ways * true).sum(axis=1), 1))

    assert angles(curves).mean() < 0.7 * angles(given).mean()
    np.testing.assert_allclose(curves.frames[14], given.frames[14], atol=1e-9)
