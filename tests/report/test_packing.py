import gzip
import json

import numpy as np
import pytest

from colmap_edges.report.packing import LIFTED, coordinates, pack


def unpacked(data):
    """What page.js reads: the JSON with its arrays."""
    data = gzip.decompress(data)
    length = int.from_bytes(data[:4], "little")
    body = data[4 + length :]

    def revive(node):
        if "dtype" not in node:
            return node
        kind = np.dtype(node["dtype"])
        first, last = node["at"], node["at"] + node["length"] * kind.itemsize
        planes = np.frombuffer(body[first:last], np.uint8).reshape(kind.itemsize, -1)
        values = np.ascontiguousarray(planes.T).view(kind).ravel()
        return values if kind.kind == "f" else np.cumsum(values, dtype=kind)

    return json.loads(data[4 : 4 + length], object_hook=revive)


@pytest.mark.parametrize("dtype", ["f4", "i4", "u2", "u1"])
def test_arrays_come_back_as_they_went(dtype):
    rng = np.random.default_rng(0)
    values = (rng.random(1000) * 255).astype(dtype)
    found = unpacked(pack({"a": [1, {"b": values}], "c": values[:0]}))
    assert found["a"][0] == 1
    np.testing.assert_array_equal(found["a"][1]["b"], values)
    assert len(found["c"]) == 0


def test_coordinates_are_within_half_a_step_and_gaps_stay():
    values = np.random.default_rng(0).normal(1e4, 50, 500)
    values[7] = np.nan
    packed = coordinates(values)
    assert (np.flatnonzero(packed["steps"] == LIFTED) == [7]).all()
    back = packed["low"] + packed["step"] * packed["steps"]
    reach = np.nanmax(values) - np.nanmin(values)
    assert np.abs(np.delete(back - values, 7)).max() <= 0.51 * packed["step"] <= reach / 100_000


@pytest.mark.parametrize("values", [np.zeros(0), np.full(3, 2.5), np.full(2, np.nan)])
def test_coordinates_without_extent(values):
    packed = coordinates(values)
    back = packed["low"] + packed["step"] * packed["steps"][np.isfinite(values)]
    np.testing.assert_array_equal(back, values[np.isfinite(values)])


def test_values_that_are_not_arrays_are_refused():
    with pytest.raises(TypeError, match="set cannot be packed"):
        pack({"a": set()})
