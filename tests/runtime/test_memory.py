"""Reuse of freed memory for large arrays, and its return to the system."""

import subprocess
import sys

import pytest

from colmap_edges.runtime import memory

# Prints megabytes that live after 100 MB were used and freed, and after they were given back.
PROGRAM = """
import sys
from pathlib import Path
import numpy as np
from colmap_edges.runtime.memory import return_freed_memory, reuse_freed_memory

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

if sys.argv[1] == "reuse":
    reuse_freed_memory()
begin = resident()
arrays = [np.ones(5_000_000 // 8) for _ in range(20)]
used = resident() - begin
del arrays
freed = resident() - begin
return_freed_memory()
print(used, freed, resident() - begin)
"""


def megabytes(mode: str) -> list[float]:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, mode], capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


@pytest.mark.skipif(
    memory.c_function("mallopt") is None or not sys.platform.startswith("linux"),
    reason="the C library cannot be told what to do with freed memory",
)
def test_freed_memory_is_kept_until_it_is_returned():
    used, freed, returned = megabytes("reuse")
    assert used > 95
    assert freed > 0.9 * used
    assert returned < 0.1 * used
    used, freed, _ = megabytes("plain")
    assert freed < 0.1 * used


def test_functions_of_the_c_library():
    assert memory.c_function("abs")(-3) == 3
    assert memory.c_function("no_such_function_of_c") is None


def test_other_c_libraries_are_left_alone(monkeypatch):
    asked = []
    monkeypatch.setattr(memory, "c_function", lambda name: asked.append(name))
    memory.reuse_freed_memory()
    memory.return_freed_memory()
    assert asked == ["mallopt", "malloc_trim"]
