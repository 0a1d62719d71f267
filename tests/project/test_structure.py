"""The structure of the code agrees with docs/architecture.md."""

import ast
import importlib
import re
import runpy
import subprocess
import sys

import pytest
from project import ROOT

import colmap_edges

PACKAGE = ROOT / "colmap_edges"
PAGE = (ROOT / "docs" / "architecture.md").read_text()
# The folders in which these libraries may be imported.
LIBRARIES = {
    "pycolmap": {"colmap", "evaluation"},
    "cv2": {"edges2d", "evaluation", "images", "report", "surfaces", "texture"},
    "filelock": {"runtime"},
    "jinja2": {"report"},
    "networkx": {"export"},
    "pandas": {"export"},
    "plyfile": {"export"},
    "pymeshlab": {"evaluation"},
    "click": {"cli"},
    "rich": {"cli"},
    "distributed": {"runtime"},
    "ezdxf": {"export"},
    "OCP": {"export"},
    "rerun": {"report"},
    "matplotlib": set(),
}
# Modules by their names, such as `report.page`; a folder's is that of its __init__.py.
MODULES = {
    re.sub(r"\.?__init__$", "", ".".join(path.relative_to(PACKAGE).with_suffix("").parts)): path
    for path in PACKAGE.rglob("*.py")
}


def imported_packages(path):
    """The packages that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module).partition(".")[0]


def test_imports_go_one_way():
    pytest.importorskip("importlinter", reason="contracts are checked by import-linter")
    command = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    done = subprocess.run(
        [sys.executable, "-c", command, "--no-cache"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


def test_every_folder_is_on_the_page():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert {name for name in folders if f"- [{name}](" not in PAGE} == set()


def test_modules_are_short():
    lengths = {name: len(path.read_text().splitlines()) for name, path in MODULES.items()}
    assert {module: length for module, length in lengths.items() if length > 400} == {}


def test_libraries_are_imported_where_they_may_be():
    found = {name: set() for name in LIBRARIES}
    for module, path in MODULES.items():
        for name in {*imported_packages(path)} & {*found}:
            found[name].add(module.partition(".")[0])
    assert found == LIBRARIES


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
    assert cores
    for path in cores:
        included = re.findall(r'#include [<"]([^>"]+)', path.read_text())
        python = [name for name in included if re.match(r"nanobind|Python\.h|.*bindings", name)]
        assert python + [name for name in included if name.endswith("arrays.h")] == [], path


def test_names_on_the_page_exist():
    told = set(re.findall(r"`([a-z_0-9.]+\.\w+)`", PAGE))
    pairs = [(module, name) for module, _, name in (each.rpartition(".") for each in told)]
    files = {"html", "json", "ply", "py"}
    pairs = [
        (module, name)
        for module, name in pairs
        if module in MODULES and f"{module}.{name}" not in MODULES and name not in files
    ]
    assert pairs
    for module, name in pairs:
        assert hasattr(importlib.import_module(f"colmap_edges.{module}"), name), (module, name)


def test_modules_that_text_names_exist():
    """Programs and flags in strings, comments and pages: nothing else notices when modules move."""
    modules = {*MODULES, "_mesher", "kernels._kernels"}
    paths = [p for d in ("colmap_edges", "docs", "scripts", "tests") for p in (ROOT / d).rglob("*")]
    paths = [p for p in paths if p.suffix in (".py", ".md") or p.parent == ROOT / "scripts"]
    for path in (p for p in paths if p.is_file()):
        for name in re.findall(r"\b(?:from|import|-m|`) ?colmap_edges\.([\w.]+)", path.read_text()):
            name, parent = name.rstrip("."), name.rstrip(".").rpartition(".")[0]
            known = name in modules or parent in modules or hasattr(colmap_edges, name)
            assert known or name == "no_such_name", (path, name)


def test_first_line_of_a_module_describes_it():
    for path in MODULES.values():
        docstring = ast.get_docstring(ast.parse(path.read_text())) or ""
        assert re.fullmatch(r".{8,}[.:]", docstring.partition("\n")[0]), path


def test_files_of_users_are_written_in_one_way():
    """All others write to folders that they made, or to caches."""
    allowed = {
        "runtime.output",  # the way
        "runtime.cache",
        "runtime.platform",  # of the kernel
        "edges2d.graphs",  # temporary files
        "colmap.appending",  # to files that pycolmap wrote to a new folder
        "colmap.text_files",  # temporary files
        "evaluation.triangulation",  # temporary files
        "colmap.writing",  # pycolmap writes to a new folder
    }
    writing = re.compile(r"""\.write_(text|bytes)\(|open\(.*["'][rwax]b?\+?b?["']\)|\.export\(""")
    reading = re.compile(r"""open\(.*["']rb?["']\)""")
    found = {
        module
        for module, path in MODULES.items()
        for line in path.read_text().splitlines()
        if writing.search(line) and not reading.search(line)
    }
    assert found <= allowed
    assert {"runtime.output", "runtime.cache", "colmap.appending"} <= found  # it sees them
