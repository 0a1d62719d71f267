"""The documents are correct: examples run, links resolve, generated pages are current."""

import os
import re
import runpy
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import cv2
import pytest
from project import ROOT

import colmap_edges
from colmap_edges.cli.flags import make_flags
from colmap_edges.options import PipelineOptions

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

PROJECT = (ROOT / "pyproject.toml").read_text()
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
EXAMPLE = re.compile(r"<!-- tested -->\n```(bash|python)\n(.*?)```", re.DOTALL)
EXAMPLES = [(page.name, *found) for page in PAGES for found in EXAMPLE.findall(page.read_text())]


@pytest.fixture(scope="module")
def workspace(small, tmp_path_factory):
    """A workspace as COLMAP leaves it, and the environment in which commands are typed."""
    folder = tmp_path_factory.mktemp("workspace")
    shutil.copytree(small[0], folder / "images")
    shutil.copytree(small[1], folder / "sparse" / "0")
    (folder / "masks").mkdir()
    for image in small[0].iterdir():
        mask = cv2.inRange(cv2.imread(str(image), cv2.IMREAD_GRAYSCALE), 10, 255)
        cv2.imwrite(str(folder / "masks" / f"{image.name}.png"), mask)
    command = folder / "bin" / "colmap-edges"
    command.parent.mkdir()
    lines = ["#!/bin/sh", f'exec "{sys.executable}" -c "{START}" "$@"', ""]
    command.write_text("\n".join(lines))
    command.chmod(0o755)
    path = f"{command.parent}:{os.environ['PATH']}"
    package = str(Path(colmap_edges.__file__).parents[1])
    return folder, {**os.environ, "PATH": path, "PYTHONPATH": package}


START = "from colmap_edges.cli.main import main; main()"


def test_there_are_examples():
    assert {name for name, *_ in EXAMPLES} == {"README.md", "meshing.md", "recipes.md"}


@pytest.mark.parametrize(("page", "language", "text"), EXAMPLES)
def test_examples_run(workspace, page, language, text):
    folder, environment = workspace
    if re.search(r"^colmap ", text, re.MULTILINE) and not shutil.which("colmap"):
        pytest.skip("colmap is not installed")
    if "to_pandas" in text:
        pytest.importorskip("pandas", reason="pandas is an extra that not every environment has")
    if page == "README.md":
        shutil.rmtree(folder / "edges", ignore_errors=True)
    program = ["bash", "-e"] if language == "bash" else [sys.executable, "-"]
    done = subprocess.run(
        program, input=text, cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    if "mesh --workspace_path" in text:
        assert (folder / "edges" / "report.html").is_file()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_options_page_is_as_the_code():
    module = runpy.run_path(str(ROOT / "scripts" / "document_options.py"))
    assert (ROOT / "docs" / "options.md").read_text() == module["options_page"]()


def test_interface_page_holds_every_public_name():
    page = (ROOT / "docs" / "api.md").read_text().partition("## colmap_edges.")[0]
    listed = re.findall(r"^::: colmap_edges\..*\.(\w+)$", page, re.MULTILINE)
    assert sorted(listed) == sorted(set(colmap_edges.__all__) - {"__version__"})


def test_flags_in_the_documents_exist():
    known = {flag.opts[0] for flag in make_flags({f.name for f in fields(PipelineOptions)})}
    groups = {flag.partition(".")[0] for flag in known if "." in flag}
    for page in PAGES:
        # Those of colmap's own commands are not ours.
        text = re.sub(r"^ *colmap (.*\\\n)*.*$", "", page.read_text(), flags=re.MULTILINE)
        for flag in re.findall(r"--[A-Za-z]+\.[a-z0-9_]+", text):
            if flag.partition(".")[0] in groups:
                assert flag in known, f"{page.name}: {flag}"


def test_every_dependency_has_its_licence_listed():
    lines = PROJECT[
        PROJECT.index("\ndependencies") : PROJECT.index("[project.scripts]")
    ].splitlines()
    lines = [line for line in lines if not line.startswith("dev = ")]
    wanted = re.findall(r'"([a-z-]+)>=([0-9.]+)', "\n".join(lines))
    assert wanted
    page = (ROOT / "docs" / "licences.md").read_text()
    listed = dict(re.findall(r"^\| ([a-z-]+)(?: \([^|]*\))? \| ([0-9.]+) \|", page, re.MULTILINE))
    assert {name: listed.get(name) for name, _ in wanted} == dict(wanted)
