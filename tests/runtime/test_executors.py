"""Thread pools: results in order, bounded queues, and a stop at the first error."""

import threading
import time
from concurrent.futures import Future

import pytest

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.executors import local_workers, run_all, stop


def calls_of(function, count):
    return [(function, (index,)) for index in range(count)]


def test_first_error_in_threads_stops_the_rest():
    begun = []

    def work(index):
        begun.append(index)
        if index == 1:
            raise ColmapEdgesError("one")
        time.sleep(0.02)

    with local_workers(2) as workers, pytest.raises(ColmapEdgesError, match="one"):
        run_all(workers.images, calls_of(work, 200))
    assert len(begun) < 100


def test_cancelled_calls_are_not_waited_for():
    """The executor of a cluster may never tell that one was cancelled."""
    stop([Future()])


def test_threads_bound_the_images_at_once():
    at_once, most, lock = 0, 0, threading.Lock()

    def work(index):
        nonlocal at_once, most
        with lock:
            at_once += 1
            most = max(most, at_once)
        time.sleep(0.005)
        with lock:
            at_once -= 1
        return index

    told = []
    with local_workers(3) as workers:
        done = run_all(workers.images, calls_of(work, 30), lambda: told.append(1))
    assert done == list(range(30))
    assert most <= 3
    assert len(told) == 30
