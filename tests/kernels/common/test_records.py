import struct

import numpy as np
import pytest

from colmap_edges.kernels import _kernels


def walk(data, first=0, num_records=3, head_size=12, element_size=4):
    return _kernels.walk_records(
        np.frombuffer(data, np.uint8), first, num_records, head_size, element_size
    )


def records(counts):
    return b"".join(b"head" + struct.pack("<Q", n) + bytes(4 * n) for n in counts)


def test_records_are_where_those_before_them_end():
    rng = np.random.default_rng(0)
    expected = rng.integers(0, 9, 500)
    starts, counts, end = walk(b"xx" + records(expected), 2, 500)
    np.testing.assert_array_equal(counts, expected)
    np.testing.assert_array_equal(starts, 2 + np.cumsum([0, *(12 + 4 * expected)])[:-1])
    assert end == 2 + (12 + 4 * expected).sum()


@pytest.mark.parametrize("missing", [1, 5, 20])
def test_data_that_end_within_a_record(missing):
    data = records([1, 0, 3])
    assert walk(data)[2] == len(data)
    assert walk(data[:-missing])[2] == len(data) - missing + 1
    assert walk(data + bytes(7))[2] == len(data)


def test_counts_beyond_all_data():
    data = b"head" + struct.pack("<Q", 2**64 - 1) + bytes(40)
    assert walk(data, 0, 1)[2] == len(data) + 1
    assert walk(data, 0, 2**64 - 1)[2] == len(data) + 1
    with pytest.raises(ValueError, match="first record"):
        walk(data, len(data) + 1)
    with pytest.raises(ValueError, match="heads"):
        walk(data, 0, 1, 4)


@pytest.mark.parametrize(
    ("track", "fault"),
    [
        ([], 0),
        ([(3, 0), (8, 4)], 0),
        ([(3, 0), (4, 0)], 1),
        ([(9, 0)], 1),
        ([(8, 5), (3, 0)], 2),
        ([(3, 2**32 - 1)], 2),
    ],
)
def test_tracks_of_unknown_images_and_points(track, fault):
    good = struct.pack("<QII", 1, 8, 0)
    data = good + struct.pack(f"<Q{2 * len(track)}I", len(track), *sum(track, ()))
    every = np.frombuffer(data, np.uint8)
    starts, counts = np.array([0, 16]), np.array([1, len(track)])
    ids, num_points = np.array([3, 8]), np.array([1, 5])
    assert _kernels.check_tracks(every, starts, counts, 8, ids, num_points) == fault
    with pytest.raises(ValueError, match="outside"):
        _kernels.check_tracks(every, starts, counts + 1, 8, ids, num_points)
