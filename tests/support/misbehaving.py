"""Readers that do what no reader may, by which the watcher is tested."""

import os
import time

CLEAR_ERRORS = (ValueError,)


def complain(folder):
    raise ValueError("one line\nand another")


READERS = {
    "crash": lambda folder: os.abort(),
    "hang": lambda folder: time.sleep(60),
    "memory": lambda folder: bytearray(3 * 2**30),
    "traceback": lambda folder: [][1],
    "many lines": complain,
    "well": lambda folder: None,
}


def warm_up(kind, source):
    """Nothing is to be loaded."""
