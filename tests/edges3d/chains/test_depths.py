from types import SimpleNamespace

import numpy as np
import pytest

from colmap_edges.core.arrays import offsets_of
from colmap_edges.edges3d.chains.depths import sample_chains


def samples_on(*lengths, step=24):
    """Places on each polyline of so many points."""
    graph = SimpleNamespace(polyline_offsets=offsets_of(np.array(lengths, np.int64)))
    samples, offsets = sample_chains(graph, step)
    starts = np.repeat(graph.polyline_offsets[:-1], np.diff(offsets))
    return [s.tolist() for s in np.split(samples - starts, offsets[1:-1])]


@pytest.mark.parametrize(
    ("length", "places"),
    [
        (1, [0]),
        (2, [1]),
        (8, [4]),  # no room for two
        (9, [0, 8]),
        (13, [2, 10]),  # at least 8 px apart, if need be nearer to the ends
        (20, [5, 14]),
        (21, [6, 14]),
        (37, [6, 30]),
        (61, [6, 30, 54]),
        (62, [6, 22, 39, 55]),  # else more than 24 px apart
    ],
)
def test_places_of_samples(length, places):
    assert samples_on(length) == [places]


def test_samples_of_many_polylines():
    assert samples_on(40, 5, 21) == [[6, 20, 33], [2], [6, 14]]
    assert samples_on(100, step=8) == [[6, 14, 22, 30, 38, 46, 53, 61, 69, 77, 85, 93]]
    assert samples_on() == [[]]
