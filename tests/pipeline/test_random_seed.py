"""One random seed reaches every random number generator."""

import ast
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import colmap_edges
from colmap_edges.kernels import _kernels
from colmap_edges.options import PipelineOptions, TracingOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run

PACKAGE = Path(colmap_edges.__file__).parent
SEEDED = ("default_rng", "louvain_communities", "sample_surface", "set_random_seed")


def random_calls():
    """Calls of the package that make something random: where, the name, the arguments."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func)
                if name.endswith(SEEDED) or re.fullmatch(r"(np\.|numpy\.)?random\.\w+", name):
                    given = [*node.args, *(word.value for word in node.keywords)]
                    yield path.relative_to(PACKAGE), name, [ast.unparse(each) for each in given]


def test_generators_are_made_of_the_seed_that_is_given():
    found = [call for call in random_calls() if call[0].parts[0] != "evaluation"]
    assert len(found) >= 5
    for path, name, given in found:
        if name != "random.integers":  # of a generator that is called so
            assert name.endswith(SEEDED), path
            assert {"random_seed", "self.random_seed"} & {*given}, (path, name)


@pytest.mark.parametrize("method", ["chains", "paper"])
def test_a_run_makes_them_all_of_its_seed(small, tmp_path, monkeypatch, method):
    seeds = []
    make, divide = np.random.default_rng, _kernels.louvain_communities

    def made(seed=None):
        if sys._getframe(1).f_globals["__name__"].startswith("colmap_edges."):  # no library's own
            seeds.append(seed)
        return make(seed)

    def divided(*arguments):
        seeds.append(arguments[-1])
        return divide(*arguments)

    monkeypatch.setattr(np.random, "default_rng", made)
    monkeypatch.setattr(_kernels, "louvain_communities", divided)
    paths = Paths(image_path=small[0], input_path=small[1], output_path=tmp_path / "out")
    tracing = TracingOptions(method=method)
    run("mesh", paths, PipelineOptions(random_seed=7, num_threads=1, tracing=tracing, report=False))
    assert len(seeds) >= 1
    assert set(seeds) == {7}
