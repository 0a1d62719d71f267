"""zlib is loaded before pycolmap, whose own symbols would corrupt memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import colmap_edges

# What Python itself starts with may hold zlib, so that it is told of as not loaded.
START = """
import sys
for name in [name for name in sys.modules if name == "zlib"]:
    del sys.modules[name]
order = []
class Watch:
    def find_spec(self, name, path=None, target=None):
        order.append(name)
sys.meta_path.insert(0, Watch())
"""
COMPRESS = """
import io, numpy as np
for seed in range(4):
    data = io.BytesIO()
    np.savez_compressed(data, a=np.random.default_rng(seed).bytes(1_000_000))
"""
IMPORTS = ("colmap_edges", "colmap_edges.colmap.model", "colmap_edges.evaluation.triangulation")
IMPORTS += ("colmap_edges.evaluation.metrics.poses", "colmap_edges.cli.main")


def child(code):
    package = str(Path(colmap_edges.__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": package},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize("module", IMPORTS)
def test_zlib_comes_before_pycolmap(module):
    code = START + f"import {module}, pycolmap\nprint(*order)" + COMPRESS
    done = child(code)
    assert done.returncode == 0, done.stderr
    order = done.stdout.split()
    assert order.index("zlib") < order.index("pycolmap")


def test_the_watch_sees_the_wrong_order():
    done = child(START + "import pycolmap, zlib\nprint(*order)")
    order = done.stdout.split()
    assert order.index("pycolmap") < order.index("zlib")
