"""The packaging files agree with the project and its pages."""

import re
import sys

import pytest
from project import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
VERSIONS = re.findall(
    r"Python :: (3\.\d+)$", "\n".join(PROJECT["project"]["classifiers"]), re.MULTILINE
)


def text_of(path):
    return (ROOT / path).read_text(encoding="utf-8")


def test_wheels_are_made_for_every_version():
    building = PROJECT["tool"]["cibuildwheel"]["build"]
    made = [re.fullmatch(r"cp3(\d+)-\*", each)[1] for each in building]
    stable = PROJECT["tool"]["scikit-build"]["wheel"]["py-api"]
    assert made[-1] == stable.removeprefix("cp3")  # the last serves all later ones
    assert [f"3.{minor}" for minor in made] == VERSIONS[: len(made)]
    assert PROJECT["project"]["requires-python"] == f">={VERSIONS[0]}"


def test_ci_tests_every_version_on_debian_and_ubuntu():
    workflow = text_of(".github/workflows/ci.yml")
    tested = set(re.findall(r'python: "(3\.\d+)"', workflow))
    own = {"debian:12": "3.11", "debian:13": "3.13", "ubuntu:24.04": "3.12"}
    images = set(re.findall(r'image: "([^"]+)"', workflow))
    assert images == set(own)
    assert tested | set(own.values()) == set(VERSIONS)


@pytest.mark.parametrize("path", [".github/workflows/ci.yml", "docker/Dockerfile"])
def test_scripts_that_are_run_exist(path):
    for name in re.findall(r"\bscripts/\w+", text_of(path)):
        assert (ROOT / name).is_file(), name
    before = PROJECT["tool"]["cibuildwheel"]["before-all"]
    assert (ROOT / re.search(r"scripts/\w+", before)[0]).is_file()


def test_conda_recipe_has_the_projects_dependencies():
    recipe = text_of("conda-recipe/meta.yaml")
    run = recipe[recipe.index("  run:") : recipe.index("\ntest:")]
    found = dict(re.findall(r"^    - ([\w-]+)(?: >=([\d.]+))?", run, re.MULTILINE))
    assert found.pop("python") == PROJECT["project"]["requires-python"].removeprefix(">=")
    found["opencv-contrib-python-headless"] = found.pop("opencv")
    wanted = {
        re.match(r"[\w-]+", each)[0]: re.search(r">=([\d.]+)", each)[1]
        for each in PROJECT["project"]["dependencies"]
    }
    assert found == wanted
    assert f'version = "{PROJECT["project"]["version"]}"' in recipe


def test_sdist_contains_the_files_of_the_build():
    excluded = PROJECT["tool"]["scikit-build"]["sdist"]["exclude"]
    needed = {"CMakeLists.txt", "meshing", "colmap_edges", "README.md", "LICENSE"}
    assert not needed & set(excluded)
    for name in [*PROJECT["project"]["license-files"], PROJECT["project"]["readme"]]:
        assert (ROOT / name).is_file()
