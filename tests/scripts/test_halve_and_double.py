"""Halving and doubling of constants, on a small scene with known edges."""

import re
import shutil

import numpy as np
import pytest
import scenes
from halve_and_double import numbers
from project import run_script

from colmap_edges.declared_options import is_constant

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


@pytest.fixture(scope="module")
def data(small, tmp_path_factory):
    """A folder with one scene."""
    folder = tmp_path_factory.mktemp("data")
    shutil.copytree(small[0], folder / "small" / "images")
    shutil.copytree(small[1], folder / "small" / "sparse")
    points = scenes.make_scene(num_views=6, width=240, height=180).samples
    np.savez(folder / "small" / "curves.npz", points=points, edges=np.zeros((0, 2), np.int32))
    return folder


def test_effects_of_a_constant_are_printed(data):
    arguments = ("--scenes", "small", "--constants", "Refinement.max_tangent_angle_deg")
    lines = run_script("halve_and_double.py", data, *arguments).stdout.splitlines()
    assert lines[0] == "| constant | is | set to | small |"
    before = re.search(r"length ([0-9.e+]+), F ([0-9.]+)", lines[2])
    assert float(before[1]) > 1
    assert 0.5 < float(before[2]) <= 1
    half, double = (line.split("|") for line in lines[3:])
    assert half[1:4] == [" `Refinement.max_tangent_angle_deg` ", " 12 ", " 6 "]
    assert double[3] == " 24 "
    changes = [re.findall(r"(\w+) ([+-][0-9.]+) %", cells[4]) for cells in (half, double)]
    assert [[name for name, _ in found] for found in changes] == [["length", "F"]] * 2
    assert any(float(change) != 0 for found in changes for _, change in found)


def test_every_number_is_changed_within_its_range():
    constants = numbers(with_options=False)
    assert len(constants) > 40
    for constant in constants:
        low, high = constant.entry.metadata["within"]
        assert is_constant(constant.entry)
        values = list(constant.others())
        assert 1 <= len(values) <= 2
        assert all(low <= value <= high and value != constant.entry.default for value in values)
    assert len(numbers(with_options=True)) > len(constants) + 25


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--scenes", "none"), "holds no scene none; it has small, demo"),
        (("--constants", "Refinement.none"), "there is no constant Refinement.none"),
    ],
)
def test_unknown_names_are_errors(data, arguments, message):
    done = run_script("halve_and_double.py", data, *arguments, code=1)
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
