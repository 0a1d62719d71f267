"""Edge indexes and places on their chains against plain numpy."""

import numpy as np
import pytest
from random_chains import edge_index, random_chains, tangents_of

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]


@pytest.mark.parametrize("seed", range(4))
def test_chain_points_are_linear_between_points_and_wrap(seed):
    rng = np.random.default_rng(seed)
    points, normals, offsets, closed = random_chains(rng)
    view = edge_index(points, normals, offsets, closed)
    positions = np.concatenate([np.arange(len(points)), rng.uniform(0, len(points), 500)])
    at, tangents = _kernels.chain_points(view, positions)
    low = positions.astype(int)
    expected = np.empty_like(at)
    for row, i in enumerate(low):
        p = np.searchsorted(offsets, i, side="right") - 1
        last = i == offsets[p + 1] - 1
        following = i + 1 if not last else (offsets[p] if closed[p] else i)
        expected[row] = points[i] + (positions[row] - i) * (points[following] - points[i])
    np.testing.assert_allclose(at, expected, atol=1e-12)
    np.testing.assert_allclose(tangents, tangents_of(points, offsets, closed)[low], atol=1e-7)


@pytest.mark.parametrize("position", [-0.1, 5.0, np.nan, np.inf])
def test_positions_off_the_chains_are_refused(position):
    points = np.column_stack([np.arange(5.0), np.zeros(5)])
    view = edge_index(points, np.zeros((5, 2)), np.array([0, 5]), np.zeros(1, bool))
    with pytest.raises(ValueError, match="not on a chain"):
        _kernels.chain_points(view, np.array([position]))


@pytest.mark.parametrize(
    "change",
    [
        {"offsets": np.array([0, 4])},
        {"offsets": np.array([0, 6])},
        {"offsets": np.array([1, 5])},
        {"offsets": np.array([0, 7, 5]), "closed": np.zeros(2, bool)},
        {"offsets": np.array([0, 2, 5])},
        {"normals": np.zeros((4, 2))},
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(change):
    arrays = {
        "points": np.zeros((5, 2)),
        "normals": np.zeros((5, 2)),
        "offsets": np.array([0, 5]),
        "closed": np.zeros(1, bool),
    }
    edge_index(**arrays)
    with pytest.raises(ValueError, match="fit together"):
        edge_index(**{**arrays, **change})


def test_bad_focal_lengths_and_points_are_refused():
    one = np.zeros((1, 2)), np.zeros((1, 2)), np.array([0, 1]), np.zeros(1, bool)
    with pytest.raises(ValueError, match="focal"):
        edge_index(*one, focal=0)
    with pytest.raises(ValueError, match="finite"):
        edge_index(np.full((1, 2), np.nan), *one[1:])
