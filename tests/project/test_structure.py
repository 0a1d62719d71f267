"""The structure of the code agrees with docs/architecture.md."""

import importlib
import re
import runpy
import subprocess
import sys

import pytest
from project import ROOT

import colmap_edges


@pytest.fixture(scope="module")
def architecture():
    return runpy.run_path(str(ROOT / "scripts" / "document_architecture.py"))


def test_imports_go_one_way():
    pytest.importorskip("importlinter", reason="contracts are checked by import-linter")
    command = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    done = subprocess.run(
        [sys.executable, "-c", command, "--no-cache"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


def test_few_modules_stand_beside_the_folders(architecture):
    beside = [path.name for path in architecture["PACKAGE"].glob("*.py")]
    assert len(beside) <= 8, beside


def test_modules_are_short(architecture):
    lengths = {
        module: len(path.read_text().splitlines())
        for module, path in architecture["module_paths"]().items()
    }
    assert {module: length for module, length in lengths.items() if length > 400} == {}


def test_libraries_are_imported_where_they_may_be(architecture):
    allowed = {name: set(modules) for name, modules in architecture["LIBRARIES"].items()}
    assert architecture["libraries"]() == allowed


def test_no_test_imports_another():
    """What tests share is in tests/support or a conftest."""
    for path in (ROOT / "tests").rglob("*.py"):
        imported = re.findall(r"^\s*(?:from|import) (\S+)", path.read_text(), re.MULTILINE)
        assert [name for name in imported if re.search(r"(^|\.)test_|^tests\b", name)] == [], path


def test_longest_files_of_tests_exist():
    conftest = runpy.run_path(str(ROOT / "tests" / "conftest.py"))
    for name in conftest["LONGEST"]:
        assert (ROOT / "tests" / name).is_file(), name


def test_cores_know_no_python():
    cores = [
        path
        for folder in ("colmap_edges/kernels", "meshing")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".h", ".cc") and not re.search("bindings|arrays.h|module.cc", path.name)
    ]
    assert len(cores) > 25
    for path in cores:
        included = re.findall(r'#include [<"]([^>"]+)', path.read_text())
        python = [name for name in included if re.match(r"nanobind|Python\.h|.*bindings", name)]
        assert python + [name for name in included if name.endswith("arrays.h")] == [], path


def test_page_is_as_the_code(architecture):
    written = architecture["TARGET"].read_text()
    assert architecture["page"](written) == written


def test_names_on_the_page_exist(architecture):
    modules = architecture["module_paths"]()
    told = set(re.findall(r"`([a-z_0-9.]+\.\w+)`", architecture["TARGET"].read_text()))
    pairs = [(module, name) for module, _, name in (each.rpartition(".") for each in told)]
    files = {"html", "json", "ply", "py"}
    pairs = [
        (module, name)
        for module, name in pairs
        if module in modules and f"{module}.{name}" not in modules and name not in files
    ]
    assert len(pairs) > 15
    for module, name in pairs:
        assert hasattr(importlib.import_module(f"colmap_edges.{module}"), name), (module, name)


def test_modules_that_text_names_exist(architecture):
    """Programs and flags in strings, comments and pages: nothing else notices when modules move."""
    modules = {*architecture["module_paths"](), "_mesher", "kernels._kernels"}
    paths = [p for d in ("colmap_edges", "docs", "scripts", "tests") for p in (ROOT / d).rglob("*")]
    paths = [p for p in paths if p.suffix in (".py", ".md") or p.parent == ROOT / "scripts"]
    count = 0
    for path in (p for p in paths if p.is_file()):
        for name in re.findall(r"\b(?:from|import|-m|`) ?colmap_edges\.([\w.]+)", path.read_text()):
            name, parent = name.rstrip("."), name.rstrip(".").rpartition(".")[0]
            known = name in modules or parent in modules or hasattr(colmap_edges, name)
            assert known or name == "no_such_name", (path, name)
            count += 1
    assert count > 500


def test_first_line_of_a_module_describes_it(architecture):
    for path in architecture["module_paths"]().values():
        line = architecture["first_line"](path)
        assert re.fullmatch(r".{8,}[.:]", line), path


def test_files_of_users_are_written_in_one_way(architecture):
    """All others write to folders that they made, or to caches."""
    allowed = {
        "runtime.output",  # the way
        "runtime.cache",
        "runtime.platform",  # of the kernel
        "edges2d.graphs",  # temporary files
        "colmap.binary_files",  # appends to files that pycolmap wrote to a new folder
        "colmap.triangulation",  # temporary files
        "colmap.writing",  # pycolmap writes to a new folder
    }
    writing = re.compile(r"""\.write_(text|bytes)\(|open\(.*["'][rwax]b?\+?b?["']\)|\.export\(""")
    reading = re.compile(r"""open\(.*["']rb?["']\)""")
    found = {
        module
        for module, path in architecture["module_paths"]().items()
        for line in path.read_text().splitlines()
        if writing.search(line) and not reading.search(line)
    }
    assert found <= allowed
    assert {"runtime.output", "runtime.cache", "colmap.binary_files"} <= found  # it sees them
